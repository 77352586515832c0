"""``hhtbench verify b`` in small: its closed forms hold, its rows can fail, and its judgement, from runs made by hand."""

import math

import numpy as np
import pytest

from hhtbench.conformance.scenes.linkages import DoublePendulum
from solvers.hht import HHT
from solvers.hht.verify import weights

CONSTANT = "constant steps"


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


@pytest.mark.parametrize(("costs", "passed"), [((0.3, 0.4, 1.1), True), ((0.3, 1.2, math.inf), False)])
def test_the_median_over_the_library_is_judged(costs, passed):
    found = [dict.fromkeys(weights.METHODS, cost) for cost in costs]
    rows = weights.work_rows(CONSTANT, dict(zip("xyz", found, strict=True)))
    judged = [row for row in rows if row.passed is not None]
    assert [(row.measured, row.passed) for row in judged] == [(sorted(costs)[1], passed)]
