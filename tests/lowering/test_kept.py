"""What is kept of a system on disk: what a process finds there is what it would have traced, and every change is seen."""

import importlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.errors import ProblemError
from hhtbench.lowering import kept
from hhtbench.lowering.diagonal import Diagonal
from hhtbench.lowering.kept import name_of
from hhtbench.protocol import NumpySystem, System, parameter

derivation = importlib.import_module("hhtbench.lowering.derive")  # the name in the package is the function's
HERE = sys.modules[__name__]
Q, V = np.array([0.3, -1.2]), np.array([0.1, 0.2])


@pytest.fixture
def derived_afresh(monkeypatch, empty_cache):
    """``derive`` as in a new process: (dynamics, whether it was traced)."""
    traced, trace = [], derivation._trace
    monkeypatch.setattr(derivation, "_trace", lambda *arguments: traced.append(1) or trace(*arguments))

    def derived(system, q=Q, v=V, **options):
        monkeypatch.setattr(derivation, "_derived", {})
        monkeypatch.setattr(kept, "_written", [])
        traced.clear()
        return derivation.derive(system, 0.0, q, v, **options), bool(traced)

    return derived


def assert_same(found, expected):
    assert found.structure == expected.structure
    for name in ("constant_mass", "inverse_mass"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert type(ours) is type(theirs)
        ours, theirs = (x.values if isinstance(x, Diagonal) else x for x in (ours, theirs))
        if theirs is not None:
            assert isinstance(ours, jax.Array)
            assert (ours.dtype, ours.weak_type) == (theirs.dtype, theirs.weak_type)
            np.testing.assert_array_equal(ours, theirs)
    assert jax.tree.structure(found) == jax.tree.structure(expected)


@pytest.mark.parametrize("name", hb.list_problems())
def test_every_problem_is_found_as_it_was_traced(name, derived_afresh):
    problem = hb.load_problem(name)
    if isinstance(problem.system, NumpySystem):
        pytest.skip("nothing is traced")
    expected, traced = derived_afresh(problem.system, problem.q0, problem.v0)
    assert traced
    found, traced = derived_afresh(problem.system, problem.q0, problem.v0)
    assert not traced
    assert_same(found, expected)


FACTOR = 0.0
TABLE = {"factor": 0.0}


def drag_of(factor):
    return lambda v: factor * v if factor else 0.0 * jnp.ones(2)


drag = drag_of(0.0)


class Held:
    factor = 0.0


class Falling(System):
    """Whether its force depends on v is decided in many places."""

    mass: object = parameter(2.0)
    slope: object = parameter(0.0)

    @property
    def mass_matrix(self):
        return self.mass

    def force(self, t, q, v):
        factors = FACTOR, TABLE["factor"], Held.factor, float(self.slope)
        return sum(factor * v for factor in factors if factor) + drag(v) - q


@pytest.mark.parametrize(
    "change",
    [
        lambda patch: patch.setattr(HERE, "FACTOR", 5.0),
        lambda patch: patch.setitem(TABLE, "factor", 5.0),
        lambda patch: patch.setattr(Held, "factor", 5.0),
        lambda patch: patch.setattr(HERE, "drag", drag_of(5.0)),
    ],
    ids=["global", "dict", "class", "closure"],
)
def test_what_changes_the_structure_is_seen(change, derived_afresh, monkeypatch):
    assert not derived_afresh(Falling())[0].structure.force_uses_v
    change(monkeypatch)
    changed, traced = derived_afresh(Falling())
    assert traced
    assert changed.structure.force_uses_v
    assert_same(derived_afresh(Falling())[0], changed)
    assert not derived_afresh(Falling())[1]


class Weighed(Falling):
    """Its mass is a number of Python: JAX calls the type of such an array weak."""

    @property
    def mass_matrix(self):
        return jnp.full(2, 2.0)


def test_the_type_of_a_mass_is_the_same_from_disk(derived_afresh):
    expected, _ = derived_afresh(Weighed())
    found, traced = derived_afresh(Weighed())
    assert not traced
    assert_same(found, expected)


def test_values_of_parameters_are_part_of_the_name(derived_afresh):
    assert not derived_afresh(Falling())[0].structure.force_uses_v
    assert derived_afresh(Falling(slope=1.0))[0].structure.force_uses_v
    for mass in (2.0, 3.0, 2.0):
        np.testing.assert_array_equal(derived_afresh(Falling(mass=mass))[0].constant_mass, mass * np.eye(2))


def test_sizes_types_and_what_is_ignored_are_part_of_the_name(empty_cache):
    names = [
        name_of(Falling(), Q, V, ()),
        name_of(Falling(), np.zeros(3), np.zeros(3), ()),
        name_of(Falling(), Q, np.zeros(3), ()),
        name_of(Falling(), np.zeros(2, dtype=int), V, ()),
        name_of(Falling(), Q, V, ("force_jacobians",)),
    ]
    assert None not in names
    assert len(set(names)) == len(names)
    assert names[0] == name_of(Falling(), 2.0 * Q, 3.0 * V, ())


class Wrong(System):
    """A force of the wrong shape, or a mass."""

    wide: object = parameter(False)

    @property
    def mass_matrix(self):
        return jnp.ones((2, 3)) if self.wide else None

    def force(self, t, q, v):
        return -q if self.wide else jnp.ones(3)


@pytest.mark.parametrize("wide", [False, True])
def test_an_error_is_the_same_every_time_and_never_kept(wide, derived_afresh, empty_cache):
    texts = []
    for _ in range(3):
        with pytest.raises(ProblemError) as caught:
            derived_afresh(Wrong(wide=wide))
        texts.append(str(caught.value))
    assert len(set(texts)) == 1
    assert not list(empty_cache.rglob("*.structure"))


def test_a_damaged_file_is_as_good_as_none(derived_afresh, empty_cache):
    expected, _ = derived_afresh(Falling())
    (file,) = (empty_cache / "native").glob("*.structure")
    whole = file.read_bytes()
    for damaged in (b"", whole[:-1], whole[:40], bytes([*whole[:-1], whole[-1] ^ 1])):
        file.write_bytes(damaged)
        found, traced = derived_afresh(Falling())
        assert traced
        assert_same(found, expected)
        assert file.read_bytes() == whole, "the damaged file was replaced"


def test_a_folder_that_cannot_be_written_does_no_harm(derived_afresh, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path / "file"))
    for _ in range(2):
        dynamics, traced = derived_afresh(Falling())
        assert traced
        assert dynamics.structure.mass == "constant"


