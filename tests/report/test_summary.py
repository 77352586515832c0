from __future__ import annotations

import re
from dataclasses import replace

import pytest

from hhtbench.campaign.analysis import compare
from hhtbench.report.contest import against, balance
from hhtbench.report.summary import summary
from hhtbench.report.words import times
from tests.analysis.laws import failed, ladder, law, run

NUMBER = r"(\d[\d.]*(?:e[-+]\d+)?)"


def _numbers(pattern, text):
    found = re.search(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern} is not in: {text}"
    return [float(group) for group in found.groups()]


def _three(value):
    return float(f"{value:.3g}")


def _compared(rows):
    """By time whatever the drift, and by evaluations: an outcome for each error."""
    by_time, *_, by_count = against(rows).rows
    return [[" ".join(filter(None, (cell.text, cell.detail))) for cell in line[3:]] for line in (by_time, by_count)]


def _contest(hht, other, **changes):
    return [*law("hht(alpha=0)", hht, 2, drift=2e-15, **changes), *law("ida(form=ggl)", other, 2, drift=5e-9, **changes)]


@pytest.mark.parametrize(
    ("index", "measure", "words"), [(2, "time", "processor time"), (3, "evaluations", "residual evaluations")]
)
def test_the_extremes_are_those_of_the_comparisons(rows, index, measure, words):
    lines = [line for line in compare(rows) if line.measure == measure and line.factor is not None]
    text = summary(rows)[index]
    assert text.startswith(f"By {words}, HHT's best entry is compared with the cheapest other solver")
    worst = min(lines, key=lambda line: line.factor)
    assert f"Its largest loss is on {worst.problem} at an error of {worst.target:.0e}: {worst.subject.entry} needs " in text
    multiple = _numbers("Its largest loss is on .*? needs (?:at most |at least |about )?#\N{MULTIPLICATION SIGN}", text)
    assert multiple == [_three(worst.subject.value / worst.rival.value)]


def test_solver_that_is_steady_only_where_it_is_far_more_accurate_is_not_called_steady():
    rows = _contest(100.0, 25.0)
    overdone = run("scipy", 1e-9, 1e-10, 900)
    overdone.metrics["drift"] = {"position": 1e-12, "velocity": 1e-12}
    text = " ".join(summary([*rows, overdone]))
    assert "0 of 1 other stay at or below 1e-10 at this accuracy; the largest is 5e-09" in text


def test_what_others_reach_with_more_drift_only_is_said_beside_the_tally():
    rows = [*law("hht", 100.0, 2, drift=1e-15), *law("ida", 40.0, 2, drift=1e-8)]
    text = summary(rows)[2]
    assert "is equal in 0 of 0 comparisons; in 6 more the others drift more" in text


@pytest.mark.parametrize(("hht", "ida", "said", "silent"), [(100.0, 25.0, "loss", "win"), (25.0, 100.0, "win", "loss")])
def test_loss_and_win_are_said_with_factor_and_rival_and_only_that_there_was(hht, ida, said, silent):
    text = " ".join(summary(_contest(hht, ida)))
    dear, cheap = ("hht(alpha=0)", "ida(form=ggl)") if said == "loss" else ("ida(form=ggl)", "hht(alpha=0)")
    assert f"Its largest {said} is on pendulum" in text
    assert f"{dear} needs {times(4)} the processor time of {cheap}" in text
    assert f"Its largest {silent}" not in text


def test_a_problem_says_where_hht_loses_and_where_it_wins():
    by_time, by_count = _compared([*law("hht", 10.0, 2), *law("ida", 400.0, 4)])
    assert by_time == by_count
    assert by_count[:2] == [f"wins {times(22.5)} against ida", f"wins {times(12.6)} against ida"]
    by_time, by_count = _compared([*law("hht", 100.0, 2), *law("ida", 400.0, 4)])
    outcomes = (("wins", 2.25), ("wins", 1.26), ("loses", 1.41), ("loses", 2.5))
    assert by_count[:4] == [f"{outcome} {times(factor)} against ida" for outcome, factor in outcomes]


