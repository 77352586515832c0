from __future__ import annotations

from dataclasses import replace

import pytest

from hhtbench.campaign.analysis import compare, fronts, points
from hhtbench.campaign.analysis.fronts import level_of
from tests.analysis.laws import EVALUATION, failed, ladder, law, run

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


def test_best_of_the_family_stands_for_it():
    rows = [*law("hht(alpha=0)", 100.0, 2), *law("hht(alpha=-0.1)", 20.0, 2), *law("ida", 50.0, 2)]
    line = _one(rows)
    assert (line.outcome, line.subject.entry) == ("wins", "hht(alpha=-0.1)")
    assert line.factor == pytest.approx(2.5)


def timed(rows, *factors):
    """The same rows, timed in rounds that differ by ``factors``."""
    rounds = [[row.timing["best_s"] * factor for factor in factors] for row in rows]
    return [replace(row, timing={**row.timing, "rounds_s": each}) for row, each in zip(rows, rounds, strict=True)]


def test_factors_within_the_spread_of_repeats_are_level():
    rows = [*law("hht", 100.0, 2), *law("ida", 105.0, 2)]
    assert _one(rows, "time").outcome == "wins", "no repeats: every difference counts"
    rows = timed(rows, 1.0, 1.07)
    assert level_of(points(rows)) == pytest.approx(1.07)
    assert (_one(rows, "time").outcome, _one(rows).outcome) == ("level", "wins"), "evaluations do not vary"
    assert _one([*law("hht", 100.0, 2), *timed(law("ida", 120.0, 2), 1.0, 1.07)], "time").outcome == "wins"


def test_one_repeat_of_some_hundred_does_not_decide_what_is_level():
    runs = [*timed(law("hht", 1.0, 2) * 40, 1.0, 1.02), *timed(law("ida", 1.0, 2, (1e-2,)), 1.0, 9.0)]
    assert level_of(points(runs)) == pytest.approx(1.02)


def test_an_error_that_is_not_reached_has_the_reason_of_its_ladder_and_is_never_not_tried():
    fine = law("ida", 1.0, 2, (1e-1, 1e-2, 1e-3, 1e-5))
    coarse = law("hht", 9.0, 2, (1e-1, 1e-2))
    still = [run("hht", setting, 1e-2, 99) for setting in (1e-3, 1e-4, 1e-5)]
    cases = {
        ("capped", "more than 10 s at rtol 1e-04"): [*coarse, failed("hht", 1e-4, "deadline", "10 s")],
        ("fails", "newton_failed at rtol 1e-04 to rtol 1e-05"): [*coarse, failed("hht", 1e-4), failed("hht", 1e-5)],
        ("standstill", "no better when finer: error 0.01"): [*coarse, *still],
        ("refused", "refused: no"): [failed("hht", 1e-1, "declined", "no")],
        ("unfinished", "resume it"): coarse,
    }
    for (kind, text), rows in cases.items():
        line = _one(ladder([*rows, *fine]))
        assert (line.own_missing.kind, line.outcome) == (kind, "unknown" if kind == "unfinished" else "absent")
        assert text in line.own_missing.text
    assert _one(ladder(coarse, refinements=2) + ladder(fine)).own_missing.kind == "capped"


def test_who_does_not_get_there_pays_more_than_its_finest_run():
    rows = [*law("hht", 40.0, 2, (1e-1, 1e-2)), failed("hht", 1e-4, "deadline", "10 s"), *law("ida", 1.0, 2)]
    rows[2].timing["solve_s"] = 10.0
    line = _one(ladder(rows), "time")
    assert line.own_missing.bound == 10.0
    assert line.least_factor == pytest.approx(10.0 / (100.0 * EVALUATION))
    still = [*law("hht", 40.0, 2, (1e-1, 1e-2)), *(run("hht", 10.0**-k, 1e-2, 1000 * k) for k in (4, 5, 6, 7))]
    assert _one(ladder([*still, *law("ida", 1.0, 2)])).own_missing.bound == 7000


