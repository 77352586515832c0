"""Radau IIA collocation, which makes the reference solutions: its order, its accuracy, and how it fails."""

import numpy as np
import pytest

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import collocation
from solvers.collocation import Collocation, extrapolation, radau_nodes
from tests.adapters.scenes import KINDS, errors, numpy_ring, problem

TIGHT = Request(rtol=1e-13, t_eval=np.linspace(0, 1, 7))


@pytest.mark.parametrize("stages", [2, 3, 5, 7, 9])
def test_the_nodes_integrate_polynomials_exactly_to_degree_two_s_minus_two(stages):
    """The quadrature of Radau's nodes; weights from the collocation matrix, the inverse of ``slope``."""
    nodes = radau_nodes(stages)
    weights = np.linalg.inv(nodes.slope)[-1]
    for degree in range(2 * stages - 1):
        assert weights @ nodes.c**degree == pytest.approx(1 / (degree + 1), abs=1e-13)
    assert weights @ nodes.c ** (2 * stages - 1) != pytest.approx(1 / (2 * stages), abs=1e-9 if stages < 7 else 0)


def test_the_last_coefficient_and_the_prediction_are_those_of_a_polynomial():
    nodes = radau_nodes(4)
    legendre = np.polynomial.Legendre([0.3, -1.0, 0.5, 0.2, 0.7], domain=[0, 1])
    z = legendre(nodes.c) - legendre(0.0)
    assert nodes.leading @ z == pytest.approx(0.7)
    for ratio in (0.5, 1.0, 2.0):
        np.testing.assert_allclose(extrapolation(nodes, ratio) @ z, legendre(1 + ratio * nodes.c) - legendre(1.0))


FORMS = [(kind, form) for kind in KINDS for form in ("ggl", "index2", "index1")]


@pytest.mark.parametrize(("kind", "form"), FORMS)
def test_closed_solutions_are_met_to_roundoff(kind, form):
    solver, scene = collocation.solver(form=form), problem(kind)
    if reason := solver.accepts(scene, TIGHT):
        assert kind == "unconstrained", reason
        return
    solution = solver.solve(scene, TIGHT)
    assert solution.status is Status.success, solution.message
    np.testing.assert_array_equal(solution.t, TIGHT.t_eval)
    q, v, lam, mu = errors(solution, KINDS[kind][1])
    assert max(q, v) < 2e-13
    assert max(lam, mu) < 2e-12


@pytest.mark.parametrize("form", ["ggl", "index2", "index1"])
@pytest.mark.parametrize("stages", [2, 3])
def test_the_error_falls_with_order_two_s_minus_one(form, stages, monkeypatch):
    """q and v of a mixed problem, equal steps: Hairer and Wanner, Solving ODEs II, table VII.4.1."""
    monkeypatch.setattr(collocation, "MAX_GROWTH", 1.0)
    monkeypatch.setattr(collocation, "MIN_GROWTH", np.inf)
    found = []
    for steps in (32, 64) if stages == 2 else (20, 40):
        monkeypatch.setattr(collocation, "FIRST_STEP", 1 / steps)
        solution = collocation.solver(form=form, stages=stages).solve(problem("mixed"), Request(rtol=1e-1, atol=1.0))
        assert solution.counters.steps_accepted == steps
        found.append(max(errors(solution, KINDS["mixed"][1])[:2]))
    slope = np.log2(found[0] / found[1])
    assert slope == pytest.approx(2 * stages - 1, abs=0.35)


def test_it_runs_backward():
    solution = collocation.solver().solve(problem("mixed", t_span=(1.0, 0.0)), Request(rtol=1e-12))
    assert solution.success
    assert max(errors(solution, KINDS["mixed"][1])[:2]) < 1e-11


def test_roundoff_of_stiff_forces_makes_no_short_steps():
    """A spring of 1e9 N/m at x = 1 + sin t: the last bit of x changes its force by 1e-7 N."""
    force = lambda t, q, v: -1e9 * (q - 1 - np.sin(t)) - 1e3 * (v - np.cos(t)) - np.sin(t)  # noqa: E731
    scene = Problem(name="x", system=NumpySystem(force=force), t_span=(0.0, 2.0), q0=[1.0], v0=[1.0])
    solution = collocation.solver(form="index1").solve(scene, Request(rtol=1e-11, max_num_steps=50))
    assert solution.success, solution.message
    np.testing.assert_allclose(solution.v[:, 0], np.cos(solution.t), atol=1e-8)


def test_budgets_and_bad_values_end_in_their_status():
    solver = collocation.solver()
    assert solver.solve(problem(), Request(rtol=1e-10, max_num_steps=2)).status is Status.max_steps
    assert solver.solve(problem(), Request(rtol=1e-10, max_evaluations=30)).status is Status.evaluation_budget
    lost = numpy_ring(force=lambda t, q, v: np.full(2, np.nan if t > 0.5 else 0.0))
    solution = solver.solve(lost, Request(rtol=1e-8))
    assert solution.status is Status.nonfinite_callback
    assert 0.3 < solution.t[-1] <= 0.5


def test_newton_that_never_contracts_ends_in_a_status_and_not_in_a_loop(monkeypatch):
    monkeypatch.setattr(Collocation, "_iterate", lambda *_: None)
    solution = collocation.solver().solve(problem(), Request(rtol=1e-8))
    assert solution.status in (Status.step_too_small, Status.newton_failed)


def test_wrong_options_are_told():
    with pytest.raises(ProblemError, match="stages must be from 2 to 12; got 1"):
        collocation.solver(stages=1)
    with pytest.raises(ProblemError, match="Did you mean ggl"):
        collocation.solver(form="gl")
    with pytest.raises(TypeError, match="does not know steps"):
        collocation.solver(steps=3)
