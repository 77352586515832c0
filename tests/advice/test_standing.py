"""Who is given up, and whom the sentence names, by rows that follow known laws."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hhtbench.advice.criteria import Criteria
from hhtbench.advice.standing import CostsSoFar
from hhtbench.advice.verdict import as_run, choices_of, ranking, sentence
from tests.analysis.laws import failed, law, run

CRITERIA = Criteria(accuracies=(1e-2, 1e-4), on="evaluations")
RULES = {"accuracies": [1e-2, 1e-4], "max_seconds": 1.0, "pair_seconds": 4.0, "refinements": 9}


def by_rules(rows):
    return [replace(row, request={**row.request, "rules": RULES}) for row in rows]


def test_a_candidate_that_costs_several_times_the_best_is_hopeless_and_one_that_costs_twice_is_not():
    rows = [*law("ida", 50.0, 4), *law("cvode", 100.0, 4), *law("scipy", 300.0, 4)]
    standing = CostsSoFar.of(rows, CRITERIA)
    assert standing.hopeless("ida") == ""
    assert standing.hopeless("cvode") == ""
    assert "6 times the cheapest" in standing.hopeless("scipy")


def test_a_candidate_that_is_dear_at_one_error_only_is_kept():
    standing = CostsSoFar.of([*law("ida", 50.0, 4), *law("hht", 20.0, 1.5)], CRITERIA)  # 2.7 and 19 times
    costs = {front.target: {cost.entry: cost.value for cost in front.costs} for front in standing.fronts}
    assert costs[1e-2]["hht"] < 4 * costs[1e-2]["ida"]
    assert costs[1e-4]["hht"] > 4 * costs[1e-4]["ida"]
    assert standing.hopeless("hht") == ""


def test_a_candidate_that_fails_is_hopeless_and_says_why():
    rows = by_rules([*law("ida", 50.0, 4), failed("cvode", 1e-2, status="declined", message="it cannot")])
    assert "it cannot" in CostsSoFar.of(rows, CRITERIA).hopeless("cvode")


def test_a_candidate_whose_time_was_up_is_unfinished_until_it_has_cost_several_times_the_best():
    late = failed("cvode", 1e-2, status="deadline", message="late")
    cheap = replace(late, counters={"residual_evaluations": 60, "provenance": "counted"})
    dear = replace(late, counters={"residual_evaluations": 10**6, "provenance": "counted"})
    for row, open_ in ((cheap, True), (dear, False)):
        standing = CostsSoFar.of(by_rules([*law("ida", 50.0, 4), row]), CRITERIA)
        assert standing.unfinished("cvode") is open_
        assert bool(standing.hopeless("cvode")) is not open_


def test_the_sentence_ranks_by_the_mean_over_the_errors_and_names_who_is_cheaper_at_one():
    rows = [*law("ida", 50.0, 4), *law("hht", 40.0, 3)]  # hht: 0.8 * e ** (1/4 - 1/3): 1.2 times at 1e-2, 1.7 at 1e-4
    fronts = CostsSoFar.of(rows, CRITERIA).fronts
    (first, one), (second, mean) = ranking(fronts)
    assert (first, second) == ("ida", "hht")
    assert one == pytest.approx(1.0)
    assert mean == pytest.approx(0.8 * (1e-2 * 1e-4) ** (-1 / 24), rel=1e-3)
    text = sentence(fronts, CRITERIA)
    assert text.startswith("Take ida: rtol 1e-04 gives an error of 0.0001 (asked: 0.0001)")
    assert "the second choice, hht, costs 1.4 times as much in the mean of the errors" in text
    assert [choice.second.entry for choice in choices_of(fronts)] == ["hht", "hht"]


def test_a_choice_names_its_solver_as_solve_takes_it_and_its_setting_beside():
    constant = run("hht(alpha=-0.05)", 1e-3, 1e-4, 100.0, request={"rtol": None, "atol": None, "step": None, "steps": 400})
    (choice,) = choices_of(CostsSoFar.of([constant], Criteria(accuracies=(1e-2,), on="evaluations")).fronts)
    assert (choice.best.entry, choice.solver) == ("hht(alpha=-0.05), steps=N", "hht(alpha=-0.05)")
    assert (choice.as_dict()["solver"], choice.as_dict()["setting"]) == ("hht(alpha=-0.05)", "400 steps")


def test_who_is_taken_is_the_cheapest_by_the_run_that_is_told_not_by_one_between_two():
    criteria = Criteria(accuracies=(1e-2,), on="evaluations")
    coarse, fine = run("ida", 3e-2, 3e-2, 60.0), run("ida", 3e-5, 3e-4, 130.0)  # about 75 between them at 1e-2
    rows = [coarse, fine, run("hht", 1e-3, 1e-3, 110.0)]
    between = CostsSoFar.of(rows, criteria).fronts
    assert between[0].costs[0].entry == "ida"
    fronts = as_run(between)
    assert ranking(fronts) == (("hht", pytest.approx(1.0)), ("ida", pytest.approx(130 / 110)))
    text = sentence(fronts, criteria)
    assert text.startswith("Take hht: rtol 1e-03 gives")
    assert "110 evaluations; the second choice, ida, costs 1.2 times as much" in text


def test_a_candidate_that_was_given_up_before_the_tightest_error_is_not_ranked_however_cheap_it_was():
    rows = by_rules([*law("ida", 50.0, 4), run("cvode", 1e-2, 1e-2, 3.0)])
    assert [entry for entry, _ in ranking(CostsSoFar.of(rows, CRITERIA).fronts)] == ["ida"]


def test_runs_that_drift_further_than_was_asked_do_not_count():
    rows = [*law("ida", 10.0, 4, drift=1e-4), *law("hht", 50.0, 4, drift=1e-13)]
    held = Criteria(accuracies=(1e-2,), on="evaluations", drift=1e-10)
    assert sentence(CostsSoFar.of(rows, held).fronts, held).startswith("Take hht")
    assert "drifts" in CostsSoFar.of(rows, held).hopeless("ida")


def test_an_error_that_nobody_reaches_is_said():
    criteria = Criteria(accuracies=(1e-2, 1e-9), on="evaluations")
    assert "1e-09 was reached by nobody" in sentence(CostsSoFar.of(law("ida", 50.0, 4), criteria).fronts, criteria)
