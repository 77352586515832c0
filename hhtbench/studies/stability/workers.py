"""Cells in worker processes that are killed where they run on: nothing hangs, and a crash costs its own cell only.

A cell holds functions: it is named by its axis, its place there and the seed, and made anew in the worker.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any

from hhtbench.processes import one_blas_thread
from hhtbench.result import Status
from hhtbench.testing.extremes.cell import COMPILING, Cell, Kind, Outcome, measure
from hhtbench.testing.extremes.table import chosen_axes

AGAIN = 0.1  # [s] after which workers are stopped again: one may just have begun
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
    waiting: SimpleQueue[Batch] = SimpleQueue()
    for batch in batches:
        waiting.put(batch)
    workers = [Worker() for _ in range(jobs)]
    with ThreadPoolExecutor(jobs) as threads:
        lanes = [threads.submit(_lane, worker, waiting, tell) for worker in workers]
        try:
            return [found for lane in lanes for found in lane.result()]
        except BaseException:  # an interruption: nothing is waited for
            while not all(lane.done() for lane in lanes):
                for worker in workers:
                    worker.stop()
                wait(lanes, AGAIN)
            raise


def _lane(worker: Worker, waiting: SimpleQueue[Batch], tell: Callable[[Batch, Sequence[Measured]], None]) -> list[Measured]:
    """A worker takes batches until none is left, or it is stopped."""
    found: list[Measured] = []
    try:
        while True:
            try:
                batch = waiting.get_nowait()
            except Empty:
                return found
            cells = _cells(batch.axis, batch.seed)
            here = [
                Measured(batch.solver, batch.axis, cells[i].x, cells[i].line, worker.measure(batch, i, cells[i].seconds))
                for i in batch.places
            ]
            tell(batch, here)
            found += here
    finally:
        worker.end()


class Worker:
    """One process at a time; where it is killed or dies, another one takes its place."""

    def __init__(self) -> None:
        self._stopped = False
        self._process: Any = None
        self._connection: Any = None

    def measure(self, batch: Batch, place: int, seconds: float) -> Outcome:
        """The outcome of one cell, whatever it does.

        Raises
        ------
        RuntimeError
            The worker was stopped.
        """
        if self._stopped:
            raise RuntimeError("the worker was stopped.")
        if self._process is None:
            context = get_context("spawn")
            self._connection, theirs = context.Pipe()
            self._process = context.Process(target=serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
        began = time.perf_counter()
        try:
            self._connection.send((batch.solver, batch.axis, batch.seed, place))
            if self._connection.poll(2 * seconds + OVERDUE):
                found: Outcome = self._connection.recv()
                return found
            text = f"no answer in {2 * seconds + OVERDUE:g} s, of which {seconds:g} s were its budget; killed"
        except (EOFError, OSError):
            self._process.join(1.0)
            text = f"its process ended with {self._process.exitcode}"
        self.end()
        return Outcome(kind=Kind.crashed, status=Status.crashed.label, message=text, seconds=time.perf_counter() - began)

    def stop(self) -> None:
        """Kill the process, from another thread; no other one takes its place."""
        self._stopped, process = True, self._process
        if process is not None:
            process.kill()

    def end(self) -> None:
        """Kill the process, if there is one."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
            self._process = None


@cache
def _cells(axis: str, seed: int) -> Sequence[Cell]:
    (found,) = chosen_axes([axis])
    return found.cells(seed)


def serve(connection: Connection) -> None:
    """In the worker: cells until the pipe closes."""
    one_blas_thread()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes of a terminal: who started this one ends it
    while True:
        try:
            solver, axis, seed, place = connection.recv()
        except EOFError:
            return
        connection.send(measure(_cells(axis, seed)[place], solver))
