"""Minimal coordinates move like the problem, whatever its parameters, and bring its multipliers."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from hhtbench import list_problems, load_problem, load_solver, solve
from hhtbench.campaign.accuracy import compare
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.request import Request
from tests.problems.cases import CHANGED

KNOWN = (
    "bead_chain",
    "four_bars",
    "jay_negrut_pendulum",
    "pendulum_period2",
    "planar_chain",
    "redundant_pendulum",
    "simple_pendulum",
    "slider_crank_equal_lengths",
    "stiff_spring_pendulum",
)


def test_the_problems_that_have_them():
    assert tuple(name for name in list_problems() if load_problem(name).minimal is not None) == KNOWN


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("changed", [False, True])
def test_the_embedded_start_is_the_problems(name, changed):
    problem = load_problem(name, **(CHANGED[name] if changed else {}))
    found = problem.minimal()
    q, v = jax.jvp(found.embed, (np.asarray(found.s0, float),), (np.asarray(found.u0, float),))
    size = 1.0 + max(np.abs(problem.q0).max(), np.abs(problem.v0).max())
    assert np.abs(np.asarray(q) - problem.q0).max() <= 1e-14 * size
    assert np.abs(np.asarray(v) - problem.v0).max() <= 1e-14 * size


@pytest.mark.parametrize(
    ("problem", "inner"),
    [
        ("jay_negrut_pendulum", "solver=hht, alpha=-0.05"),
        ("pendulum_period2(t_end=2)", "solver=cvode, method=bdf"),
        ("slider_crank_equal_lengths(t_end=0.1)", "method=DOP853"),
        ("redundant_pendulum(t_end=1)", "method=DOP853"),
    ],
)
def test_the_motion_and_the_multipliers_are_the_problems(problem, inner):
    problem = load_problem(problem)
    times = [problem.t_span[1]] if problem.reference is None else problem.reference["t"]
    solver = load_solver(f"minimal({inner})")
    found = compare(problem, solver.solve(problem, Request(rtol=1e-8, t_eval=np.asarray(times, dtype=float))))
    assert max(found.scaled(name).max() for name in ("q", "v", "lam")) < 1e-4


def test_a_problem_without_them_is_declined_and_a_strange_solver_refused():
    assert "no minimal coordinates" in load_solver("minimal").accepts(load_problem("andrews"), Request(rtol=1e-3))
    assert solve("andrews", "minimal", rtol=1e-3).status.label == "declined"
    with pytest.raises(ProblemError, match="Did you mean cvode"):
        load_solver("minimal(solver=cvod)")
