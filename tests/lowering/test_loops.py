"""Compiled loops: what goes over to them, what is kept of them on disk, and that a process that finds it needs no Numba."""

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hhtbench.lowering import compiled_loops
from hhtbench.lowering.loops import loops

HERE = Path(__file__)
entry, inner, with_arrays = loops(HERE, bare=True), loops(HERE, bare=True, inner=True), loops(HERE)


class Pair(NamedTuple):
    values: object
    scale: float


@inner
def weighed(values, weights):
    total = 0.0
    for i in range(values.size):
        total += values[i] * weights[i]
    return total


@entry
def sums(pair, table, flags, options, out):
    """Everything that an entry takes: into ``out``; returns its length."""
    whole, doubled, (start, more) = options
    out[0] = weighed(pair.values, table[1]) * pair.scale
    out[1] = table[2, 1] + start * more
    out[2] = 2.0 if doubled else 1.0
    out[3] = whole + weighed(table[:, 1], pair.values)
    for i in range(flags.size):
        flags[i] = not flags[i]
    return out.size


@with_arrays
def squares(values):
    """With an array of its own."""
    out = np.empty(1)
    out[0] = weighed(values, values)
    return out


@entry
def nothing(out):
    """No value."""
    out[0] = 1.0


@entry
def half(x):
    """Not a whole number."""
    return 0.5 * x


@entry
def steps_beyond(x):
    """What needs Numba when it is loaded, too: a symbol of its own."""
    return int(np.nextafter(x, 10.0) > x)


def called(function=sums):
    out, flags = np.zeros(4), np.array([True, False, True])
    pair, table = Pair(np.array([1.0, 2.0, 3.0]), 0.5), np.arange(9.0).reshape(3, 3)
    count = function(pair, table, flags, (7, True, (0.25, -3)), out)
    return count, out.tolist(), flags.tolist()


EXPECTED = 4, [0.5 * (3.0 + 8.0 + 15.0), 7.0 - 0.75, 2.0, 7.0 + 1.0 + 8.0 + 21.0], [False, True, False]


@pytest.fixture
def compilations(monkeypatch, empty_cache):
    """How often Numba compiled an entry, none of which is in memory yet."""
    for function in (sums, nothing, half, steps_beyond):
        monkeypatch.setattr(function, "_ready", {})
    made, compile_it = [], compiled_loops.object_code

    def object_code(*arguments):
        made.append(arguments)
        return compile_it(*arguments)

    monkeypatch.setattr(compiled_loops, "object_code", object_code)
    return made


def test_arrays_numbers_and_tuples_go_over_and_results_come_back(compilations):
    assert called() == EXPECTED
    out = np.zeros(1)
    assert (nothing(out), out[0]) == (0, 1.0)


def test_functions_with_arrays_of_their_own_share_what_entries_call(compilations, monkeypatch):
    """Numba does not load what it compiles for an entry; what is put into other code must be whole all the same."""
    monkeypatch.setattr(weighed, "_made", None)
    monkeypatch.setattr(squares, "_made", None)
    assert called() == EXPECTED
    assert squares(np.array([1.0, 2.0, 3.0])).tolist() == [14.0]


def test_what_is_on_disk_is_not_compiled_again(compilations, monkeypatch):
    assert called() == EXPECTED
    monkeypatch.setattr(sums, "_ready", {})
    assert called() == EXPECTED
    assert len(compilations) == 1


def test_other_types_and_sources_are_other_code(compilations, monkeypatch):
    called()
    out = np.zeros(4)
    pair, table = Pair(np.array([1, 2, 3]), 0.5), np.arange(9.0).reshape(3, 3)
    assert sums(pair, table, np.zeros(1, dtype=bool), (7, True, (0.25, -3)), out) == 4
    assert out.tolist() == EXPECTED[1]
    assert len(compilations) == 2
    monkeypatch.setattr(sums, "_ready", {})
    monkeypatch.setattr(sums, "_content", "after a change of the sources")
    called()
    assert len(compilations) == 3


def test_a_damaged_file_is_as_good_as_none(compilations, monkeypatch, empty_cache):
    called()
    (file,) = (empty_cache / "native").glob("*.loop")
    whole = file.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], bytes([*whole[:-1], whole[-1] ^ 1])):
        file.write_bytes(damaged)
        monkeypatch.setattr(sums, "_ready", {})
        assert called() == EXPECTED
        assert len(file.read_bytes()) > len(whole) // 2, "the damaged file was replaced"
    assert len(compilations) == 4


def test_a_folder_that_cannot_be_written_does_no_harm(compilations, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path / "file"))
    assert called() == EXPECTED


def test_code_with_symbols_of_numba_is_not_kept(compilations, empty_cache):
    assert steps_beyond(1.0) == 1
    assert not list(empty_cache.rglob("*.loop"))


def test_what_cannot_go_over_is_refused(compilations):
    with pytest.raises(TypeError, match="strided"):
        nothing(np.zeros(4)[::2])
    with pytest.raises(TypeError, match="got list"):
        nothing([1.0])
    with pytest.raises(TypeError, match="must return a whole number"):
        half(1.0)


FIRST_SOLVE = """
import json, sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if {refused!r} and name == "hhtbench.lowering.compiled_loops":
            raise ImportError(name)
sys.meta_path.insert(0, Refuse())
from problems.jay_negrut_pendulum import problem
from solvers.hht import HHT
made = problem()
solution = HHT(made.system, engine="native").solve((0, 0.1), made.q0, made.v0, step=1e-3)
controlled = HHT(made.system, engine="native").solve((0, 0.1), made.q0, made.v0, rtol=1e-4)
print(json.dumps([solution.q[-1].tolist(), controlled.lam.ravel().tolist()]))
"""


def test_a_process_that_finds_the_native_engine_on_disk_compiles_nothing():
    """With the cache of the test run, which is filled first: compiling the loops takes half a minute."""
    values = []
    for refused in (False, True):
        command = [sys.executable, "-c", FIRST_SOLVE.format(refused=refused)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        values.append(json.loads(done.stdout))
    assert values[0] == values[1]
