"""Compiled loops: what goes over to them, that what is shipped is what the sources make, and that none of it needs Numba."""

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hhtbench.lowering.compile import compiled_loops
from hhtbench.lowering.compile import loops as module
from hhtbench.lowering.compile.loops import (
    BITCODE,
    MANIFEST,
    BoolArray,
    FloatArray,
    FloatMatrix,
    content_of,
    entries,
    inner,
)
from solvers.explicit import march as explicit_march
from solvers.hht.run import march as hht_march

HERE = Path(__file__)
entry, within = entries(HERE.with_name("compiled"), HERE), inner()  # another folder in every test


class Pair(NamedTuple):
    values: FloatArray
    scale: float


@within
def weighed(values, weights):
    total = 0.0
    for i in range(values.size):
        total += values[i] * weights[i]
    return total


@entry
def sums(
    pair: Pair, table: FloatMatrix, flags: BoolArray, options: tuple[int, bool, tuple[float, int]], out: FloatArray
) -> int:
    """Everything that an entry takes: into ``out``; returns its length."""
    whole, doubled, (start, more) = options
    out[0] = weighed(pair.values, table[1]) * pair.scale
    out[1] = table[2, 1] + start * more
    out[2] = 2.0 if doubled else 1.0
    out[3] = whole + weighed(table[:, 1], pair.values)
    for i in range(flags.size):
        flags[i] = not flags[i]
    return out.size


@entry
def nothing(out: FloatArray) -> None:
    """No value."""
    out[0] = 1.0


@entry
def half(x: float) -> float:
    """Not a whole number."""
    return 0.5 * x


@entry
def steps_beyond(x: float) -> int:
    """What needs Numba when it runs: a symbol of its own."""
    return int(np.nextafter(x, 10.0) > x)


def called(function=sums):
    out, flags = np.zeros(4), np.array([True, False, True])
    pair, table = Pair(np.array([1.0, 2.0, 3.0]), 0.5), np.arange(9.0).reshape(3, 3)
    count = function(pair, table, flags, (7, True, (0.25, -3)), out)
    return count, out.tolist(), flags.tolist()


EXPECTED = 4, [0.5 * (3.0 + 8.0 + 15.0), 7.0 - 0.75, 2.0, 7.0 + 1.0 + 8.0 + 21.0], [False, True, False]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder that ``make loops`` writes, of the entries here."""
    folder = tmp_path_factory.mktemp("compiled")
    for function in (sums, nothing):
        function.folder = folder
    compiled_loops.write_all([sums, nothing])
    return folder


@pytest.fixture
def shipped(made, monkeypatch):
    """That folder, with none of it loaded; what a test changes is put back."""
    for function in (sums, nothing):
        monkeypatch.setattr(function, "_ready", None)
    kept = {file: file.read_bytes() for file in made.iterdir()}
    yield made
    for file, data in kept.items():
        file.write_bytes(data)


def test_arrays_numbers_and_tuples_go_over_and_results_come_back(shipped):
    assert called() == EXPECTED
    out = np.zeros(1)
    assert (nothing(out), out[0]) == (0, 1.0)


@pytest.mark.parametrize("again", [False, True])
def test_other_platforms_make_machine_code_of_the_bitcode(again, shipped, monkeypatch, empty_cache):
    monkeypatch.setattr(module.platform, "machine", lambda: "riscv64")
    assert called() == EXPECTED
    assert len(list((empty_cache / "native").glob("*.loop"))) == 1
    if again:
        monkeypatch.setattr(module, "from_bitcode", None)
        monkeypatch.setattr(sums, "_ready", None)
        assert called() == EXPECTED, "from disk"


def test_code_of_other_sources_is_refused(shipped):
    manifest = json.loads((shipped / MANIFEST).read_text())
    (shipped / MANIFEST).write_text(json.dumps(manifest | {"content": "another"}))
    with pytest.raises(RuntimeError, match="have changed since they were compiled: run `make loops`"):
        called()


def test_damaged_code_is_refused(shipped):
    for file in shipped.glob("sums.*"):
        file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(RuntimeError, match="is damaged: install hhtbench anew"):
        called()


def test_what_cannot_go_over_is_refused(shipped):
    with pytest.raises(TypeError, match="strided"):
        nothing(np.zeros(4)[::2])
    with pytest.raises(TypeError, match="got list"):
        nothing([1.0])
    with pytest.raises(TypeError, match=r"nothing takes \[<f81\]; got \[<i81\]"):
        nothing(np.zeros(4, dtype=int))


def test_what_cannot_be_compiled_beforehand_is_refused():
    with pytest.raises(TypeError, match="must return a whole number"):
        compiled_loops.bitcode(half)
    with pytest.raises(TypeError, match="needs Numba when it runs"):
        compiled_loops.bitcode(steps_beyond)


@pytest.mark.parametrize("march", [hht_march.march, explicit_march.march], ids=["hht", "explicit"])
def test_what_is_shipped_is_made_from_the_sources(march):
    """Where this fails, run ``make loops``."""
    manifest = json.loads((march.folder / MANIFEST).read_text())
    assert manifest["content"] == content_of(march.sources)
    theirs = [function.__name__ for function in module.ENTRIES if function.folder == march.folder]
    assert sorted(manifest["entries"]) == sorted(theirs)
    files = {f"{name}.{kind}" for name, made in manifest["entries"].items() for kind in made["files"]}
    assert {file.name for file in march.folder.iterdir()} == files | {MANIFEST}
    assert {kind for made in manifest["entries"].values() for kind in made["files"]} == {
        BITCODE,
        "x86_64-linux",
        "aarch64-linux",
    }


@pytest.mark.parametrize("march", [hht_march.march, explicit_march.march], ids=["hht", "explicit"])
def test_no_loop_counts_from_the_end_of_an_array(march):
    """Compiled loops read outside of an array there: nothing looks whether an index is negative."""
    files = [path for source in march.sources for path in (source.glob("*.py") if source.is_dir() else [source])]
    loops = [loop for path in files for loop in ast.walk(ast.parse(path.read_text())) if _is_loop(loop)]
    assert len(loops) > 10
    for loop in loops:
        for part in ast.walk(loop):
            counted = isinstance(part, ast.Subscript) and any(isinstance(x, ast.USub) for x in ast.walk(part.slice))
            assert not counted, f"{loop.name}: {ast.unparse(part)}"


def _is_loop(node):
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(x, ast.Name) and x.id in ("compiled", "inlined", "called", "entry") for x in node.decorator_list
    )


FIRST_SOLVE = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "numba":
            raise ImportError(name)
sys.meta_path.insert(0, Refuse())
from problems.jay_negrut_pendulum import problem
from solvers.hht import HHT
made = problem()
HHT(made.system).solve((0, 0.1), made.q0, made.v0, step=1e-3)
print(HHT(made.system).solve((0, 0.1), made.q0, made.v0, rtol=1e-4).status.label)
"""


def test_the_loops_need_no_numba(empty_cache):
    done = subprocess.run([sys.executable, "-c", FIRST_SOLVE], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "success", done.stderr
