"""Memory of solves: what stands in it before a run reaches no result, and what is kept after it is bounded (row R7)."""

import gc
import weakref

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System
from solvers.hht import HHT
from solvers.hht.run import engine_pool
from solvers.hht.run.functions import Functions
from solvers.hht.run.history import History
from solvers.hht.run.loops import Loops
from solvers.kernel import memory as mem

ZEROS = mem.VALUES, mem.ATTEMPT  # where they are entries, and say that nothing was seen
WORK = [number for number in range(len(mem._floats)) if number not in ZEROS]
SHORT = {"planar_chain(n_links=4)": 0.3, "andrews": 1e-3}  # [s]; others a second
CASES = [
    ("jay_negrut_pendulum", {}, {"steps": 50}),
    ("jay_negrut_pendulum", {"alpha": -0.3, "extrapolate_reaction": True}, {"rtol": 1e-5}),
    ("jay_negrut_pendulum", {"linsolver": "sparse"}, {"rtol": 1e-5}),
    ("planar_chain(n_links=4)", {}, {"rtol": 1e-4}),
    ("planar_chain(n_links=4)", {"linsolver": "band"}, {"steps": 30}),
    ("andrews", {}, {"rtol": 1e-4}),
    ("heavy_top", {"engine": "python"}, {"steps": 300}),
    ("jay_negrut_pendulum", {"events": [Event(lambda t, q, v: q[0], name="side")]}, {"rtol": 1e-5}),
]


def solve(name, options, request):
    given = hb.load_problem(name)
    span = given.t_span[0], given.t_span[0] + SHORT.get(name, 1.0)
    found = hb.HHT(given.system, **options).solve(span, given.q0, given.v0, **request)
    assert found.success, found.message
    return [getattr(found, x) for x in ("t", "q", "v", "lam", "mu")]


def made_with(monkeypatch, value, sections):
    """Engines are made anew, with ``value`` in these sections of their memory."""
    allocate, made = Functions.memory, []

    def memory(self, *sizes):
        z = allocate(self, *sizes)
        for number in sections:
            mem.view(z, number)[:] = value
        made.append(z)
        return z

    monkeypatch.setattr(Functions, "memory", memory)
    monkeypatch.setattr(engine_pool, "_pool", [])
    return made


@pytest.mark.parametrize(("name", "options", "request_"), CASES, ids=[f"{k}-{case[0]}" for k, case in enumerate(CASES)])
def test_nan_in_them_changes_no_bit(monkeypatch, name, options, request_):
    clean = solve(name, options, request_)
    made = made_with(monkeypatch, np.nan, WORK)
    poisoned = solve(name, options, request_)
    assert made and all(x.tobytes() == y.tobytes() for x, y in zip(clean, poisoned, strict=True))


def test_numbers_where_zeros_are_entries_are_seen(monkeypatch):
    """The test above can fail."""
    made_with(monkeypatch, np.nan, [mem.VALUES])
    with pytest.raises(AssertionError):
        solve("jay_negrut_pendulum", {"linsolver": "sparse"}, {"steps": 50})


def test_rows_do_not_wait_for_the_collector_when_a_solve_is_over():
    """Else its heap grows by hundreds of megabytes (row R7)."""

    def histories():
        return sum(type(x) is History for x in gc.get_objects())  # isinstance asks a dead proxy for its class

    gc.collect()
    before = histories()
    gc.disable()
    try:
        solve("jay_negrut_pendulum", {}, {"steps": 50})
        assert histories() == before
    finally:
        gc.enable()


class Free(System):
    """Mass points that nothing pulls."""

    def force(self, t, q, v):
        return 0.0 * q


@pytest.mark.parametrize("n", [20, 150])
def test_an_engine_that_is_not_kept_for_later_solves_is_freed_at_once(n, monkeypatch):
    """Without constraints, by full matrices and by bands: neither Python's cycles nor the callbacks hold its memory."""
    made = []
    original = Loops.__init__
    monkeypatch.setattr(Loops, "__init__", lambda own, *given: made.append(weakref.ref(own)) or original(own, *given))
    monkeypatch.setattr(engine_pool, "MAX_BYTES", 0)
    gc.collect()
    gc.disable()
    try:
        for system in (NumpySystem(force=lambda t, q, v: 0.0 * q), Free()):
            assert HHT(system).solve((0.0, 0.01), np.ones(n), np.zeros(n), step=0.005, t_eval=[0.0, 0.01]).success
        assert len(made) == 2
        assert [own() for own in made] == [None, None]
    finally:
        gc.enable()


def test_engines_for_later_solves_hold_no_more_than_64_megabytes():
    """One for 400 coordinates has 25."""
    for _ in range(4):
        system = NumpySystem(force=lambda t, q, v: 0.0 * q)
        assert HHT(system).solve((0.0, 0.01), np.ones(400), np.zeros(400), step=0.005, t_eval=[0.0, 0.01]).success
    assert 20e6 <= sum(engine.nbytes for _, engine in engine_pool._pool) <= 64 * 2**20
