"""What surrounds the timings of ``make bench-engine``: rounds and verdicts, the contest, the printed tables and the page."""

import itertools
import json
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import plotly.graph_objects as go
import pytest

from hhtbench import load_problem, load_solver
from hhtbench.campaign.analysis import points
from hhtbench.solution.request import Request
from tests.analysis.laws import failed, law
from tests.performance.engine import baselines, clock, contest, long_run, starts
from tests.performance.engine.page import contest_table, page, printed, summary, time_figure
from tests.performance.engine.steps import measure_steps
from tests.report.drawings import figures_of

SETTINGS = (1e-1, 1e-2, 1e-3, 1e-4)
HHT, HELD, EXPLICIT = "hht(alpha=-0.05)", "projected(method=DOP853)", "scipy(method=DOP853)"
ROWS = [  # at every error HHT takes a quarter of the projected method's time and twice the explicit one's, which drifts
    *law(HHT, 10.0, 2, SETTINGS, 1e-15),
    *law(HELD, 40.0, 2, SETTINGS, 2e-16),
    *law(EXPLICIT, 5.0, 2, SETTINGS, 3e-4),
    failed("ida(form=index3)", 1e-2, "newton_failed", "the corrector <did> not converge"),
]


def clocked(monkeypatch, **costs):
    """Actions whose times are given; the order in which they were taken is kept."""
    order = []

    def once(action):
        name = action()
        order.append(name)
        cost = next(costs[name])
        return clock.Time(cost, 2 * cost)

    monkeypatch.setattr(clock, "once", once)
    monkeypatch.setattr(clock, "gc", SimpleNamespace(collect=lambda: None, freeze=lambda: None))
    return {name: lambda name=name: name for name in costs}, order


def ratio(seconds):
    return seconds["a"] / seconds["b"]


def test_the_two_sides_of_a_pair_are_taken_in_turn_first_one_then_the_other(monkeypatch):
    actions, order = clocked(monkeypatch, a=itertools.repeat(2.0), b=itertools.repeat(1.0))
    found = clock.compare(actions, ratio, 3.0)
    assert "".join(order) == "ab" + "abba" * 4, "one round that does not count, then eight"
    assert (found.figure.value, found.on_clock, found.cpu("a")) == (2.0, 2.0, 2.0)


def test_the_figure_is_the_median_of_the_rounds_ratios_and_not_the_ratio_of_medians(monkeypatch):
    """A machine that slows both sides of some rounds changes nothing."""
    slow = [1.0, 7.0, 1.0, 1.0, 9.0, 1.0, 1.0, 5.0, 1.0]
    actions, _ = clocked(monkeypatch, a=iter(3 * s for s in slow), b=iter(slow))
    found = clock.compare(actions, ratio, 3.5)
    assert (found.figure.low, found.figure.value, found.figure.high) == (3.0, 3.0, 3.0)


def test_the_interval_of_eight_is_their_range_and_fewer_have_none():
    assert clock.estimate(range(8)) == clock.Estimate(3.5, 0, 7, 8)
    assert np.isinf(clock.estimate(range(7)).high)
    assert clock.estimate(range(64), (64,)) == clock.Estimate(31.5, 23, 40, 64), "Bin(64, 1/2) is below 24 in 1.6 % of all"


def test_the_interval_misses_the_median_in_fewer_than_one_of_twenty_cases_although_it_is_looked_at_often():
    rng = np.random.default_rng(0)
    wrong = sum(clock.decide(lambda: rng.lognormal(0.0, 0.3), (1.0,)).verdict(1.0) != clock.UNDECIDED for _ in range(400))
    assert wrong <= 20


@pytest.mark.parametrize(("limit", "verdict", "rounds"), [(7.5, "holds", 8), (-0.5, "BROKEN", 8), (3.5, "not decided", 256)])
def test_a_limit_holds_or_is_broken_by_the_whole_interval_and_rounds_are_added_until_then(limit, verdict, rounds):
    found = clock.decide(itertools.cycle(range(8)).__next__, (limit,))
    assert (found.verdict(limit), found.count) == (verdict, rounds)


