"""``verify paper`` on coarse levels: its claims hold, and each kind of row fails when the method is broken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hhtbench import load_problem
from hhtbench.errors import ProblemError
from solvers.hht.equations import known
from solvers.hht.verify import constraints, figures, local, orders
from solvers.hht.verify.measure import integrate, known_at, make_case, scaled_drift, slope
from tests.hht.scenes import forget_code

LEVELS = orders.Levels(constant=(50, 100, 200), periods=(20, 40), lost=(320, 640), b=0.3)
ALL_METHODS = list(orders.methods())


def silent(line: str) -> None:
    """Progress that nobody reads."""


@pytest.fixture(scope="module")
def test1():
    return make_case("jay_negrut_test1", 1.0, 10)


@pytest.fixture(scope="module")
def pendulum():
    return make_case("jay_negrut_pendulum", 2.0, 25)


@pytest.mark.parametrize("method", ALL_METHODS, ids=lambda m: f"{m['reaction']}-b{m['b']:g}-alpha{m['alpha']:.3g}")
def test_every_member_of_the_family_is_of_order_two(test1, method):
    """Jay and Negrut (2007), Theorem 4.3 and figures 5.1, 5.2; a and v against f(t + alpha h) and the exact solution."""
    found, _ = orders.measured_orders(test1, list(LEVELS.constant), method)
    assert found == pytest.approx(dict.fromkeys("qva", 2.0), abs=0.06)


def test_alternating_steps_lose_an_order_without_rescaling_and_keep_it_with(test1):
    """Figures 5.3 and 5.4."""
    rows = orders.variable_steps(test1, LEVELS, silent)
    assert len(rows) == 15
    assert all(row.passed for row in rows)


def test_the_random_pattern_keeps_its_promise(test1):
    steps = orders.random_pattern(test1, 3)
    ratios = steps[1:] / steps[:-1]
    assert ratios.min() >= 0.5 - 1e-12
    assert ratios.max() <= 2.0 + 1e-12
    assert ratios.std() > 0.2
    assert steps.sum() == pytest.approx(1.0, abs=1e-14)


def test_errors_equal_those_of_an_independent_implementation(test1, pendulum):
    """Stored errors of a separate plain implementation of (3.4), kept with six to seven digits."""
    assert figures._agreement_test1(test1).passed
    stored = figures.independent_errors()["pendulum"]
    coarse = [{key: value[:4] if isinstance(value, list) else value for key, value in row.items()} for row in stored]
    assert max(figures._agreement_pendulum(pendulum, row) for row in coarse) < 1e-5


def test_local_errors_have_the_orders_of_theorem_4_3(test1):
    rows = local.local_errors(test1, (0.002, 0.001, 0.0005), silent)
    assert len(rows) == 15
    assert all(row.passed for row in rows)


def test_one_step_on_the_oscillator_is_the_closed_amplification_matrix():
    """acceptance of the closed forms: trace, minors and determinant, and the matrix entry by entry."""
    assert all(row.passed for row in local.amplification(silent))
    for alpha in orders.ALPHAS:
        measured = local._measured_matrix(alpha, 3.0, 0.05)
        np.testing.assert_allclose(measured, local.amplification_matrix(alpha, 3.0, 0.05), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("alpha", "frequency", "trace", "minors", "determinant"),
    [
        (0.0, 10.0, -1.846153846154, 1.0, 0.0),
        (-0.05, 0.1, 1.989913598113, 0.9997749642421, -0.0001125178789663),
        (-0.15, 1000.0, -1.654718453131, 0.8071840509408, -0.09640797452961),
        (-0.3, 1.0, 1.199884236928, 0.9432760949257, -0.02836195253714),
        (-1 / 3, 1e8, -1.5, 0.75, -0.125),
    ],
)
def test_the_closed_invariants_equal_stored_numbers(alpha, frequency, trace, minors, determinant):
    """Numbers to 12 digits from 60-digit arithmetic."""
    found = local.closed_invariants(alpha, frequency, 0.0)
    np.testing.assert_allclose(found, (trace, minors, determinant), rtol=0, atol=1e-12)


def test_stage_multipliers_are_first_order_their_mean_and_the_recovered_ones_second(test1):
    assert all(row.passed for row in constraints.multipliers(test1, [100, 200, 400], silent))


def test_the_result_does_not_depend_on_the_starting_multiplier(test1):
    """Remark 4.2."""
    assert local.multiplier_guess(test1, (1.0, 0.7, 0.9, 1.1), 0.01).passed


def test_a_guess_in_the_basin_of_the_other_root_is_seen_as_another_result(test1):
    """The row can fail: the second root of the reaction is near -3 at the start."""
    assert not local.multiplier_guess(test1, (1.0, -3.0), 0.01).passed


@pytest.mark.parametrize(("name", "label"), [("knife_edge", "velocity-level"), ("rolling_disk3d_steady", "mixed")])
def test_velocity_level_and_mixed_constraints_keep_order_two(name, label):
    """(6.1), and both kinds together."""
    case = make_case(name, 1.0, 20)
    keys = ("q", "v", "mu") if name == "knife_edge" else ("q", "v", "lam", "mu")
    found, _ = orders.measured_orders(case, [400, 800, 1600], {"alpha": -0.05, "b": 0.0}, keys)
    assert found == pytest.approx(dict.fromkeys(keys, 2.0), abs=0.06)


def test_both_levels_are_held_to_roundoff_at_every_step(test1):
    rows = constraints.drift(test1, 200, silent)
    assert len(rows) == 6
    assert all(row.passed for row in rows)


def test_drift_is_seen_where_there_is_some(test1):
    solution = integrate(test1, 50, alpha=-0.05)
    bent = replace(solution, q=solution.q + np.array([1e-8, 0.0]), v=solution.v + np.array([0.0, 1e-8]))
    position, velocity = scaled_drift(test1, bent)
    assert position > 1e-10
    assert velocity > 1e-10


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_wrong_weight_is_seen_as_a_lost_order(test1, monkeypatch, factor):
    """The order test can fail: one percent in one weight is enough."""
    honest = known.weighted

    def bent(*arguments):
        values = honest(*arguments)
        return {**values, "v_a": values["v_a"] * factor}

    monkeypatch.setattr(known, "weighted", bent)
    forget_code(monkeypatch)
    found, _ = orders.measured_orders(test1, [50, 100, 200], {"alpha": -0.15, "b": 0.0})
    assert min(found["q"], found["v"]) < 1.5


def test_slope_reads_a_power_law():
    steps = [0.1, 0.05, 0.025]
    assert slope(steps, [3 * h**2 for h in steps]) == pytest.approx(2.0)


def test_values_known_at_a_time_are_found_by_that_time():
    """References hold a grid beside the stated times: the first row is the start."""
    andrews = load_problem("andrews")
    row = list(andrews.reference["t"]).index(0.03)
    assert row > 0
    np.testing.assert_array_equal(known_at(andrews, "v", 0.03), andrews.reference["v"][row])
    with pytest.raises(ProblemError, match=r"no row at t = 0\.0171 s"):
        known_at(andrews, "v", 0.0171)
