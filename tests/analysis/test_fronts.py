from __future__ import annotations

from dataclasses import replace

import pytest

from hhtbench.analysis import compare, fronts
from tests.analysis.laws import EVALUATION, failed, law, run

SETTINGS = (2e-2, 2e-3, 2e-4, 2e-5, 2e-6)  # none is a target: every cost is interpolated


def _one(rows, measure="evaluations", target=1e-4):
    (line,) = [line for line in compare(rows) if (line.measure, line.target) == (measure, target)]
    return line


@pytest.mark.parametrize("target", [1e-2, 1e-3, 1e-4, 1e-5])
def test_cost_between_two_runs_of_a_power_law_lies_on_the_law(target):
    rows = law("ida", 50.0, 4, SETTINGS)
    for measure, unit in (("evaluations", 1.0), ("time", EVALUATION)):
        (front,) = fronts(rows, measure, [target])
        assert front.costs[0].value == pytest.approx(50.0 * target**-0.25 * unit)
        assert front.costs[0].run.error <= target
        assert not front.costs[0].bound


def test_front_is_cheapest_first():
    rows = [*law("slow", 90.0, 2), *law("fast", 50.0, 4), *law("between", 60.0, 3)]
    (front,) = fronts(rows, "evaluations", [1e-4])
    assert [cost.entry for cost in front.costs] == ["fast", "between", "slow"]


def test_cost_of_a_solver_that_is_better_than_asked_is_an_upper_bound():
    (front,) = fronts([run("ida", 1e-3, 1e-6, 100)], "evaluations", [1e-2])
    assert (front.costs[0].value, front.costs[0].bound) == (100, True)


def test_run_that_another_beats_in_error_and_work_does_not_count():
    rows = [run("ida", 1e-2, 1e-2, 100), run("ida", 1e-3, 5e-2, 500), run("ida", 1e-4, 1e-4, 1000)]
    (front,) = fronts(rows, "evaluations", [1e-3])
    assert front.costs[0].value == pytest.approx((100 * 1000) ** 0.5)


def test_failed_run_has_no_cost_and_its_solver_says_why():
    rows = [run("ida", 1e-2, 1e-2, 100), replace(run("ida", 1e-4, 1e-6, 10), status="unreliable"), failed("cvode", 1e-3)]
    (front,) = fronts(rows, "evaluations", [1e-4])
    assert front.costs == ()
    texts = {entry: reason.text for entry, reason in front.missing.items()}
    assert texts == {"ida": "smallest error 0.01; unreliable 1 of 2", "cvode": "newton_failed 1 of 1"}
    assert {reason.kind for reason in front.missing.values()} == {"fails"}


def test_error_below_what_the_reference_can_judge_is_not_compared():
    rows = [*law("hht", 50.0, 2), *law("ida", 50.0, 4)]
    rows = [replace(row, metrics={"errors": row.metrics["errors"] | {"digits": 4}}) for row in rows]
    assert _one(rows, target=1e-4).outcome == "loses"
    assert _one(rows, target=1e-5).outcome == "unknown"
    assert "cannot judge" in _one(rows, target=1e-5).missing["ida"].text


def test_factor_is_the_ratio_of_the_two_laws():
    rows = [*law("hht(alpha=0)", 100.0, 2, drift=1e-15), *law("ida", 50.0, 2, drift=1e-9), *law("scipy", 400.0, 2)]
    line = _one(rows)
    assert (line.outcome, line.rival.entry) == ("loses", "ida")
    assert line.factor == pytest.approx(0.5)
    assert line.drift_ratio("position") == pytest.approx(1e6)


def test_best_of_the_family_stands_for_it():
    rows = [*law("hht(alpha=0)", 100.0, 2), *law("hht(alpha=-0.1)", 20.0, 2), *law("ida", 50.0, 2)]
    line = _one(rows)
    assert (line.outcome, line.subject.entry) == ("wins", "hht(alpha=-0.1)")
    assert line.factor == pytest.approx(2.5)


