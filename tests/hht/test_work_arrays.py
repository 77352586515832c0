"""What stands in the work arrays before a run reaches no result (row R7 of the acceptance matrix)."""

import numpy as np
import pytest

import hhtbench as hb
from solvers.hht.loops import memory as mem
from solvers.hht.run import idle
from solvers.hht.run.functions import Functions

WORK = [number for number in range(mem.X, mem.CONSTANTS) if number != mem.VALUES]  # there zeros stand for entries
SHORT = {"planar_chain(n_links=4)": 0.3, "andrews": 1e-3}  # [s]; others a second
CASES = [
    ("jay_negrut_pendulum", {}, {"steps": 50}),
    ("jay_negrut_pendulum", {"alpha": -0.3, "extrapolate_reaction": True}, {"rtol": 1e-5}),
    ("jay_negrut_pendulum", {"linsolver": "sparse"}, {"rtol": 1e-5}),
    ("planar_chain(n_links=4)", {}, {"rtol": 1e-4}),
    ("planar_chain(n_links=4)", {"linsolver": "band"}, {"steps": 30}),
    ("andrews", {}, {"rtol": 1e-4}),
    ("heavy_top", {"engine": "python"}, {"steps": 300}),
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
    monkeypatch.setattr(idle, "_idle", [])
    return made


@pytest.mark.parametrize(("name", "options", "request_"), CASES, ids=str)
def test_nan_in_them_changes_no_bit(monkeypatch, name, options, request_):
    clean = solve(name, options, request_)
    made = made_with(monkeypatch, np.nan, WORK)
    poisoned = solve(name, options, request_)
    assert made and all(x.tobytes() == y.tobytes() for x, y in zip(clean, poisoned, strict=True))


def test_nan_in_the_state_is_seen(monkeypatch):
    """The test above can fail."""
    made_with(monkeypatch, np.nan, [mem.VALUES, mem.RECORD])
    with pytest.raises(AssertionError):
        solve("jay_negrut_pendulum", {"linsolver": "sparse"}, {"steps": 50})
