"""Run a campaign: the accuracy pass over all cells at once, then the timing pass over one cell at a time.

The next cells of a pair of problem and solver are a function of the pair's rows so far; so a resumed campaign
asks for the same cells as one that was never interrupted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from hhtbench.campaign.clock import enough, timing_of
from hhtbench.campaign.execute import Limits, Task, WorkerPool, run_task
from hhtbench.campaign.machine import CLOCK, clock_of, machine_facts, usable_cores
from hhtbench.campaign.plan import Campaign, Cell, plan_pairs
from hhtbench.campaign.run import TIMED
from hhtbench.campaign.store import Entry, RunRow, Store
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.result import Status

Progress = Callable[[str, int, int], None]  #: pass, cells done, cells to do
Name = tuple[str, ...]  #: problem, solver, and what is refined: the name of a pair
NextCells = Callable[[Sequence[RunRow]], Sequence[Cell]]  #: cells to run next, from a pair's rows in the order of asking


@dataclass(frozen=True, kw_only=True)
class Done:
    """Result of a campaign: counts and rows."""

    cells: int
    ran: int  #: cells run now; the others were there
    timed: int  #: cells timed now
    rows: tuple[RunRow, ...]  #: the row of every cell, pair by pair
    contradictions: tuple[RunRow, ...] = ()  #: second results of a cell that differ from the first, which stays


def run_campaign(
    campaign: Campaign,
    store: Store,
    *,
    limits: Limits,
    executor: Executor | None = None,
    references: Mapping[str, Path] | None = None,
    timing: bool = True,
    retry: Collection[str] = (),
    progress: Progress | None = None,
) -> Done:
    """Run the cells that ``store`` does not hold yet; every cell is on the disk before it counts as done.

    ``executor`` runs the accuracy pass; None: worker processes here; a :class:`WorkerPool` does the timing too and stays
    open.  ``references`` are certificates of problems without a reference of their own
    (:func:`~hhtbench.campaign.references.auto_references`).  Times are taken on this machine, each alone on a core; those
    of another machine are taken anew.  Cells that ended with a status in ``retry`` run again.
    """
    asks = {pair.name: pair.next_cells for pair in plan_pairs(campaign, references)}
    tell = progress or (lambda *_: None)
    with nullcontext(executor) if isinstance(executor, WorkerPool) else WorkerPool(limits) as pool:
        accuracy = AccuracyPass(asks, store, pool if executor is None else executor, tell, retry)
        accuracy.run()
        timed = _timing_pass(accuracy.cells, store, pool, campaign.repeats, tell) if timing else 0
    rows = tuple(row for row in (store.get(cell.key) for cell in accuracy.cells) if row is not None)
    return Done(
        cells=len(accuracy.cells),
        ran=accuracy.ran,
        timed=timed,
        rows=rows,
        contradictions=tuple(accuracy.contradictions),
    )


class AccuracyPass:
    """Loop over futures: submit the cells that the pairs ask for, write their results, ask the pairs again."""

    def __init__(
        self,
        asks: Mapping[Name, NextCells],
        store: Store,
        executor: Executor,
        tell: Progress,
        retry: Collection[str] = (),
    ) -> None:
        self.ran = 0
        self.contradictions: list[RunRow] = []
        self._asks = asks
        self._store = store
        self._executor = executor
        self._tell = tell
        self._retry = retry
        self._asked: dict[Name, list[Cell]] = {pair: [] for pair in asks}
        self._rows: dict[str, RunRow] = {}  # by key
        self._outdated: set[str] = set()  # keys of rows that are run again
        self._open = dict.fromkeys(asks, 0)  # cells under way of every pair
        self._finished: set[Name] = set()  # pairs that ask for no more
        self._of_finished = 0  # cells of those
        self._asked_for = 0  # cells of all pairs
        self._flights: dict[Future[dict[str, Any]], tuple[Name, Cell]] = {}
        self._landed: SimpleQueue[Future[dict[str, Any]]] = SimpleQueue()

    @property
    def cells(self) -> list[Cell]:
        """All cells that the pairs asked for."""
        return [cell for cells in self._asked.values() for cell in cells]

    def run(self) -> None:
        """Run until no pair asks for more cells."""
        for pair in self._asks:
            self._ask(pair)
        self._progress()
        while self._flights:
            landed = [self._landed.get()]
            while not self._landed.empty():  # written together: the disk takes as long for one as for many
                landed.append(self._landed.get())
            flown = [self._flights.pop(future) for future in landed]
            self._keep([self._entry(cell, _result(future)) for (_, cell), future in zip(flown, landed, strict=True)])
            for pair, _ in flown:
                self._open[pair] -= 1
            for pair in dict.fromkeys(pair for pair, _ in flown):
                self._ask(pair)
            self._progress()

    def _ask(self, pair: Name) -> None:
        """Ask a pair, once all its cells are finished, for the next ones and submit those that the store does not hold."""
        while not self._open[pair]:
            cells = self._asks[pair]([self._rows[cell.key] for cell in self._asked[pair]])
            if not cells:
                self._finished.add(pair)
                self._of_finished += len(self._asked[pair])
                return
            self._asked[pair] += cells
            self._asked_for += len(cells)
            for cell in cells:
                row = self._store.get(cell.key)
                if row is not None:
                    self._rows[cell.key] = row
                    if row.status not in self._retry and stands(row, cell):
                        continue
                    self._outdated.add(cell.key)
                self._submit(pair, cell)

    def _submit(self, pair: Name, cell: Cell) -> None:
        self._open[pair] += 1
        self.ran += 1
        future = self._executor.submit(run_task, Task(problem=cell.problem, solver=cell.solver, request=cell.request))
        self._flights[future] = pair, cell
        future.add_done_callback(self._landed.put)

    def _entry(self, cell: Cell, result: dict[str, Any]) -> Entry:
        row = RunRow(key=cell.key, problem=cell.problem, solver=cell.solver, request=cell.request, **result)
        return Entry(row=row, identity=cell.identity, replaces=cell.key in self._outdated)

    def _keep(self, entries: Sequence[Entry]) -> None:
        differing = self._store.write(entries)
        self.contradictions += differing
        self._outdated.difference_update(entry.row.key for entry in entries)
        for entry in entries:
            stays = self._store.get(entry.row.key) if entry.row in differing else None
            self._rows[entry.row.key] = stays or entry.row

    def _progress(self) -> None:
        self._tell("accuracy", self.ran - len(self._flights), self.ran + self._not_yet_asked())

    def _not_yet_asked(self) -> int:
        """Estimate the number of cells still to come from the mean number of cells of finished pairs."""
        if not self._finished:
            return 0
        return max(0, round(self._of_finished / len(self._finished) * len(self._asks)) - self._asked_for)


def stands(row: RunRow, cell: Cell) -> bool:
    """True if the row of ``cell`` stays valid: it is no timeout under a smaller time budget than the present one."""
    return row.status != Status.deadline.label or row.request["max_seconds"] >= cell.request["max_seconds"]


def _result(future: Future[dict[str, Any]]) -> dict[str, Any]:
    """Return the result of a task; a task lost by its executor (with its machine, say) counts as crashed."""
    try:
        result = future.result()
    except ProblemError:  # no worker can start
        raise
    except Exception as error:  # noqa: BLE001 - whatever an executor of somebody else's raises
        lost = f"it was lost by its executor: {type(error).__name__}: {error}"
        return {"status": Status.crashed.label, "message": lost, "environment": machine_facts()}
    _refuse_other_versions(result.get("environment", {}))
    return result


def _refuse_other_versions(environment: Mapping[str, Any]) -> None:
    """Raise if a worker's libraries differ from those here, since rows are identified by the files and versions here."""
    for name, value in machine_facts().items():
        if name not in CLOCK and environment.get(name, value) != value:
            raise ProblemError(
                f"a worker of the executor has {name} {environment[name]}, here it is {value}; "
                "install the same everywhere. All rows written before are kept."
            )


