"""Readings of the clock: long enough, of processor time, in rounds."""

from __future__ import annotations

import time
from typing import Any

import pytest

from hhtbench import Status
from hhtbench.campaign.clock import LONG, MIN_READING, PATIENCE, enough, time_cell, timing_of
from tests.campaign.test_run import ASKED, PROBLEM, Line, line


def reading(cpu: float, wall: float | None = None) -> dict[str, Any]:
    return {"cpu_s": cpu, "wall_s": cpu if wall is None else wall, "solves": 7, "load": 0.5}


def busy(seconds: float) -> Any:
    def solve(self: Any, problem: Any, request: Any) -> Any:
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass
        self.diary.append("solve")
        return line(request.t_eval)

    return solve


def test_a_solver_without_warm_up_solves_once_before_the_clock_runs(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delattr(Line, "warm_up")
    monkeypatch.setattr(Line, "solve", busy(2 * MIN_READING))
    solver = Line()
    assert time_cell(PROBLEM, solver, ASKED, False, lambda _: None)["solves"] == 1
    assert solver.diary == ["solve"] * 2
    time_cell(PROBLEM, solver, ASKED, True, lambda _: None)
    assert solver.diary == ["solve"] * 3


def test_a_short_solve_is_repeated_until_a_reading_is_long_enough(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Line, "solve", busy(1e-3))
    found = time_cell(PROBLEM, Line(), ASKED, True, lambda _: None)
    assert found["solves"] * found["cpu_s"] >= MIN_READING or found["solves"] * found["wall_s"] >= PATIENCE * MIN_READING
    assert found["cpu_s"] == pytest.approx(1e-3, rel=0.3)


def test_waiting_for_the_core_is_told_and_not_counted(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Line, "solve", lambda self, problem, request: time.sleep(0.05) or line(request.t_eval))
    found = time_cell(PROBLEM, Line(), ASKED, True, lambda _: None)
    assert found["cpu_s"] < 0.02 < found["wall_s"]
    assert timing_of([found])["disturbed"] is True


def test_the_best_the_median_and_every_round_are_kept():
    assert timing_of([reading(3.0), reading(1.0), reading(1.2, 2.0)]) == {
        "best_s": 1.0,
        "median_s": 1.2,
        "rounds_s": [3.0, 1.0, 1.2],
        "repeats": 3,
        "solves": 7,
        "wall_s": 2.0,
        "load": 0.5,
        "disturbed": True,
    }


def test_long_and_failed_solves_are_not_repeated(monkeypatch: pytest.MonkeyPatch):
    assert enough([reading(2 * LONG)])
    assert not enough([reading(0.5 * LONG)])
    assert not enough([])
    monkeypatch.setattr(Line, "solve", lambda self, problem, request: 1 / 0)
    failed = time_cell(PROBLEM, Line(), ASKED, True, lambda _: None)
    assert enough([failed])
    assert timing_of([failed])["repeats"] == 0
    assert "ZeroDivisionError" in timing_of([failed])["note"]
    ended = lambda self, problem, request: line(request.t_eval, status=Status.newton_failed)  # noqa: E731
    monkeypatch.setattr(Line, "solve", ended)
    assert "ended with newton_failed" in time_cell(PROBLEM, Line(), ASKED, True, lambda _: None)["note"]