def test_without_time_for_enough_rounds_nothing_is_decided():
    found = clock.decide(lambda: 1.0, (2.0,), patience=-1.0)
    assert (found.verdict(2.0), found.count) == ("not decided", 1)


@pytest.fixture
def by_the_campaign(monkeypatch):
    """Solves that take what the campaign has measured, but for chance; a factor by solver."""
    rng, factors = np.random.default_rng(1), {}

    def once(action):
        run = action()
        return clock.Time(factors.get(run.entry, 1.0) * run.time * rng.lognormal(0.0, 0.05), 1.0)

    monkeypatch.setattr(clock, "once", once)
    return factors


def contest_of(rows):
    return contest.compared(rows, lambda run: lambda: run)


def test_costs_are_taken_at_the_same_error_and_drift_bounds_the_holders_only(by_the_campaign):
    lines = contest_of(ROWS)
    assert [line["target"] for line in lines] == [1e-2, 1e-3, 1e-4]
    for line in lines:
        assert (line["subject"]["entry"], line["holder"]["entry"]) == (HHT, HELD), "the explicit one is faster and drifts"
        assert line["other"]["entry"] == line["explicit"]["entry"] == EXPLICIT
        assert line["subject"]["seconds"] == pytest.approx(10.0 * line["target"] ** -0.5 * 1e-5)
        assert line["explicit"]["drift"] == 3e-4
        assert line["steady"]


def test_a_comparison_at_equal_error_is_decided_by_paired_solves(by_the_campaign):
    by_the_campaign[EXPLICIT] = 2.0  # in turn it takes as long as HHT
    for line in contest_of(ROWS):
        assert line["holder"]["verdict"] == contest.FASTER
        assert line["holder"]["low"] < 0.25 < line["holder"]["high"]
        assert line["explicit"]["verdict"] == "not decided"
        assert line["explicit"]["count"] == contest.LOOKS[-1] > line["holder"]["count"]
    (first, *_) = summary(contest_of(ROWS))
    assert "is the fastest of those that keep both levels below 1e-10 on 1 (not decided on 0)" in first
    assert "is faster than HHT on 0," in first


def test_a_drifting_hht_is_shown_with_its_time_but_wins_nothing(by_the_campaign):
    lines = contest_of([*law(HHT, 1.0, 2, SETTINGS, 1e-6), *ROWS[4:]])
    assert not any(line["steady"] for line in lines)
    assert "below 1e-10 on 0 (not decided on 0)" in summary(lines)[0]
    assert contest_table(lines).rows[0][2].tone == "bad"


def test_who_does_not_get_there_has_a_reason_and_the_explicit_one_gets_there_alone(by_the_campaign):
    lines = contest_of([failed(HHT, 1e-2, "deadline", "too long"), *ROWS[8:]])
    (cell, *_) = contest_table(lines).rows[0][2:]
    assert (cell.text, cell.detail) == ("not reached", "deadline 1 of 1")
    assert "of 1 problems HHT reaches it on 0" in summary(lines)[0]
    assert "gets there alone on 1" in summary(lines)[0]


def test_an_action_of_the_contest_solves_to_the_end_without_output():
    problem = load_problem("simple_pendulum(t_end=1)")
    (row, *_) = law("hht", 1.0, 2, (1e-3,))
    row.request.update({"outputs": 2, "counting": False, "max_seconds": 60.0})
    (run,) = points([row])
    solution = contest.action_of(problem, {row.key: row}, run)()
    assert solution.success
    assert list(solution.t) == [1.0]


def judged(value, low, high, limit, verdict, unit=""):
    return {"value": value, "low": low, "high": high, "count": 8, "limit": limit, "verdict": verdict, "unit": unit}


