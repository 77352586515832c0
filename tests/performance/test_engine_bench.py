"""What surrounds the timings of ``make bench-engine``: minimal coordinates, shares of callbacks, repeats, the table."""

import itertools
import json
from types import SimpleNamespace

import numpy as np
import pytest

from hhtbench import load_problem, load_solver
from hhtbench.campaign.accuracy import compare
from hhtbench.request import Request
from tests.analysis.laws import law
from tests.performance.engine import baselines, callbacks, clock, field, minimal
from tests.performance.engine.callbacks import share_of, watched
from tests.performance.engine.contest import contest
from tests.performance.engine.table import printed
from tests.report.test_speed import SPEED


@pytest.mark.parametrize(
    "spec", ["jay_negrut_pendulum", "pendulum_period2(t_end=2)", "slider_crank_equal_lengths(t_end=0.2)"]
)
def test_minimal_coordinates_move_like_the_problem(spec):
    problem = load_problem(spec)
    solver = minimal.MinimalSolver(load_solver("scipy(method=DOP853)"), minimal.reduced_of(problem))
    times = [problem.t_span[1]] if problem.reference is None else problem.reference["t"]
    found = compare(problem, solver.solve(problem, Request(rtol=1e-10, t_eval=np.asarray(times, dtype=float))))
    assert max(found.scaled(name).max() for name in ("q", "v")) < 1e-8


def test_a_start_that_is_not_the_problems_is_refused():
    problem = load_problem("slider_crank_equal_lengths(rate=3.0)")
    with pytest.raises(ValueError, match="off by"):
        minimal.reduced_of(problem)


def test_problems_without_minimal_coordinates_say_so():
    assert minimal.reduced_of(load_problem("andrews")) is None


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


def test_repeats_alternate_and_their_median_counts(monkeypatch):
    order, ticks = [], iter(range(1000))
    costs = {"a": iter([1, 50, 3]), "b": iter([10, 10, 10])}
    times = {"a": [], "b": []}

    def once(action):
        name = action()
        times[name].append(next(costs[name]))
        return clock.Time(times[name][-1], next(ticks))

    monkeypatch.setattr(clock, "once", once)
    found = clock.in_turn({name: lambda name=name: order.append(name) or name for name in "ab"}, 3)
    assert order == ["a", "b"] * 3
    assert (found["a"].cpu, found["b"].cpu) == (3, 10)


def test_no_compiler_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(baselines, "compiler", lambda: None)
    with pytest.raises(RuntimeError, match="no C compiler"):
        baselines.build(tmp_path)


def test_a_contest_without_time_has_a_row_for_every_solver():
    rows = contest("knife_edge", 0.0)
    assert len(rows) == len({row.solver for row in rows}) == 16
    assert {row.status for row in rows} == {"declined", "not run"}


def test_a_process_that_crashes_costs_its_problem_only(monkeypatch):
    monkeypatch.setattr(field.sys, "executable", "/bin/false")
    rows = field.measure_field(("knife_edge", "oscillator_chain"), 60.0)
    assert {row["problem"] for row in rows} == {"knife_edge"}, "oscillator_chain has no constraints"
    assert {row["status"] for row in rows} == {"crashed"}
    assert len(rows) == 16


def test_the_printed_table_holds_ratios_limits_and_the_verdict():
    rows = json.loads(json.dumps(SPEED["runs"]))
    text = printed({**SPEED, "runs": rows})
    assert "0.812 limit 1" in text
    assert "3 of 4 limits hold, 1 broken, 0 not measured" in text
    assert "engine: compiled" in text
    assert law("hht", 1, 2)[0].problem in text
