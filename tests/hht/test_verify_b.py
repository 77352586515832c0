"""``hhtbench verify b`` in small: its closed forms hold, its rows can fail, and its judgement, from runs made by hand."""

import math

import numpy as np
import pytest

from hhtbench import load_verification
from solvers.hht.verify import reaction_weight as weight
from solvers.hht.verify import weights
from solvers.hht.verify.work import CONSTANT, CONTROLLED, Run, steps_at


def test_it_is_registered():
    assert load_verification("b") is weights.verify_b


def test_local_errors_of_a_pendulum_follow_their_formula_and_no_other(monkeypatch):
    assert weight.local_errors(0.7, 2.0, 5e-4).passed
    honest = weight._local_error
    monkeypatch.setattr(weight, "_local_error", lambda b, *state: honest(b, *state) * [1.0, 1.02])
    assert not weight.local_errors(0.7, 2.0, 5e-4).passed


@pytest.mark.parametrize("amplitude", [0.1, math.pi / 2, 2.4])
def test_periods_of_swings_of_every_size_follow_their_formula(amplitude):
    assert weight.periods(amplitude, 400).passed


def test_small_swings_are_best_at_a_sixth_and_large_ones_at_a_fifth():
    """Fox and Goodwin's method for the small ones."""
    assert weight.period_error(1 / 6, 1e-3) == pytest.approx(0.0, abs=1e-7)
    assert weight.period_error(weight.BEST, math.pi / 2) == pytest.approx(0.0, abs=1e-15)
    assert weight.best(400).passed


def test_a_period_that_is_off_is_seen(monkeypatch):
    monkeypatch.setattr(weight, "BEST", 0.21)
    assert not weight.best(400).passed


def test_the_driven_circle_errs_as_its_two_local_errors_add_up():
    assert all(row.passed for row in weight.turning(2000))


def test_the_implicit_step_is_symmetric_for_every_b_without_damping():
    judged, shown = weight.symmetry(3, 100, 0.005)
    assert judged.passed
    assert shown.passed is None


def test_a_predicted_reaction_is_not_symmetric(monkeypatch):
    monkeypatch.setattr(
        weight, "WEIGHTS_OF", {**weight.WEIGHTS_OF, "implicit": ({"alpha": 0.0, "reaction": "predictor", "b": 0.2},)}
    )
    assert not weight.symmetry(3, 100, 0.005)[0].passed


def test_small_swings_of_a_chain_grow_just_above_the_bound_and_not_just_below(monkeypatch):
    assert all(row.passed for row in weight.bounds(2, 3))
    monkeypatch.setattr(weight, "MEETS", -weight.MEETS)
    assert not weight.bounds(2, 3)[0].passed


def test_long_swings_keep_their_energy_with_every_b_and_predictors_gain_some():
    rows = weights.energy((1, 1, 2, 0.0), 0.01, 5000, (0.0, -0.05))
    assert [row.passed for row in rows] == [True, True, None]
    gained = weights.energy_change((1, 1, 2, 0.0), {"alpha": 0.0, "b": 0.0, "reaction": "predictor"}, 0.01, 20_000)
    assert gained > 1e-4


def test_motions_that_cannot_be_followed_have_no_energy():
    assert math.isnan(weights.energy_change((2, 1, 3, 30.0), {"alpha": 0.0, "reaction": "predictor"}, 0.1, 2000))


def test_steps_at_an_error_are_read_where_runs_come_below_it_for_good():
    runs = [Run(10, 1e-4, 1.0), Run(20, 1e-1, 1.0), Run(40, 1e-3, 1.0), Run(80, 1e-5, 1.0)]
    assert steps_at(runs, 1e-2) == pytest.approx(20 * 2**0.5)
    assert steps_at(runs, 1e-4) == pytest.approx(40 * 2**0.5)
    assert math.isnan(steps_at(runs, 1e-6))
    assert steps_at(runs[2:], 1e-2) == 40, "at most the first run's, all are below"


def made(ratio):
    return weights.Saved(dict.fromkeys(weights.MAPPED, ratio), ratio, {}, 100.0, "")


def test_problems_that_take_more_steps_are_named_and_those_that_fail_count_as_the_worst():
    own = {"a": made(0.3), "c": made(0.4), "d": made(1.0), "e": made(math.inf), (1, 1, 2, 0.0): made(9.0)}
    rows = {row.id: row for row in weights.judged(CONTROLLED, own | {"neither": made(math.nan)})}
    assert rows[f"{CONTROLLED}/median"].measured == "0.70"
    assert rows[f"{CONTROLLED}/moved"].measured == "0.40"
    assert rows[f"{CONTROLLED}/worse"].measured == "e inf"
    assert "0.2: 9.00" in rows[f"{CONTROLLED}/drawn"].measured


def test_an_error_that_only_one_weight_reaches_is_no_gap(monkeypatch):
    """Runs with the weight fail; without it they do not."""
    monkeypatch.setattr(weights, "refined", lambda scene, kind, method, error: [] if method["b"] else [Run(9, 1e-9, 1.0)])
    monkeypatch.setattr(weights, "run", lambda scene, method, request: None if method["b"] else Run(9, 1e-9, 1.0))
    found = weights.saved((1, 1, 2, 0.0), CONSTANT)
    assert (found.over_b[0.0], found.over_b[0.1], found.over_b[0.2], found.fine) == (1.0, math.inf, math.inf, math.inf)


def test_energy_that_cannot_be_followed_is_no_pass(monkeypatch):
    monkeypatch.setattr(weights, "energy_change", lambda scene, method, h, steps: math.nan if method["b"] else 1e-9)
    assert weights.energy((1, 1, 2, 0.0), 0.01, 5, (0.0,))[0].passed is False


def test_the_map_shows_quartiles_and_extremes_over_b():
    plot = weights.drawn_map(CONSTANT, {str(x): made(x) for x in (0.1, 0.5, 0.9)})
    assert {curve.label: curve.y[0] for curve in plot.curves}["median"] == 0.5
    assert {curve.x for curve in plot.curves} == {weights.MAPPED}


def test_of_one_problem_steps_are_saved_with_both_kinds_of_steps():
    found = weights.saved("simple_pendulum", CONSTANT)
    assert found.over_b[0.0] == 1.0
    assert found.over_b[0.2] < 0.2
    assert found.over_alpha[0.0] == pytest.approx(found.over_alpha[-0.3], rel=1e-6), "the weight is constant"
    assert weights.saved("simple_pendulum", CONTROLLED).over_b[0.2] < 0.85


def test_the_constrained_problems_are_those_with_position_constraints():
    names = weights.constrained()
    assert {"simple_pendulum", "arevalo_circle", "driven_coordinate"} <= set(names)
    assert not {"knife_edge", "fput_chain"} & set(names)
    assert np.all(names == sorted(names))