def test_factor_from_an_upper_bound_says_so():
    rows = [*law("hht", 10.0, 2), run("ida", 1e-3, 1e-9, 1e6)]
    assert "at most " in " ".join(_compared(rows)[1])
    rows = [run("hht", 1e-3, 1e-9, 1.0), *law("ida", 10.0, 2)]
    assert "at least " in " ".join(_compared(rows)[1])


def test_missing_data_are_said():
    rows = _contest(100.0, 25.0)
    assert "HHT is not compared" in " ".join(summary([row for row in rows if "ida" in row.solver]))
    assert "never reach the same error" in " ".join(summary([row for row in rows if "hht" in row.solver]))
    unknown = [replace(row, metrics={"drift": {}}) for row in rows]
    assert "No error is known on pendulum" in " ".join(summary(unknown))
    assert "no exact solution or reference" in _compared(unknown)[0][0]
    beside = [replace(row, timing={"solve_s": 1.0, "best_s": None}) for row in rows]
    assert f"{len(rows)} of {len(rows)} times were taken beside other work and are upper bounds" in " ".join(summary(beside))
    silent = [replace(row, counters={}) for row in rows]
    expected = "Not ranked by evaluations: hht(alpha=0) and ida(form=ggl) (not counted)"
    assert expected in " ".join(summary(silent))
    once = [replace(row, metrics={**row.metrics, "errors": row.metrics["errors"] | {"points": 1}}) for row in rows]
    assert "On pendulum errors are compared at 1 time only." in " ".join(summary(once))
    slow = [replace(row, timing={**row.timing, "wall_s": row.timing["median_s"] * 2, "disturbed": True}) for row in rows]
    assert f"{len(rows)} of {len(rows)} times are marked *" in " ".join(summary(slow))
    assert "The median ratio of processor time to wall time of the timed solves is 0.50" in " ".join(summary(slow))
    mixed = [*rows[:3], *(replace(row, environment={"python": "3.13"}) for row in rows[3:])]
    assert "The rows come from 2 environments" in " ".join(summary(mixed))


def test_failing_hht_is_said_where_others_get_there():
    rows = [failed("hht", 1e-3), *law("ida", 25.0, 2)]
    assert "in 6 more only others reach the error" in " ".join(summary(rows))
    assert all(cell.startswith("HHT does not reach it newton_failed 1 of 1") for cell in _compared(rows)[0][:6])


def test_what_ended_a_ladder_is_counted_and_nothing_is_called_not_tried():
    given = [*law("hht", 100.0, 2, (1e-1, 1e-2, 2e-4)), *law("ida", 25.0, 2)]
    rows = ladder(given, accuracies=[1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7], refinements=3)
    text = " ".join(summary(rows))
    assert "Of 14 goals, each a problem, a solver and an error, 9 are reached. The others: limit of the campaign 5." in text
    assert "Not tried: 0." in text
    assert all("smallest error 0.0002; 3 runs, the most of one solver on one" in cell for cell in _compared(rows)[0][3:6])
    text = " ".join(summary(given))
    assert "9 are reached. The others: no run so accurate 5. Not tried: 5." in text
    assert all("smallest error 0.0002; finest run rtol 2e-04" in cell for cell in _compared(given)[0][3:])


def test_kvaerno_says_why_its_evaluations_are_not_ranked():
    rows = [replace(row, counters={}) for row in law("diffrax(method=Kvaerno5)", 25.0, 2)]
    assert "counting needs a second compilation" in " ".join(summary([*law("hht", 100.0, 2), *rows]))


def test_bounds_of_the_drift_that_change_nothing_are_said_once():
    rows = [*law("hht", 100.0, 2, drift=1e-15), *law("projected", 40.0, 2, drift=1e-15)]
    assert summary(rows)[2].count("HHT loses") + summary(rows)[2].count("HHT wins") == 1
    assert [line[0].text for line in balance(rows).rows] == [
        "any, \N{LESS-THAN OR EQUAL TO} 1e-06, \N{LESS-THAN OR EQUAL TO} 1e-10"
    ] * 2
