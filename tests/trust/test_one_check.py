"""``hb.solve`` makes the same check of every solver's success; ``solution.verify()`` judges as campaigns do."""

from __future__ import annotations

import gc
import pickle
import weakref
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.checks.result.judge import judge
from hhtbench.lowering import ConstraintLevels, derive, native
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.lowering.scalar_compiler import at_rows
from hhtbench.protocol.printing import exact
from solvers.hht.adapter import HHTSolver
from tests.trust.faulty import Faulty, Returning

PENDULUM = hb.load_problem("simple_pendulum")
TIMES = np.linspace(*PENDULUM.t_span, 41)
BESIDE = int(np.argmin(np.abs(TIMES - 0.5)))
SOLVERS = ("hht", "ida(form=ggl)", "cvode", "scipy(method=Radau)", "projected", "diffrax", "minimal(solver=cvode)")


def leaving(solve: Any) -> Any:
    """``solve``, whose one row at about half time is moved off the circle of radius L along it, by 1e-2 L."""

    def solved(self: Any, problem: hb.Problem, request: hb.Request) -> hb.Solution:
        found = solve(self, problem, request)
        return replace(found, q=np.where(np.arange(found.t.size)[:, None] == BESIDE, 1.01 * found.q, found.q))

    return solved


def test_hht_is_not_believed_where_it_leaves_a_constraint(monkeypatch: pytest.MonkeyPatch):
    """g = (1.01^2 - 1) L^2 for rows of size 2.02 (|x| + |y|) with scales of one."""
    monkeypatch.setattr(HHTSolver, "solve", leaving(HHTSolver.solve))
    found = hb.solve(PENDULUM, "hht", rtol=1e-7, t_eval=TIMES)
    x, y = found.q[BESIDE] / 1.01
    off = 0.0201 * (x * x + y * y) / (2.02 * (abs(x) + abs(y)))
    assert found.status is hb.Status.unreliable
    assert found.message == (
        f"constraints: g[0] is violated by up to {off:.2g} of its size, most at t = {exact(TIMES[BESIDE])}; "
        "up to 0.001 is believed."
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_is_checked_and_believed_where_it_is_right(solver: str, monkeypatch: pytest.MonkeyPatch):
    kind: Any = type(hb.load_solver(solver))
    assert hb.solve(PENDULUM, solver, rtol=1e-6, t_eval=TIMES).success
    monkeypatch.setattr(kind, "solve", leaving(kind.solve))
    assert hb.solve(PENDULUM, solver, rtol=1e-8, t_eval=TIMES).status is hb.Status.unreliable


class Rolling(hb.System):
    """Both kinds of constraints, one of which depends on time."""

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return jnp.zeros(3)

    def constraint(self, t: Any, q: Any) -> Any:
        return jnp.stack([q[0] ** 2 + q[1] ** 2 - (1.0 + t) ** 2, q[0] * q[2]])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        return jnp.stack([v[2] + q[1] * v[0] - q[0] * v[1]])


def test_levels_at_many_rows_are_those_at_each():
    q, v = np.random.default_rng(3).normal(size=(2, 7, 3))
    wide = np.hstack([q, v])  # rows that are parts of longer ones
    dynamics = derive(Rolling(), 0.0, q[0], v[0])
    together = at_rows(native(level_terms, dynamics, shapes=((), (3,), (3,))))(np.arange(7.0), wide[:, :3], wide[:, 3:])
    for row, found in enumerate(together):
        at = ConstraintLevels(dynamics).at(float(row), q[row], v[row])
        parts = at.position, at.time_derivative, at.position_jacobian, at.velocity, at.velocity_jacobian, at.velocity_drift
        assert found.tolist() == np.concatenate([np.ravel(part) for part in parts]).tolist()


@pytest.mark.parametrize("kind", [hb.System, hb.NumpySystem], ids=["machine code", "NumPy"])
@pytest.mark.parametrize(("name", "bent"), [("g[1]", "q"), ("the velocity level g_t + g_q v of g[0]", "v"), ("k[0]", "k")])
def test_the_message_names_the_constraint_and_its_time(kind: Any, name: str, bent: str):
    """On a growing circle with q = (1 + t, 0, 0) and v = (1, 0, 0); one row is off by one in one component."""
    functions = Rolling()
    system: Any = functions
    if kind is hb.NumpySystem:
        names = ("force", "constraint", "velocity_constraint")
        system = hb.NumpySystem(
            **{name: lambda *at, name=name: np.asarray(getattr(functions, name)(*at), dtype=float) for name in names}
        )
    t = np.linspace(0.0, 1.0, 5)
    q, v = np.column_stack([1.0 + t, 0 * t, 0 * t]), np.tile([1.0, 0.0, 0.0], (5, 1))
    problem = hb.Problem(name="growing", system=system, t_span=(0.0, 1.0), q0=q[0], v0=v[0])
    q[2, 2] += bent == "q"
    v[2, 0] += 2.0 * (bent == "v")
    v[2, 1] -= bent == "k"
    rows = {"t": t, "q": q, "v": v, "lam": np.zeros((5, 2)), "mu": np.zeros((5, 1))}
    told = hb.Solution(status=hb.Status.success, message="", **rows)

    found = hb.solve(problem, Returning(told), rtol=1e-4)
    assert found.message.startswith(f"constraints: {name} is violated by up to"), found.message
    assert "most at t = 0.5;" in found.message


def test_a_motion_by_other_forces_is_believed_at_first_and_found_by_verify():
    """Its forces are a fifth larger and its rows hold the constraint, so that only an integration can tell."""
    wrong = hb.solve(PENDULUM, Faulty("other force"), rtol=1e-6, t_eval=TIMES)
    assert wrong.success, wrong.message
    assert wrong.verify().doubt.startswith("equations of motion: from the row at t = ")


@pytest.mark.parametrize("solver", ["hht", "ida(form=ggl)"])
def test_verify_believes_what_is_right_and_is_the_judge_of_campaigns(solver: str):
    found = hb.solve(PENDULUM, solver, rtol=1e-6, t_eval=TIMES)
    judgement = found.verify(draw=7)
    assert (judgement.doubt, judgement.not_judged) == ("", "")
    assert judgement == judge(PENDULUM, hb.Request(rtol=1e-6, t_eval=TIMES), found, draw=7)
    assert judgement.windows


def test_a_pickled_solution_says_what_verify_needs():
    found = pickle.loads(pickle.dumps(hb.solve(PENDULUM, rtol=1e-4)))
    with pytest.raises(ValueError, match=r"judge\(problem, hhtbench.Request\(rtol=...\), solution\)"):
        found.verify()


def test_what_verify_needs_keeps_no_rows_alive():
    found = hb.solve(PENDULUM, rtol=1e-4)
    rows = weakref.ref(found.q)
    gc.disable()
    try:
        del found
        assert rows() is None
    finally:
        gc.enable()
