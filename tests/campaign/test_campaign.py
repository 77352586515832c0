"""The loop over a campaign's cells, with executors and stores of the test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hhtbench.campaign import campaign as loop
from hhtbench.campaign.campaign import AccuracyPass
from hhtbench.campaign.execute import Limits, Task, WorkerPool, run_task
from hhtbench.campaign.plan import Cell
from hhtbench.campaign.store import RunRow, Store

MOST = 4


class Immediate(Executor):
    """Answers at once, and keeps a diary."""

    def __init__(self) -> None:
        self.diary: list[float] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        (task,) = args
        assert fn is run_task and isinstance(task, Task)
        self.diary.append(task.request["rtol"])
        future: Future[Any] = Future()
        future.set_result({"status": "success", "message": "there", "metrics": {"error": task.request["rtol"] / 2}})
        return future


def cell(rtol: float) -> Cell:
    request = {"rtol": rtol, "max_seconds": 1.0}
    return Cell(key=f"key {rtol}", identity=f"identity {rtol}", problem="fall", solver="told", request=request)


def refine(rows: Sequence[RunRow]) -> Sequence[Cell]:
    """A tenth of the last error, until ``MOST`` rows are there."""
    return [cell(rows[-1].metrics["error"] / 10 if rows else 1e-1)] if len(rows) < MOST else []


def test_what_a_pair_runs_next_follows_from_its_rows_and_a_resumed_campaign_runs_nothing(tmp_path: Path):
    with Store(tmp_path / "runs.db") as store:
        executor = Immediate()
        first = AccuracyPass({("fall", "told"): refine}, store, executor, lambda *_: None)
        first.run()
        assert executor.diary == pytest.approx([1e-1, 5e-3, 2.5e-4, 1.25e-5])
        again = AccuracyPass({("fall", "told"): refine}, store, executor, lambda *_: None)
        again.run()
    assert (first.ran, again.ran, len(executor.diary)) == (MOST, 0, MOST)
    assert again.cells == first.cells


def test_what_is_left_is_estimated_from_the_pairs_that_have_finished(tmp_path: Path):
    """Three pairs of four cells each: once the first, which asks for all at once, has finished, twelve are expected."""
    told: list[tuple[int, int]] = []

    def of(solver: str, found: Sequence[Cell]) -> list[Cell]:
        return [replace(c, key=f"{solver} {c.key}", identity=f"{solver} {c.identity}", solver=solver) for c in found]

    with Store(tmp_path / "runs.db") as store:
        asks = {("fall", solver): lambda rows, solver=solver: of(solver, refine(rows)) for solver in ("second", "third")}
        asks["fall", "first"] = lambda rows: [] if rows else of("first", [cell(10.0**-k) for k in range(MOST)])
        AccuracyPass(asks, store, Immediate(), lambda _, *counts: told.append(counts)).run()
    assert told == [(0, 6), (6, 12), (8, 12), (10, 12), (12, 12)]


def test_the_pool_is_an_executor_of_one_function_and_says_so():
    with WorkerPool(Limits(jobs=1)) as pool:
        with pytest.raises(TypeError, match="nothing but run_task"):
            pool.submit(print, "something")
        with pytest.raises(TypeError, match="nothing but run_task"):
            pool.submit(run_task, {"problem": "fall"})
    with pytest.raises(RuntimeError, match="closed"):
        pool.submit(run_task, Task(problem="fall", solver="told", request={}))


class Clocks(Immediate):
    """Times what it is given; ``most`` tasks, then somebody presses Ctrl-C."""

    limits = Limits(jobs=99)

    def __init__(self, most: float = math.inf) -> None:
        super().__init__()
        self.most = most

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.diary) >= self.most:
            raise KeyboardInterrupt
        future = super().submit(fn, *args, **kwargs)
        future.result().update(cpu_s=0.01, wall_s=0.01, solves=1, load=0.0)
        return future


def timed(folder: Path, pool: Clocks, monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], list[int]]:
    """How many rows every write held that held some, and how many readings every row has at the end."""
    cells, written = [cell(10.0**-k) for k in range(1, 6)], []
    monkeypatch.setattr(loop, "usable_cores", lambda: 2)
    with Store(folder / "runs.db") as store:
        ask = {("fall", "told"): lambda rows: [] if rows else cells}
        AccuracyPass(ask, store, Immediate(), lambda *_: None).run()
        write = store.write
        monkeypatch.setattr(store, "write", lambda rows: written.append(len(kept := list(rows))) or write(kept))
        with suppress(KeyboardInterrupt):
            loop._timing_pass(cells, store, pool, 3, lambda *_: None)
        rows = [store.get(one.key) for one in cells]
    return [count for count in written if count], [row.timing.get("repeats", 0) for row in rows if row is not None]


def test_nothing_is_written_while_cells_are_being_timed_and_what_is_done_is_kept_where_that_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert timed(tmp_path, Clocks(), monkeypatch) == ([5], [3] * 5)
    (tmp_path / "second").mkdir()
    assert timed(tmp_path / "second", Clocks(most=14), monkeypatch) == ([4], [3, 3, 3, 3, 0])