def test_a_system_made_inside_a_function_is_traced_in_every_process(derived_afresh):
    class Local(Falling):
        pass

    assert [derived_afresh(Local())[1] for _ in range(2)] == [True, True]


def test_a_study_of_parameters_does_not_fill_the_disk(derived_afresh, monkeypatch, empty_cache):
    derived_afresh(Falling())
    monkeypatch.setattr(kept, "MOST", 3)
    for slope in range(1, 10):
        monkeypatch.setattr(derivation, "_derived", {})
        derivation.derive(Falling(slope=float(slope)), 0.0, Q, V)
    assert len(list((empty_cache / "native").glob("*.structure"))) == 3


def test_a_large_mass_is_not_kept(derived_afresh, monkeypatch, empty_cache):
    monkeypatch.setattr(kept, "LARGEST", 1)
    assert [derived_afresh(Falling())[1] for _ in range(2)] == [True, True]
    assert not list(empty_cache.rglob("*.structure"))


MECHANISM = """
from hhtbench.protocol import System
from spring import pull

class Mechanism(System):
    def force(self, t, q, v):
        print("traced")
        return pull(q, v)
"""
SCRIPT = """
import sys; sys.path.insert(0, sys.argv[1])
import numpy as np
from hhtbench.lowering import derive
from mechanism import Mechanism
print(derive(Mechanism(), 0.0, np.ones(2), np.ones(2)).structure.force_uses_v)
"""


def test_a_new_process_traces_only_where_an_imported_source_has_changed(tmp_path, empty_cache):
    environment = {"HHTBENCH_CACHE": str(empty_cache), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}

    def run():
        command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()

    (tmp_path / "mechanism.py").write_text(MECHANISM)
    (tmp_path / "spring.py").write_text("def pull(q, v):\n    return -q\n")
    assert set(run()) == {"traced", "False"}
    assert run() == ["False"]
    (tmp_path / "spring.py").write_text("def pull(q, v):\n    return -q - v\n")
    assert set(run()) == {"traced", "True"}
