"""``trade``: who reaches an error most cheaply, by solvers whose prices are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.advice import trading
from hhtbench.advice.rounds import UNTRIED
from hhtbench.advice.truth import Truth
from hhtbench.campaign.store import load_rows
from hhtbench.cli.main import main
from tests.report.drawings import figures_of

CHEAP, DEAR, MIDDLE = "priced(price=10)", "priced(price=1000)", "priced(price=15)"
OWN = hb.Problem(name="own", system=hb.NumpySystem(force=lambda t, q, v: -q), t_span=(0, 1), q0=[1], v0=[0])
CRANE = Path(__file__).parent.parent / "reference" / "mechanisms.py"
ASKED = {"on": "evaluations", "seconds": 300.0, "jobs": 1}


@pytest.fixture(scope="module")
def found(prices):
    solvers = [DEAR, CHEAP, "priced(does=decline)", MIDDLE, "priced(does=fail)", "priced(does=crash)"]
    return hb.trade("fall", accuracies=[1e-2, 1e-4], solvers=solvers, **ASKED)


def test_the_cheapest_is_taken_and_the_second_is_named_with_its_price(found):
    assert [choice.best.entry for choice in found.choices] == [CHEAP, CHEAP]
    assert [choice.second.entry for choice in found.choices] == [MIDDLE, MIDDLE]
    assert found.choices[1].best.run.error <= 1e-4
    told = found.choices[1].best.run
    assert found.choices[1].best.value == told.evaluations == pytest.approx(10 * told.setting.value**-0.25, rel=0.01)
    assert found.sentence.startswith(f"Take {CHEAP}: rtol ")
    assert f"the second choice, {MIDDLE}, costs 1.5 times as much" in found.sentence


def test_who_costs_several_times_the_best_is_given_up_with_the_factor(found):
    assert "times the cheapest" in found.left_out[DEAR]
    assert CHEAP not in found.left_out
    assert MIDDLE not in found.left_out


def test_a_candidate_that_crashes_is_named_and_the_others_go_on(found):
    assert "crashed" in found.left_out["priced(does=crash)"]
    assert "no weight falls here" in found.left_out["priced(does=fail)"]
    assert "it takes no weights" in found.left_out["priced(does=decline)"]
    assert "crashed" in str(found)


def test_where_all_fail_each_is_quoted_with_what_to_try(prices):
    found = hb.trade("fall", accuracies=[1e-2], solvers=["priced(does=fail)", "priced(does=decline)"], **ASKED)
    assert not found.choices
    for text in ("Cannot tell", "no weight falls here", "it takes no weights", "What to try", "hhtbench check"):
        assert text in found.sentence


def test_without_a_reference_nothing_is_judged_and_the_reason_is_told_with_what_each_says(prices, monkeypatch):
    nothing = Truth("nothing", missing="collocation and projected do not agree.")
    monkeypatch.setattr(trading, "truth_of", lambda *_: nothing)
    found = hb.trade("fall", accuracies=[1e-2], solvers=["priced(does=fail)"], **ASKED)
    assert not found.choices
    assert "collocation and projected do not agree" in found.sentence
    assert "no weight falls here" in found.sentence


@pytest.mark.long
def test_a_crane_whose_trolley_follows_a_table_gets_advice_that_names_the_jumps():
    """An answer to 6e-6 was called unreliable, and nothing was certified: at the kinks of the table velocities jump."""
    found = hb.trade(f"{CRANE}:crane", accuracies=[1e-2], solvers=["hht"], **ASKED)
    assert [choice.best.entry for choice in found.choices] == ["hht"], found.sentence
    assert "across the jumps of prescribed velocities at t = 1, 2.5, 4" in str(found)


def test_nobody_is_begun_once_the_time_is_up_and_all_are_named(prices):
    found = hb.trade("fall", accuracies=[1e-2], solvers=[CHEAP, MIDDLE], on="evaluations", seconds=1e-6, jobs=1)
    assert not found.choices
    assert found.left_out == dict.fromkeys([CHEAP, MIDDLE], "not tried: the time was up")
    assert f"{CHEAP}: not tried" in found.sentence


@pytest.mark.parametrize(("seconds", "now", "told"), [(5.0, 114.2, (5, 5)), (0.4, 103.0, (1, 1)), (60.0, 112.6, (12, 60))])
def test_a_trade_that_takes_longer_than_it_may_is_not_told_to_be_further_than_its_end(monkeypatch, seconds, now, told):
    monkeypatch.setattr(trading.time, "monotonic", lambda: now)
    found = []
    trading.pace_of(100.0, seconds, lambda *parts: found.append(parts))("accuracy", 3, 4)
    assert found == [("seconds", *told)]


def test_the_sentence_counts_who_was_not_tried(found):
    assert "not tried" not in found.sentence
    hurried = replace(found, left_out={**found.left_out, MIDDLE: UNTRIED})
    assert "; 1 candidates were not tried: give more seconds." in hurried.sentence


def test_errors_of_a_problem_without_scales_are_told_to_be_in_its_own_units(found):
    assert found.sentence.endswith("The problem declares no scales: errors are in its own units.")
    assert str(found).count("declares no scales") == 1


def test_rows_are_kept_in_a_store_and_taken_from_there(prices, tmp_path: Path):
    file = tmp_path / "runs.sqlite"
    first = hb.trade("fall", accuracies=[1e-2], solvers=[CHEAP], store=file, **ASKED)
    second = hb.trade("fall", accuracies=[1e-2], solvers=[CHEAP], store=file, **ASKED)
    assert [row.key for row in load_rows(file)] == [row.key for row in first.rows]
    assert [row.created for row in first.rows] == [row.created for row in second.rows]


def test_the_command_prints_draws_and_writes(prices, tmp_path: Path):
    page, data = tmp_path / "trade.html", tmp_path / "trade.json"
    options = ["--accuracy", "1e-2..1e-3", "--on", "evaluations", "--solvers", f"{CHEAP}, {MIDDLE}", "--jobs", "1"]
    result = CliRunner().invoke(main, ["trade", "fall", *options, "--page", str(page), "--json", str(data)])
    assert result.exit_code == 0, result.output
    assert f"Take {CHEAP}" in result.output
    told = json.loads(data.read_text())
    assert told["accuracies"] == [1e-2, 1e-3]
    assert [choice["solver"] for choice in told["choices"]] == [CHEAP, CHEAP]
    titles = [figure["layout"]["title"]["text"] for figure in figures_of(page.read_text()).values()]
    assert titles == ["Error against processor time", "Error against residual evaluations"]


@pytest.mark.parametrize(
    ("problem", "asked", "error", "text"),
    [
        ("fal", {}, hb.NotFoundError, "Did you mean fall"),
        ("fall", {"solvers": ["prised"]}, hb.NotFoundError, "Did you mean priced"),
        ("fall", {"accuracies": [2.0]}, hb.ProblemError, "between 0 and 1"),
        ("fall", {"accuracies": 1e-4}, hb.ProblemError, "accuracies must be a list of errors"),
        ("fall", {"accuracies": "1e-4"}, hb.ProblemError, "accuracies must be a list of errors"),
        ("fall", {"seconds": 0.0}, hb.ProblemError, "seconds must be above 0"),
        ("fall", {"drift": -1.0}, hb.ProblemError, "drift must be above 0"),
        ("fall", {"on": "memory"}, hb.ProblemError, "time or evaluations"),
        (3, {}, TypeError, "must be a spec, .* got 3"),
        (OWN, {"store": "runs.sqlite"}, hb.ProblemError, "store needs .* no imported file .* 'my.py:problem'"),
    ],
)
def test_wrong_use_is_refused_before_anything_runs(prices, problem, asked, error, text):
    with pytest.raises(error, match=text):
        hb.trade(problem, **asked)
