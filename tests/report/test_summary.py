from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import pytest

from hhtbench.analysis import compare, family
from hhtbench.report.summary import problem_summary, summary
from hhtbench.report.words import times
from tests.analysis.laws import failed, law, run

NUMBER = r"(\d[\d.]*(?:e[-+]\d+)?)"


def _numbers(pattern, text):
    found = re.search(pattern.replace("#", NUMBER), text)
    assert found, f"{pattern} is not in: {text}"
    return [float(group) for group in found.groups()]


def _three(value):
    return float(f"{value:.3g}")


def _contest(hht, other, **changes):
    return [*law("hht(alpha=0)", hht, 2, drift=2e-15, **changes), *law("ida(form=ggl)", other, 2, drift=5e-9, **changes)]


def test_counts_of_outcomes_equal_the_rows(rows):
    text = summary(rows)[0]
    assert _numbers(r"^# of # runs reached the end \(# problems, # solvers\)", text) == [
        sum(row.success for row in rows),
        len(rows),
        len({row.problem for row in rows}),
        len({row.solver for row in rows}),
    ]
    told = {name: int(number) for name, number in re.findall(r"(\w+) (\d+)[,.]", text.partition("failures: ")[2])}
    assert told == Counter(row.status for row in rows if not row.success)


@pytest.mark.parametrize(("index", "measure"), [(1, "time"), (2, "evaluations")])
def test_wins_and_losses_equal_the_comparisons(rows, index, measure):
    lines = [line for line in compare(rows) if line.measure == measure and line.factor is not None]
    tally = Counter(line.outcome for line in lines)
    text = summary(rows)[index]
    assert _numbers("wins #", text) == [tally["wins"]]
    assert _numbers("loses #", text) == [tally["loses"]]
    assert _numbers("of # comparisons", text) == [len(lines)]
    worst = min(lines, key=lambda line: line.factor)
    assert f"It loses most on {worst.problem} at error {worst.target:.0e}: {worst.subject.entry} needs " in text
    multiple = _numbers("It loses most on .*? needs (?:at most |at least |about )?#\N{MULTIPLICATION SIGN}", text)
    assert multiple == [_three(worst.subject.value / worst.rival.value)]


def test_drifts_beside_the_worst_loss_are_those_of_the_two_rows(rows):
    worst = min((line for line in compare(rows) if line.measure == "time" and line.factor), key=lambda line: line.factor)
    text = summary(rows)[1]
    by_key = {row.key: row.metrics["drift"] for row in rows if row.metrics}
    mine, other = by_key[worst.subject.run.key], by_key[worst.rival.run.key]
    assert _numbers("drift there: position # against HHT's #, velocity # against HHT's #", text) == [
        _three(value) for value in (other["position"], mine["position"], other["velocity"], mine["velocity"])
    ]


def test_largest_drift_is_that_of_the_rows(rows):
    values = [
        row.metrics["drift"]["position"]
        for row in rows
        if row.success and family(row.solver) == "hht" and row.metrics["drift"]["position"] is not None
    ]
    text = " ".join(summary(rows))
    assert _numbers("HHT's largest position drift over all its successful runs is #", text) == [_three(max(values))]
    worst = {}
    for row in rows:
        value = row.metrics.get("drift", {}).get("position")
        if row.success and family(row.solver) != "hht" and value is not None:
            worst[row.solver] = max(value, worst.get(row.solver, 0.0))
    best = min(worst, key=worst.get)
    assert f"{best.replace(chr(39), '')} keeps it smallest, at most {worst[best]:.3g}" in text
    assert f"lets it grow to {max(worst.values()):.3g}" in text


def test_loss_is_said_with_factor_rival_and_its_drift():
    text = " ".join(summary(_contest(100.0, 25.0)))
    assert f"hht(alpha=0) needs {times(4)} the wall time of ida(form=ggl)" in text
    assert "position 5e-09 against HHT's 2e-15" in text
    assert "It wins none of them" in text
    assert "It wins most" not in text


def test_win_is_said_and_no_loss():
    rows = _contest(25.0, 100.0)
    text = " ".join([*summary(rows), *problem_summary(rows, "pendulum")])
    assert f"ida(form=ggl) needs {times(4)} the wall time of hht(alpha=0)" in text
    assert "It loses none of them" in text
    assert "loses 0" in text
    assert "It loses most" not in text
    assert "loses at" not in text


def test_problem_says_where_hht_loses_and_where_it_wins():
    rows = [*law("hht", 10.0, 2), *law("ida", 400.0, 4)]
    by_time, by_count = problem_summary(rows, "pendulum")
    assert by_time.replace("wall time", "residual evaluations") == by_count
    lines = [line for line in compare(rows) if line.measure == "evaluations"]
    assert [line.outcome for line in lines] == ["wins", "wins", "wins", "wins"]
    assert f"HHT wins at 1e-02 ({times(12.6)} against ida), 1e-03 ({times(7.11)} against ida)" in by_count
    rows = [*law("hht", 100.0, 2), *law("ida", 400.0, 4)]
    assert (
        f"HHT loses at 1e-03 ({times(1.41)} against ida), 1e-04 ({times(2.5)} against ida)"
        in problem_summary(rows, "pendulum")[1]
    )
    assert f"wins at 1e-02 ({times(1.26)} against ida)" in problem_summary(rows, "pendulum")[1]


def test_factor_from_an_upper_bound_says_so():
    rows = [*law("hht", 10.0, 2), run("ida", 1e-3, 1e-9, 1e6)]
    assert "at most " in problem_summary(rows, "pendulum")[1]
    rows = [run("hht", 1e-3, 1e-9, 1.0), *law("ida", 10.0, 2)]
    assert "at least " in problem_summary(rows, "pendulum")[1]


def test_missing_data_are_said():
    rows = _contest(100.0, 25.0)
    assert "HHT is not compared" in " ".join(summary([row for row in rows if "ida" in row.solver]))
    assert "never reach the same error" in " ".join(summary([row for row in rows if "hht" in row.solver]))
    unknown = [replace(row, metrics={"drift": {}}) for row in rows]
    assert "No error is known on pendulum" in " ".join(summary(unknown))
    assert "nothing can be compared (no exact solution" in problem_summary(unknown, "pendulum")[0]
    beside = [replace(row, timing={"solve_s": 1.0, "best_s": None}) for row in rows]
    assert f"{len(rows)} of {len(rows)} times were taken beside other work" in " ".join(summary(beside))
    silent = [replace(row, counters={}) for row in rows]
    assert "Evaluations are not reported by hht(alpha=0) and ida(form=ggl)" in " ".join(summary(silent))
    mixed = [*rows[:3], *(replace(row, environment={"python": "3.13"}) for row in rows[3:])]
    assert "The rows come from 2 environments" in " ".join(summary(mixed))


def test_failing_hht_is_said_where_others_get_there():
    rows = [failed("hht", 1e-3), *law("ida", 25.0, 2)]
    assert "HHT does not get to the error at all where others do: pendulum at 1e-02, 1e-03, 1e-04 and 1e-05." in " ".join(
        summary(rows)
    )