def _timing_pass(cells: Sequence[Cell], store: Store, pool: WorkerPool, repeats: int, tell: Progress) -> int:
    """Time each cell alone on a core, in rounds over all cells, so that the repeats of a cell are spread over time.

    Nothing is written while a cell is being timed: rows with complete readings are written at the end of a round
    or when interrupted; incomplete readings are then lost.
    """
    rows = {cell.key: store.get(cell.key) for cell in cells}
    pending = {cell.key: (cell, row) for cell in cells if (row := rows[cell.key]) is not None and untimed(row)}
    store.write(  # times of another machine go first of all: at no time are there those of two
        Entry(row=_with_timing(row, dict.fromkeys(TIMED)), identity=cell.identity, replaces=True)
        for cell, row in pending.values()
        if row.timing.get("repeats") is not None
    )
    readings: dict[str, list[dict[str, Any]]] = {key: [] for key in pending}
    machine = clock_of(machine_facts())
    for count in range(repeats):
        short = {key: cell for key, (cell, _) in pending.items() if not enough(readings[key])}
        done, timed = (count + 1) * len(pending) - len(short), []
        tell("timing", done, repeats * len(pending))
        try:
            for key, reading in _one_a_core(short, pool):
                tell("timing", done := done + 1, repeats * len(pending))
                readings[key].append(reading)
                if count == repeats - 1 or enough(readings[key]):
                    cell, row = pending[key]
                    found = _with_timing(row, {**dict.fromkeys(TIMED), **timing_of(readings[key]), "machine": machine})
                    timed.append(Entry(row=found, identity=cell.identity, replaces=True))
        finally:
            store.write(timed)
    tell("timing", repeats * len(pending), repeats * len(pending))
    return len(pending)


def _one_a_core(cells: Mapping[str, Cell], pool: WorkerPool) -> Iterator[tuple[str, dict[str, Any]]]:
    """Time every cell once and yield the readings as they come; at most as many cells run at once as there are cores.

    A pool with no more workers than cores receives all cells at once: it sends each to the worker that has it compiled.
    """
    waiting = iter(cells.items())
    most = len(cells) if pool.limits.jobs <= usable_cores() else usable_cores()
    while some := dict(islice(waiting, most)):
        flights: dict[Future[dict[str, Any]], str] = {}
        for key, cell in some.items():
            task = Task(problem=cell.problem, solver=cell.solver, request=cell.request, repeats=1)
            flights[pool.submit(run_task, task)] = key
        yield from ((flights[future], future.result()) for future in as_completed(flights))


def _with_timing(row: RunRow, changes: Mapping[str, Any]) -> RunRow:
    kept = {name: value for name, value in row.timing.items() if name not in ("note", "machine")}
    return replace(row, timing={**kept, **changes})


def untimed(row: RunRow) -> bool:
    """True for a successful row without times of this machine."""
    if not row.success:
        return False
    if row.timing.get("repeats") is None:
        return True
    return row.timing.get("machine", clock_of(row.environment)) != clock_of(machine_facts())
