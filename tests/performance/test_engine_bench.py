"""What surrounds the timings of ``make bench-engine``: shares of callbacks, repeats, the table."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hhtbench import load_problem, load_solver
from hhtbench.analysis import race
from hhtbench.campaign.run import run_cell
from hhtbench.report.speed_contest import contest_rows, contest_table, everyone_table, shares_table
from hhtbench.request import Request
from tests.analysis.laws import failed, law
from tests.performance.engine import baselines, callbacks, clock, duels, field, long_run, starts
from tests.performance.engine.callbacks import share_of, watched
from tests.performance.engine.contest import _asked, _row, contest, kept
from tests.performance.engine.table import printed
from tests.report.test_speed import RUNS, SPEED


def test_shares_of_callbacks_are_parts_of_the_solve():
    problem, request = load_problem("simple_pendulum(t_end=1)"), Request(rtol=1e-5, t_eval=[1.0])
    solver = load_solver("scipy(method=DOP853)")
    share = share_of(problem, solver, request)
    counters = solver.solve(problem, request).counters
    assert share.calls == pytest.approx(counters.residual_evaluations, abs=3)
    assert 0.0 < share.functions < 1.0
    assert 0.0 < share.guards < 1.0 - share.functions


def test_guards_are_what_the_functions_leave(monkeypatch):
    """A clock that ticks when it is read: one tick inside the function, two around it in the guard."""
    monkeypatch.setattr(callbacks, "time", SimpleNamespace(perf_counter=itertools.count().__next__))
    problem, request = load_problem("simple_pendulum(t_end=1)"), Request(rtol=1e-3, t_eval=[1.0])
    share = share_of(problem, load_solver("scipy(method=DOP853)"), request)
    assert share.guards == pytest.approx(2 * share.functions)


def test_solves_outside_are_not_watched():
    problem, request = load_problem("simple_pendulum(t_end=1)"), Request(rtol=1e-3, t_eval=[1.0])
    with watched() as spent:
        pass
    load_solver("scipy(method=DOP853)").solve(problem, request)
    assert spent.calls == 0


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


def test_a_comparison_at_equal_error_is_decided_by_paired_solves():
    """HHT takes half the projected method's time and as much as the explicit one's, in rounds of which some are slow."""
    rng = np.random.default_rng(1)
    rows = [row for row in contest_rows(SPEED) if row.success]
    one = {row.key: row.timing["best_s"] for row in rows}
    times = {"projected(method=DOP853)": 2.0, "scipy(method=DOP853)": 1.0, "hht(alpha=-0.05)": 1.0}

    def solve(run):
        return times[run.entry] / run.setting.value * rng.lognormal(0.0, 0.05)

    found = {(line["target"], line["kind"]): line for line in duels.duels(rows, solve, 1e9)}
    assert one, "the runs have times"
    for target in (1e-2, 1e-3, 1e-4):
        assert found[target, "holder"]["verdict"] == duels.FASTER
        assert found[target, "holder"]["low"] < 2.0 < found[target, "holder"]["high"]
        assert found[target, "explicit"]["verdict"] == "not decided"
        assert found[target, "explicit"]["count"] == duels.LOOKS[-1] > found[target, "holder"]["count"]


def test_comparisons_that_cost_more_than_there_is_time_for_are_made_once_and_not_called_decided():
    rows = [row for row in contest_rows(SPEED) if row.success]
    found = duels.duels(rows, lambda run: 1.0, 1e-6)
    assert found
    assert {line["verdict"] for line in found} == {"not decided"}
    assert {line["count"] for line in found} <= {None, 1}


def test_what_a_run_keeps_is_what_the_tables_read():
    rows = [*RUNS, *(replace(row, problem="other", metrics=row.metrics | {"rows": 2}) for row in RUNS)]
    slim = contest_rows({"runs": json.loads(json.dumps([kept(row) for row in rows]))})
    for problem in ("pendulum", "other"):
        assert everyone_table(slim, problem) == everyone_table(rows, problem)
    assert contest_table(slim) == contest_table(rows)
    assert shares_table(slim) == shares_table(rows)


def test_a_run_with_all_that_is_measured_keeps_so_little_that_all_problems_are_below_a_megabyte():
    found = run_cell(
        load_problem("knife_edge"), load_solver("hht"), {**_asked(1e-3), "max_seconds": None}, {}, lambda _: None
    )
    entry = kept(_row("knife_edge", "hht(alpha=-0.05)", 1e-3, found))
    assert set(entry["metrics"]["drift"]) == {"velocity"}
    assert len(json.dumps(entry)) * 30 * 80 < 1e6, "problems, and runs of each"


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


def test_no_compiler_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(baselines, "compiler", lambda: None)
    with pytest.raises(RuntimeError, match="no C compiler"):
        baselines.build(tmp_path)


def test_a_contest_without_time_has_a_row_for_every_solver_that_says_not_run():
    rows, compared = contest("knife_edge", 0.0)
    assert len(rows) == len({row.solver for row in rows}) == 16
    assert {row.status for row in rows} == {"not run"}
    assert compared == []
    text = printed({**SPEED, "runs": [kept(row) for row in rows], "duels": []})
    assert "HHT reaches it on 0, was not run that far on 1," in text
    assert "not run: the time of the section was up" in text
    assert "HHT is not there" not in text


def test_a_solver_that_was_cut_short_does_not_fail(monkeypatch):
    """Its ladder ends above the error: it was not run that far."""
    rows = [*law("hht(alpha=-0.05)", 10.0, 2, (1e-1, 1e-2), 1e-15), failed("hht(alpha=-0.05)", 1e-3, "not run", "time")]
    reasons = {line.target: line.missing["hht(alpha=-0.05)"] for line in race(rows) if line.missing}
    assert {reason.kind for reason in reasons.values()} == {"not run"}
    assert "not run: time" in reasons[1e-4].text


def test_a_process_that_crashes_costs_its_problem_only(monkeypatch):
    monkeypatch.setattr(field.sys, "executable", "/bin/false")
    rows = field.measure_field(("knife_edge", "oscillator_chain"), 60.0)["runs"]
    assert {row["problem"] for row in rows} == {"knife_edge"}, "oscillator_chain has no constraints"
    assert {row["status"] for row in rows} == {"crashed"}
    assert len(rows) == 16


def test_without_time_every_problem_is_named_and_not_run():
    rows = field.measure_field(("knife_edge", "andrews"), -1.0)["runs"]
    assert {(row["problem"], row["status"]) for row in rows} == {("knife_edge", "not run"), ("andrews", "not run")}


def test_the_printed_table_holds_ratios_limits_and_the_verdict():
    rows = json.loads(json.dumps(SPEED["runs"]))
    text = printed({**SPEED, "runs": rows})
    assert "0.812 0.8 to 0.83, 8 rounds; limit 1: holds" in text
    assert "6 limits: 4 holds, 1 BROKEN, 1 not decided, 0 not measured" in text
    assert "engine: compiled" in text
    assert law("hht", 1, 2)[0].problem in text
