"""The ladder of settings against solvers that follow known laws."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from hhtbench.campaign.analysis.cells import Rules, points
from hhtbench.campaign.analysis.ladder import FIRST, End, Next, next_setting
from tests.analysis.laws import failed, run

RULES = Rules(accuracies=(1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7), max_seconds=10.0, pair_seconds=30.0, refinements=16)


def climb(solver, rules=RULES, kind="rtol"):
    """All rows that the ladder asks ``solver(setting) -> row`` for, and how it ends."""
    rows = []
    while isinstance(asked := next_setting(points(rows), rules, kind), Next):
        setting = asked.value if kind == "rtol" else round(1 / asked.value)
        request = {"rtol": None, "atol": None, "step": None, "steps": None, kind: setting, "max_seconds": asked.seconds}
        rows.append(replace(solver(asked.value), request=request, key=str(len(rows))))
        assert len(rows) <= rules.refinements
    return rows, asked


def law(factor=1.0, order=1.0, cost=1e-4, power=0.5, floor=0.0):
    """Error ``factor * setting ** order``, never below ``floor``; seconds ``cost * setting ** -power``."""
    return lambda setting: run("it", setting, max(factor * setting**order, floor), cost * 1e5 * setting**-power)


def errors(rows):
    return [row.metrics["errors"]["q"]["max_scaled"] for row in rows]


@pytest.mark.parametrize("order", [0.8, 1.0, 1.3])
@pytest.mark.parametrize("factor", [1e-2, 1.0, 30.0])
def test_every_target_is_reached_and_none_is_overshot_twice(order, factor):
    rows, end = climb(law(factor, order, power=0.1))
    assert end.kind == "reached"
    found = errors(rows)
    assert min(found) <= 1e-7
    first = max(found[0], 1e-1)
    for target in RULES.accuracies:
        if target < first:
            reached = [error for error in found if error <= target]
            assert max(reached) >= 1e-3 * target, "a run at each target, not far below it"


def test_constant_steps_climb_by_their_order():
    rows, end = climb(law(30.0, 2, power=0.1), kind="steps")
    assert end.kind == "reached"
    assert [row.request["steps"] for row in rows] == sorted({row.request["steps"] for row in rows})
    assert all(isinstance(row.request["steps"], int) for row in rows)


def test_settings_have_two_digits_and_fall():
    rows, _ = climb(law())
    settings = [row.request["rtol"] for row in rows]
    assert settings[0] == FIRST["rtol"]
    assert settings == sorted(set(settings), reverse=True)
    assert all(float(f"{setting:.1e}") == setting for setting in settings)


def test_the_ladder_follows_from_the_rows_in_any_order():
    rows, end = climb(law(2.0, 0.8))
    for count in range(len(rows)):
        part = rows[:count]
        asked = next_setting(points(random.Random(count).sample(part, count)), RULES)
        assert asked.value == rows[count].request["rtol"]
    assert next_setting(points(rows[::-1]), RULES) == end


def test_an_error_that_stands_still_over_more_than_a_factor_of_a_thousand_ends_the_ladder():
    rows, end = climb(law(floor=3e-5))
    assert (end.kind, sum(error == 3e-5 for error in errors(rows))) == ("standstill", 4)
    assert "no better when finer: error 3e-05" in end.text
    still = [row.request["rtol"] for row in rows if errors([row]) == [3e-5]]
    assert still[0] / still[-1] > 1e3


def test_an_error_that_stands_still_for_a_while_goes_on():
    _, end = climb(lambda s: run("it", s, s if s < 1e-7 or s > 1e-5 else 1e-5, 100))
    assert end.kind == "reached"


def test_errors_above_the_loosest_target_are_no_standstill():
    rows, end = climb(lambda setting: run("it", setting, 5.0 if setting > 1e-4 else setting, 100))
    assert end.kind == "reached"
    assert errors(rows)[:2] == [5.0, 5.0]


def test_failures_at_loose_settings_are_passed_over_until_six():
    rows, end = climb(lambda s: failed("it", s) if s > 1e-4 else law()(s))
    assert ([row.success for row in rows[:4]], end.kind) == ([False, False, False, True], "reached")
    rows, end = climb(lambda s: failed("it", s))
    assert (len(rows), end.kind) == (6, "fails")
    assert "newton_failed at rtol 3e-02 to rtol 3e-07: no convergence" in end.text


def test_a_failure_beyond_a_success_is_approached_passed_once_and_then_ends_the_ladder():
    rows, end = climb(lambda s: law()(s) if s > 1e-5 else failed("it", s))
    assert [row.success for row in rows[-4:]] == [False, True, True, False]
    assert (sum(not row.success for row in rows), end.kind) == (2, "fails")
    assert rows[-1].request["rtol"] < rows[-4].request["rtol"] < rows[-2].request["rtol"] <= 1.4e-5


def test_a_single_failure_is_passed():
    rows, end = climb(lambda s: failed("it", s) if 4e-6 < s < 7e-6 else law()(s))
    assert end.kind == "reached"
    assert sum(not row.success for row in rows) == 1


@pytest.mark.parametrize("status", ["deadline", "max_steps", "evaluation_budget"])
def test_the_run_that_used_up_what_it_may_is_the_cap(status):
    rows, end = climb(lambda s: law()(s) if s > 1e-4 else failed("it", s, status, "used up"))
    assert (rows[-1].status, end.kind) == (status, "capped")
    assert end.text.endswith(f"at {points(rows)[-1].setting.text}")
    assert [row.success for row in rows[:-1]] == [True] * (len(rows) - 1)


def test_refused_once_is_refused():
    rows, end = climb(lambda s: failed("it", s, "declined", "no constraints"))
    assert (len(rows), end) == (1, End(kind="refused", text="refused: no constraints"))


def test_seconds_of_the_pair_end_it_before_a_run_that_cannot_fit():
    rows, end = climb(law(cost=0.5))
    assert (end.kind, end.text[:12]) == ("capped", "what is left")
    assert sum(row.timing["solve_s"] for row in rows) <= RULES.pair_seconds
    assert all(row.request["max_seconds"] <= RULES.max_seconds for row in rows)


def test_the_number_of_runs_ends_it():
    rows, end = climb(law(), replace(RULES, refinements=3))
    assert (len(rows), end.kind) == (3, "capped")


def test_targets_that_the_reference_cannot_judge_are_not_chased():
    def four_digits(setting):
        row = law()(setting)
        return replace(row, metrics={"errors": row.metrics["errors"] | {"digits": 4}})

    rows, end = climb(four_digits)
    assert end.kind == "reached"
    assert 1e-5 < min(errors(rows)) <= 1e-4


def test_without_anything_to_compare_with_one_run_is_enough():
    rows, end = climb(lambda s: replace(law()(s), metrics={}))
    assert (len(rows), end.kind) == (1, "unjudged")


def test_two_crashes_end_the_ladder_since_no_tolerance_makes_them():
    rows, end = climb(lambda setting: failed("it", setting, status="crashed", message="the worker died"))
    assert (len(rows), end.kind) == (2, "fails")
    assert "the worker died" in end.text
