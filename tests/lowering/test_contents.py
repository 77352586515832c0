"""Keys that are equal in every process, and compiled functions found by them without tracing."""

from __future__ import annotations

import functools
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
import hhtbench.lowering.scalar_compiler.compiler
from hhtbench.lowering import contents, derive, flattening, native
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.contents import lasting_key
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.lowering.scalar_compiler import native_call
from hhtbench.mechanics import Mechanism, contact
from problems import bricard, simple_pendulum

compiler = sys.modules["hhtbench.lowering.scalar_compiler.compiler"]
SHAPES = ((), (3,), (3,))


def pendulum(L=1.5):
    m = Mechanism(plane=True)
    m.body("rod", 1.3, 0.1, at=(L, 0.3))
    m.revolute("A", "ground", "rod", at=(0, 0))
    return derived(m.problem((0, 1)))


def derived(problem):
    return derive(problem.system, 0.0, problem.q0, problem.v0)


def cranks(law):
    """A crank with a motor, the library's classes all through but for the law of time."""
    m = Mechanism(plane=True)
    m.body("crank", 1.0, 0.1, at=(0.5, 0))
    m.revolute("A", "ground", "crank", at=(0, 0))
    if law is not None:
        m.motor("drive", "A", law)
    return m.system()


def test_keys_are_equal_in_every_process():
    code = (
        "from hhtbench.lowering.contents import lasting_key; from tests.lowering.test_contents import level_terms, pendulum;"
        "print(lasting_key(level_terms, pendulum(), 3).hex())"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert lasting_key(level_terms, pendulum(), 3).hex() == printed.strip()


def test_keys_tell_functions_structures_and_sources_apart_and_no_parameters(monkeypatch):
    key = lasting_key(level_terms, pendulum(), 3)
    assert key == lasting_key(level_terms, pendulum(L=2.5), 3)
    others = [
        lasting_key(native, pendulum(), 3),
        lasting_key(level_terms, pendulum(), 4),
        lasting_key(level_terms, derived(bricard.mechanism().problem((0, 1))), 3),
        lasting_key(level_terms, cranks(None), 3),
    ]
    monkeypatch.setattr(contents, "_sources", lambda: b"an edit")
    others.append(lasting_key(level_terms, pendulum(), 3))
    assert len({key, *others}) == 1 + len(others)


class Own(hb.System):
    mass_matrix = 1.0

    def force(self, t, q, v):
        return -q


def own(dynamics, *arrays):
    return arrays[0]


@pytest.mark.parametrize(
    "values",
    [
        (level_terms, Own()),
        (level_terms, derived(simple_pendulum.problem())),
        (own, None),
        (lambda x: x, None),
        (functools.wraps(contact.depth)(lambda gap, onset: gap), None),
        (level_terms, cranks(lambda t: t)),
        (level_terms, jnp.sin),
    ],
    ids=["class", "problem", "function", "lambda", "wrapped", "law", "library"],
)
def test_what_others_wrote_has_no_key(values):
    assert lasting_key(*values) is None


def test_files_that_changed_after_their_import_leave_no_key(monkeypatch):
    assert lasting_key(level_terms, pendulum(), 3) is not None
    monkeypatch.setattr(contents, "BEGAN", 0.0)
    assert lasting_key(level_terms, pendulum(), 3) is None


def test_numbers_that_are_no_parameters_are_in_the_key():
    keys = [lasting_key(level_terms, x) for x in (np.float64(1.5), np.float64(2.5), np.array([1.5]), np.array([2.5]), 1.5)]
    assert len(set(keys)) == 5


def afresh(monkeypatch, tree, lower=None):
    """The level's terms of ``tree`` at a state, as if the process were new."""
    for module, name in ((compiler, "_memory"), (compiler, "_last"), (flattening, "_jitted")):
        monkeypatch.setattr(module, name, Cache(64))
    if lower is not None:
        monkeypatch.setattr(compiler, "lower", lower)
    code = native(level_terms, tree, shapes=SHAPES)
    return native_call(code, SHAPES)(0.0, np.array([0.6, -0.8, 0.4]), np.array([0.4, 0.3, 2.0]))


def test_later_processes_trace_no_function_again(monkeypatch, empty_cache):
    def traces(*_):
        raise AssertionError("it is traced")

    with pytest.raises(AssertionError, match="it is traced"):
        afresh(monkeypatch, pendulum(), traces)
    monkeypatch.undo()
    monkeypatch.setenv("HHTBENCH_CACHE", str(empty_cache))
    values = [afresh(monkeypatch, pendulum(L=L)) for L in (1.5, 2.5)]
    found = [afresh(monkeypatch, pendulum(L=L), traces) for L in (1.5, 2.5)]
    np.testing.assert_array_equal(found, values)
    assert (values[0] != values[1]).any()
    with pytest.raises(AssertionError, match="it is traced"):
        afresh(monkeypatch, pendulum(L=1.0), traces)  # a length of one is folded: other code
