"""Measure cells in worker processes, which are killed if they overrun; a crash costs its own cell only.

A cell holds functions, so it is named by family, index and seed, and made anew in the worker.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

from hhtbench.conformance.cell import MAX_COMPILING, Cell
from hhtbench.conformance.entry import Kind, Outcome
from hhtbench.conformance.registry import FAMILIES, chosen
from hhtbench.conformance.subject import Subject
from hhtbench.runtime.processes import Worker, worker_processes
from hhtbench.solution.result import Status

MAX_OVERDUE = MAX_COMPILING + 30.0  # [s] beyond twice the budget of a cell, after which its process is killed


@dataclass(frozen=True)
class Batch:
    """Cells of one family for one solver, measured by one worker, which compiles for all of them."""

    solver: str
    family: str
    seed: int
    places: tuple[int, ...]  #: indices of the cells within the family


def measure_all(batches: Iterable[Batch], jobs: int, tell: Callable[[Batch, Sequence[Outcome]], None]) -> list[Outcome]:
    """Measure every cell of every batch; ``tell`` is called after each batch, from the thread that measured it."""
    with worker_processes(jobs) as pool:
        measured = [pool.lend(partial(_measured, batch, tell)) for batch in batches]
        return [found for batch in measured for found in batch.result()]


def _measured(batch: Batch, tell: Callable[[Batch, Sequence[Outcome]], None], worker: Worker) -> list[Outcome]:
    found = [outcome_in(worker, batch, i) for i in batch.places]
    tell(batch, found)
    return found


def outcome_in(worker: Worker, batch: Batch, place: int) -> Outcome:
    """Measure one cell in a worker; a hang or crash becomes its outcome."""
    cell = cells_of(batch.family, batch.seed)[place]
    began, most = time.perf_counter(), 2 * cell.seconds + MAX_OVERDUE
    try:
        measured: Outcome = worker.call(_outcome, batch, place, seconds=most)
        return measured
    except TimeoutError:
        kind, text = Kind.hung, f"no answer in {most:g} s, of which {cell.seconds:g} s were its budget; killed"
    except EOFError as ended:
        kind, text = Kind.crashed, str(ended)
    found = Outcome(kind=kind, status=Status.crashed.label, message=text, seconds=time.perf_counter() - began)
    return replace(found, id=batch.family, case=str(cell), solver=batch.solver, x=cell.x, line=cell.line)


def _outcome(batch: Batch, place: int) -> Outcome:
    (family,) = chosen(FAMILIES, [batch.family], "axis")
    return family.run(_subject(batch.solver), cells_of(batch.family, batch.seed)[place])


@cache
def _subject(solver: str) -> Subject:
    return Subject(solver)


@cache
def cells_of(family: str, seed: int) -> Sequence[Cell]:
    """Return the cells of a family in their order."""
    (found,) = chosen(FAMILIES, [family], "axis")
    return tuple(cell for (cell,) in found.cases(seed) if isinstance(cell, Cell))