@pytest.fixture
def speed(by_the_campaign):
    return {
        "created": "2026-11-22T01:00:00Z",
        "environment": {"python": "3.11", "processor": "<Test> & Co"},
        "seconds": 12.0,
        "steps": [{"what": "pendulum", "note": "", **judged(0.812, 0.8, 0.83, 1.0, "holds")}],
        "compiling": [{"what": "own cache", "note": "", **judged(0.15, 0.1, 0.25, 0.2, "not decided", "s")}],
        "chains": [{"what": "10 links", "note": "EXUdense", **judged(0.73, 0.7, 0.75, 0.5, "BROKEN")}],
        "memory": [{"what": "many steps", "note": "", **judged(7.0, 7.0, 7.0, 50.0, "holds", "MB")}],
        "middle": [{"what": "bricard", **clock.unmeasured(1.0, "there is none"), "unit": "s"}],
        "contest": contest_of(ROWS),
    }


def test_the_page_shows_ratios_intervals_limits_and_verdicts(speed):
    text = re.sub("</?span[^>]*>", "", page(speed))  # which keep names and numbers on one line
    assert re.search(r'<td class="good[^>]*>0\.812<small>0\.8 to 0\.83, 8 rounds; limit 1: holds', text)
    assert re.search(r'<td class="bad[^>]*>0\.73<small>0\.7 to 0\.75, 8 rounds; limit 0\.5: BROKEN', text)
    assert "<td>150 ms<small>100 ms to 250 ms, 8 rounds; limit 200 ms: not decided" in text
    assert "7 MB<small>limit 50 MB: holds" in text, "what is counted has no interval"
    assert "not measured<small>limit 1 s" in text and "there is none" in text
    assert "&lt;Test&gt; &amp; Co" in text
    assert f"{EXPLICIT} 500" in text and "drift 3.0e-04" in text
    assert 'id="starts"' not in text, "it was not measured"


def test_the_page_draws_every_error_with_labelled_axes(speed):
    figures = list(figures_of(page(speed)).values())
    assert len(figures) == 3
    for drawn in figures:
        assert drawn["layout"]["xaxis"]["title"]["text"] == "processor time of one solve [s]"
        assert [trace["name"] for trace in drawn["data"]][:2] == ["HHT", "fastest other that holds both levels"]
        assert all(len(trace["x"]) == 1 for trace in drawn["data"])
    low, high = figures[0]["layout"]["xaxis"]["range"]
    assert 10**low < 0.5e-3 < 4e-3 < 10**high
    go.Figure(time_figure(speed["contest"]))  # which refuses what plotly does not know


def test_the_printed_table_holds_ratios_limits_and_the_verdict(speed):
    text = printed(json.loads(json.dumps(speed)))
    assert "0.812 0.8 to 0.83, 8 rounds; limit 1: holds" in text
    assert "5 limits: 2 holds, 1 BROKEN, 1 not decided, 1 not measured" in text
    assert re.search(rf"{re.escape(HELD)} 4 ms HHT 0\.2\d+. its time, 0\.2\d* to 0\.2\d*: faster; drift 2\.0e-16", text)


def test_a_missing_compiler_is_told_and_nothing_is_called_broken(monkeypatch, tmp_path):
    monkeypatch.setattr(baselines, "compiler", lambda: None)
    lines = measure_steps()
    assert {line["verdict"] for line in lines} == {"not measured"}
    assert all("no C compiler" in line["note"] for line in lines)


def test_memory_is_not_that_of_the_process_that_started_it():
    ballast = np.ones(100_000_000 // 8)
    command = [sys.executable, "-m", "tests.performance.engine.long_run", "2000"]
    found = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    own = long_run.peak()
    assert 0.0 <= found["after"] - found["before"] < 20.0
    assert found["before"] < own - ballast.nbytes / 2**21


def test_the_librarys_own_start_is_what_the_adapter_hands_over():
    problem, request = load_problem("jay_negrut_pendulum"), Request(rtol=1e-4, max_num_steps=1)
    for name in starts.ADAPTERS:
        adapter = load_solver(name)
        run = starts._caught(adapter, problem, request)
        assert run.steps == 1
        starts._library_start(run, name)()
