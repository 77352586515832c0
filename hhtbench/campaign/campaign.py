"""A campaign: the accuracy pass over all cells at once, then the timing pass over one cell at a time.

What is run next on a pair of problem and solver is asked of a function of the pair's rows so far; so a resumed campaign
asks for the same cells as one that was never interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from hhtbench.campaign.clock import enough, timing_of
from hhtbench.campaign.execute import Limits, Task, WorkerPool, run_task
from hhtbench.campaign.machine import machine_facts
from hhtbench.campaign.plan import Campaign, Cell, plan_pairs
from hhtbench.campaign.refine import next_cells
from hhtbench.result import Status
from hhtbench.store import RunRow, Store

Progress = Callable[[str, int, int], None]  #: pass, cells done, cells to do
Name = tuple[str, ...]  #: of a pair: problem, solver, and what is refined
NextCells = Callable[[Sequence[RunRow]], Sequence[Cell]]  #: cells to run next, from a pair's rows in the order of asking


@dataclass(frozen=True, kw_only=True)
class Done:
    """What a campaign came to."""

    cells: int
    ran: int  #: cells run now; the others were there
    timed: int  #: cells timed now
    rows: tuple[RunRow, ...]  #: the row of every cell, pair by pair


def run_campaign(
    campaign: Campaign,
    store: Store,
    *,
    limits: Limits,
    executor: Executor | None = None,
    references: Mapping[str, Path] | None = None,
    timing: bool = True,
    progress: Progress | None = None,
) -> Done:
    """Run what ``store`` does not hold yet; every cell is on the disk before it counts as done.

    ``executor`` runs the accuracy pass; None: worker processes here.  ``references`` are certificates of problems that
    bring none (:func:`~hhtbench.campaign.references.auto_references`).
    """
    asks = {pair.name: partial(next_cells, pair) for pair in plan_pairs(campaign, references)}
    tell = progress or (lambda *_: None)
    with WorkerPool(limits) as pool:
        accuracy = AccuracyPass(asks, store, pool if executor is None else executor, tell)
        accuracy.run()
        timed = _timing_pass(accuracy.cells, store, pool, campaign.repeats, tell) if timing else 0
    rows = tuple(row for row in (store.get(cell.key) for cell in accuracy.cells) if row is not None)
    return Done(cells=len(accuracy.cells), ran=accuracy.ran, timed=timed, rows=rows)


class AccuracyPass:
    """The loop over futures: submit what the pairs ask for, write what comes, ask again."""

    def __init__(self, asks: Mapping[Name, NextCells], store: Store, executor: Executor, tell: Progress) -> None:
        self.ran = 0
        self._asks = asks
        self._store = store
        self._executor = executor
        self._tell = tell
        self._facts = machine_facts()
        self._asked: dict[Name, list[Cell]] = {pair: [] for pair in asks}
        self._rows: dict[str, RunRow] = {}  # by key
        self._open = dict.fromkeys(asks, 0)  # cells under way of every pair
        self._flights: dict[Future[dict[str, Any]], tuple[Name, Cell]] = {}
        self._landed: SimpleQueue[Future[dict[str, Any]]] = SimpleQueue()

    @property
    def cells(self) -> list[Cell]:
        """All that were asked for."""
        return [cell for cells in self._asked.values() for cell in cells]

    def run(self) -> None:
        """Until no pair asks for more."""
        for pair in self._asks:
            self._ask(pair)
        self._progress()
        while self._flights:
            future = self._landed.get()
            pair, cell = self._flights.pop(future)
            self._keep(cell, future.result())
            self._open[pair] -= 1
            if not self._open[pair]:
                self._ask(pair)
            self._progress()

    def _ask(self, pair: Name) -> None:
        """Submit what the pair asks for; where the store holds all of that, ask again."""
        while not self._open[pair]:
            cells = self._asks[pair]([self._rows[cell.key] for cell in self._asked[pair]])
            if not cells:
                return
            self._asked[pair] += cells
            for cell in cells:
                row = self._store.get(cell.key)
                if row is not None and _stands(row, cell):
                    self._rows[cell.key] = row
                else:
                    self._submit(pair, cell)

    def _submit(self, pair: Name, cell: Cell) -> None:
        self._open[pair] += 1
        self.ran += 1
        future = self._executor.submit(run_task, Task(problem=cell.problem, solver=cell.solver, request=cell.request))
        self._flights[future] = pair, cell
        future.add_done_callback(self._landed.put)

    def _keep(self, cell: Cell, result: dict[str, Any]) -> None:
        row = RunRow(
            key=cell.key, problem=cell.problem, solver=cell.solver, request=cell.request, environment=self._facts, **result
        )
        self._store.put(row, cell.identity)
        self._rows[cell.key] = row

    def _progress(self) -> None:
        self._tell("accuracy", self.ran - len(self._flights), self.ran)


def _timing_pass(cells: Sequence[Cell], store: Store, pool: WorkerPool, repeats: int, tell: Progress) -> int:
    """One at a time, so that each is alone, in rounds over all: the repeats of a cell see the machine at different times."""
    pending = {cell.key: (cell, row) for cell in cells if _untimed(row := store.get(cell.key)) and row is not None}
    readings: dict[str, list[dict[str, Any]]] = {key: [] for key in pending}
    done = 0
    tell("timing", 0, repeats * len(pending))
    for _ in range(repeats):
        for key, (cell, _row) in pending.items():
            done += 1
            if enough(readings[key]):
                continue
            task = Task(problem=cell.problem, solver=cell.solver, request=cell.request, repeats=1)
            readings[key].append(pool.submit(run_task, task).result())
            tell("timing", done, repeats * len(pending))
    for key, (cell, row) in pending.items():
        store.put(replace(row, timing={**row.timing, **timing_of(readings[key])}), cell.identity)
    tell("timing", repeats * len(pending), repeats * len(pending))
    return len(pending)


def _stands(row: RunRow, cell: Cell) -> bool:
    """The row would not come out otherwise with the budget given now."""
    return row.status != Status.deadline.label or row.request["max_seconds"] >= cell.request["max_seconds"]


def _untimed(row: RunRow | None) -> bool:
    return row is not None and row.success and row.timing.get("repeats") is None
