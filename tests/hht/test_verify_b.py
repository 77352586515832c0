"""``hhtbench verify b`` in small: its closed forms hold, its rows can fail, and its judgement, from runs made by hand."""

import math

import numpy as np
import pytest

from hhtbench import load_verification
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers.hht import HHT
from solvers.hht.verify import weights
from solvers.hht.verify.measure import Run

CONSTANT = "constant steps"


def test_it_is_registered():
    assert load_verification("b") is weights.verify_b


def test_vibrations_grow_above_the_limit_of_each_b_and_not_below_it(monkeypatch):
    """(h omega)^2 (1 - 2b) <= 4: Newmark's method with beta = b/2, gamma = 1/2."""
    assert weights.stability(100.0).passed
    honest = weights.growth
    monkeypatch.setattr(weights, "growth", lambda ratio, x, *rest, **method: honest(ratio, 0.99 * x, *rest, **method))
    assert not weights.stability(100.0).passed, "a limit that is one percent higher is seen"


def test_local_errors_of_a_pendulum_follow_their_formula(monkeypatch):
    assert weights.local_errors(5e-4).passed
    monkeypatch.setattr(weights, "LEADING", 1e-4)
    assert not weights.local_errors(5e-4).passed, "the leading term is not all of the error"


@pytest.mark.parametrize(
    ("method", "symmetric"),
    [({"b": 0.0}, True), ({"b": 0.2}, True), ({"b": 1.0}, True), ({"b": 0.2, "reaction": "predictor"}, False)],
    ids=str,
)
def test_without_damping_the_implicit_step_leads_there_and_back_for_every_b(method, symmetric):
    """It is symmetric: exchanging its ends and the sign of h gives the same equations."""
    system, (q0, v0) = DoublePendulum(ratio=2.0), DoublePendulum.bent(0.5, 1.5)
    there = HHT(system, alpha=0.0, **method).solve((0.0, 0.5), q0, v0, steps=100)
    back = HHT(system, alpha=0.0, **method).solve((0.5, 0.0), there.q[-1], there.v[-1], steps=100)
    assert bool(np.abs(back.q[-1] - q0).max() < 1e-11) is symmetric


def test_of_one_problem_steps_at_equal_error_are_fewer_with_both_kinds_of_steps():
    found = weights.work("simple_pendulum", CONSTANT)
    assert found["b = 0"] == 1.0
    assert found["b = 0.2"] < 0.4
    assert weights.work("simple_pendulum", "error control")["b = 0.2"] < 0.9


def test_runs_that_fail_cost_infinitely_much_and_declined_ones_are_a_gap(monkeypatch):
    outcome = {0.0: (1e-4, Status.success), 0.2: (None, Status.newton_failed), None: (None, Status.declined)}

    def run(name, request, **method):
        error, status = outcome.get(method.get("b"), (1e-4 / 4.0, Status.success))
        return Run(name, 1e-3, error, status, 10, 0)

    monkeypatch.setattr(weights, "run", run)
    found = weights.work("any", CONSTANT)
    assert (found["b = 0"], found["b = 0.1"], found["b = 0.2"]) == (1.0, 0.5, math.inf)
    assert math.isnan(found[weights.EXTRAPOLATED])


def test_a_problem_whose_error_is_roundoff_or_too_large_has_no_cost(monkeypatch):
    for error in (1e-15, 1.0, None):
        monkeypatch.setattr(
            weights, "run", lambda name, request, error=error, **method: Run(name, 1, error, Status.success, 9, 0)
        )
        assert weights.work("any", CONSTANT) == {}


@pytest.mark.parametrize(("costs", "passed"), [((0.3, 0.4, 1.1), True), ((0.3, 1.2, math.inf), False)])
def test_the_median_over_the_library_is_judged(costs, passed):
    found = [dict.fromkeys(weights.METHODS, cost) for cost in costs]
    rows = weights.work_rows(CONSTANT, dict(zip("xyz", found, strict=True)))
    judged = [row for row in rows if row.passed is not None]
    assert [(row.measured, row.passed) for row in judged] == [(sorted(costs)[1], passed)]


def test_the_constrained_problems_are_those_with_position_constraints():
    names = weights.constrained()
    assert {"simple_pendulum", "arevalo_circle", "driven_coordinate"} <= set(names)
    assert not {"knife_edge", "fput_chain"} & set(names)
