"""Cells in worker processes that are killed where they run on: nothing hangs, and a crash costs its own cell only.

A cell holds functions: it is named by its axis, its place there and the seed, and made anew in the worker.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial

from hhtbench.processes import Worker, worker_processes
from hhtbench.result import Status
from hhtbench.testing.extremes.cell import COMPILING, Cell, Kind, Outcome, measure
from hhtbench.testing.extremes.table import chosen_axes

OVERDUE = COMPILING + 30.0  # [s] beyond twice the budget of a cell, after which its process is killed


@dataclass(frozen=True)
class Batch:
    """Cells of one axis for one solver: one worker has compiled for all of them."""

    solver: str
    axis: str
    seed: int
    places: tuple[int, ...]  #: of the cells within the axis


@dataclass(frozen=True)
class Measured:
    """One cell with one solver."""

    solver: str
    axis: str
    x: float
    line: str
    outcome: Outcome


def measure_all(batches: Iterable[Batch], jobs: int, tell: Callable[[Batch, Sequence[Measured]], None]) -> list[Measured]:
    """Every cell of every batch; ``tell`` hears of each batch, from the thread that has measured it."""
    with worker_processes(jobs) as pool:
        measured = [pool.lend(partial(_measured, batch, tell)) for batch in batches]
        return [found for batch in measured for found in batch.result()]


def _measured(batch: Batch, tell: Callable[[Batch, Sequence[Measured]], None], worker: Worker) -> list[Measured]:
    cells = [_cells(batch.axis, batch.seed)[i] for i in batch.places]
    found = [
        Measured(batch.solver, batch.axis, cell.x, cell.line, outcome_in(worker, batch, i, cell.seconds))
        for i, cell in zip(batch.places, cells, strict=True)
    ]
    tell(batch, found)
    return found


def outcome_in(worker: Worker, batch: Batch, place: int, seconds: float) -> Outcome:
    """The outcome of one cell, whatever it does."""
    began, most = time.perf_counter(), 2 * seconds + OVERDUE
    try:
        found: Outcome = worker.call(_outcome, batch, place, seconds=most)
        return found
    except TimeoutError:
        text = f"no answer in {most:g} s, of which {seconds:g} s were its budget; killed"
    except EOFError as ended:
        text = str(ended)
    return Outcome(kind=Kind.crashed, status=Status.crashed.label, message=text, seconds=time.perf_counter() - began)


def _outcome(batch: Batch, place: int) -> Outcome:
    return measure(_cells(batch.axis, batch.seed)[place], batch.solver)


@cache
def _cells(axis: str, seed: int) -> Sequence[Cell]:
    (found,) = chosen_axes([axis])
    return found.cells(seed)