def test_factors_within_the_noise_of_timings_are_level():
    assert _one([*law("hht", 100.0, 2), *law("ida", 105.0, 2)]).outcome == "level"
    assert _one([*law("hht", 100.0, 2), *law("ida", 120.0, 2)]).outcome == "wins"


def test_error_that_nobody_asked_for_is_not_tried_and_one_that_failed_is_not_reached():
    coarse, fine = (1e-1, 1e-2), (1e-1, 1e-2, 1e-4)
    assert _one([*law("hht", 1.0, 2, fine), *law("ida", 1.0, 2, coarse)]).outcome == "unrivalled"
    assert _one([*law("hht", 1.0, 2, fine), *law("ida", 1.0, 2, coarse), failed("ida", 1e-4)]).outcome == "alone"
    assert _one([*law("hht", 1.0, 2, coarse), *law("ida", 1.0, 2, fine)]).outcome == "untried"
    assert _one([*law("hht", 1.0, 2, coarse), failed("hht", 1e-4), *law("ida", 1.0, 2, fine)]).outcome == "absent"
    assert _one([*law("hht", 1.0, 2, coarse), *law("ida", 1.0, 2, coarse)]).outcome == "unknown"


def test_error_that_stands_still_at_finer_settings_is_not_reached():
    still = [*law("hht", 1.0, 2, (1e-1, 1e-2)), run("hht", 1e-4, 0.9e-2, 1000)]
    line = _one([*still, *law("ida", 1.0, 2, (1e-1, 1e-4))])
    assert (line.outcome, line.own_missing.text) == ("absent", "smallest error 0.009; finer settings do not help")


def test_reason_is_that_of_the_entry_which_was_only_not_tried():
    rows = [failed("hht(alpha=0)", 1e-4), *law("hht(alpha=-0.3)", 1.0, 2, (1e-1, 1e-2)), *law("ida", 1.0, 2, (1e-1, 1e-4))]
    assert _one(rows).own_missing.text == "not tried: finest run rtol 1e-02, error 0.01"


def test_steady_comparison_takes_only_runs_whose_drift_stays_within_the_bound():
    rows = [*law("hht", 100.0, 2, drift=1e-15), *law("loose", 10.0, 2, drift=1e-6), *law("held", 40.0, 2, drift=5e-9)]
    (line,) = [line for line in compare(rows, targets=[1e-4], held=1e-8) if line.measure == "evaluations"]
    assert (line.rival.entry, line.factor) == ("held", pytest.approx(0.4))
    assert line.missing["loose"].text == "drifts by 1.0e-06 or more, above 1e-08"
    (line,) = [line for line in compare(rows[:12], targets=[1e-4], held=1e-8) if line.measure == "evaluations"]
    assert line.outcome == "unheld"


def test_drift_that_was_not_measured_is_not_called_steady_and_free_systems_are_not_compared():
    unknown = law("ida", 10.0, 2)
    assert [line.rival for line in compare([*law("hht", 100.0, 2, drift=1e-15), *unknown], held=1e-8)] == [None] * 8
    assert compare([*law("hht", 100.0, 2), *unknown], held=1e-8) == ()


def test_drift_of_zero_counts_as_rounding():
    line = _one([*law("hht", 1.0, 2, drift=0.0), *law("ida", 1.0, 2, drift=1e-8)])
    assert line.drift_ratio("position") == pytest.approx(1e-8 / 2**-52)


def test_evaluations_that_are_not_reported_have_no_cost_but_time_has():
    rows = [replace(row, counters={"residual_evaluations": None}) for row in law("diffrax", 1.0, 2)]
    assert fronts(rows, "evaluations", [1e-4])[0].missing["diffrax"].text == "evaluations not reported"
    assert fronts(rows, "time", [1e-4])[0].costs[0].entry == "diffrax"