def test_who_alone_gets_there_is_told_with_what_the_others_need_at_least():
    rows = [*law("hht", 1.0, 2), *law("ida", 5.0, 2, (1e-1, 1e-2)), failed("ida", 1e-4, "deadline", "10 s")]
    line = _one(ladder(rows), "time")
    assert (line.outcome, line.rival) == ("alone", None)
    assert line.least_factor == pytest.approx(10.0 / (100.0 * EVALUATION))
    assert _one(ladder([*law("hht", 1.0, 2), *law("ida", 5.0, 2, (1e-1, 1e-2))]), "time").outcome == "unknown", "unfinished"


def test_settings_that_were_given_say_how_far_they_went_and_nobody_is_said_to_fail_beyond():
    rows = [*law("hht", 1.0, 2, (1e-1, 1e-2)), *law("ida", 1.0, 2)]
    line = _one(rows)
    assert (line.outcome, line.own_missing.kind) == ("unknown", "not asked")
    assert line.own_missing.text == "smallest error 0.01; finest run rtol 1e-02, error 0.01"
    assert _one(law("hht", 1.0, 2) + law("ida", 1.0, 2, (1e-1, 1e-2))).outcome == "unknown"
    assert _one([*rows, failed("hht", 1e-4)]).outcome == "absent", "a finer one was asked for, and failed"


def test_who_was_asked_for_looser_errors_only_is_not_said_to_fail_at_others():
    loose = ladder(law("hht", 1.0, 2, (1e-1, 1e-2)), accuracies=[1e-2])
    line = _one([*loose, *ladder(law("ida", 1.0, 2))])
    assert (line.outcome, line.own_missing.kind) == ("unknown", "not asked")


def test_nothing_is_said_of_one_who_has_nobody_to_be_compared_with():
    assert _one(law("hht", 1.0, 2)).outcome == "unknown"
    assert _one([*law("hht", 1.0, 2, (1e-1,)), *law("ida", 1.0, 2, (1e-1,))]).outcome == "unknown"


def test_steady_comparison_takes_only_runs_whose_drift_stays_within_the_bound():
    rows = [*law("hht", 100.0, 2, drift=1e-15), *law("loose", 10.0, 2, drift=1e-6), *law("held", 40.0, 2, drift=5e-9)]
    (line,) = [line for line in compare(rows, targets=[1e-4], held=1e-8) if line.measure == "evaluations"]
    assert (line.rival.entry, line.factor) == ("held", pytest.approx(0.4))
    assert line.missing["loose"].text == "drifts by 1.0e-06 or more, above 1e-08"
    (line,) = [line for line in compare(rows[:12], targets=[1e-4], held=1e-8) if line.measure == "evaluations"]
    assert line.outcome == "unheld"


def test_drift_that_was_not_measured_is_not_called_steady_and_free_systems_are_not_compared():
    unknown = law("ida", 10.0, 2)
    assert [line.rival for line in compare([*law("hht", 100.0, 2, drift=1e-15), *unknown], held=1e-8)] == [None] * 14
    assert compare([*law("hht", 100.0, 2), *unknown], held=1e-8) == ()


def test_evaluations_that_are_not_reported_have_no_cost_but_time_has():
    rows = [replace(row, counters={"residual_evaluations": None}) for row in law("diffrax", 1.0, 2)]
    assert fronts(rows, "evaluations", [1e-4])[0].missing["diffrax"].text == "evaluations not reported"
    assert fronts(rows, "time", [1e-4])[0].costs[0].entry == "diffrax"


def test_evaluations_count_by_their_operations():
    """The acceleration is called half as often, and takes three times the operations of a residual."""
    calls = {"ida": {"operations": 100, "of_residual": 100}, "cvode": {"operations": 300, "of_residual": 100}, "own": None}
    rows = [*law("ida", 10.0, 2), *law("cvode", 5.0, 2), *law("own", 12.0, 2)]
    told = [replace(row, metrics={**row.metrics, "call": calls[row.solver]}) for row in rows]
    alike, weighed = (fronts(found, "evaluations", [1e-4])[0].costs for found in (rows, told))
    assert [(cost.entry, round(cost.value)) for cost in alike] == [("cvode", 500), ("ida", 1000), ("own", 1200)]
    assert [(cost.entry, round(cost.value)) for cost in weighed] == [("ida", 1000), ("own", 1200), ("cvode", 1500)]
