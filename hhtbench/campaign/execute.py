"""A pool of worker processes in which a task that crashes, hangs or eats the memory costs only itself.

Tasks go out one at a time, so nothing else is lost with a worker; they go where their problem and solver are loaded and
compiled already.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any

from hhtbench.campaign.plan import Cell
from hhtbench.campaign.process import WorkerProcess
from hhtbench.campaign.run import WARM_UP
from hhtbench.errors import ProblemError
from hhtbench.result import Status

POLL = 0.05  # s between looks at deadlines and memory
GRACE = 5.0  # s beyond its budget before a worker is killed: a solver that obeys its budget ends by itself
START_LIMIT = 120.0  # s to start Python and import JAX
COMPILE_LIMIT = 60.0  # s for compiling, beyond the budget of the solve


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What one worker may use."""

    jobs: int = 2
    memory: int = 4 * 2**30  #: resident memory [bytes]


Result = Callable[[Cell, dict[str, Any]], None]  #: called with the answer of a cell, in the parent


class Pool:
    """Worker processes that stay for several passes; a context manager that leaves none behind."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._workers: list[WorkerProcess] = []

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.kill()
        self._workers.clear()

    def run(self, cells: tuple[Cell, ...], on_result: Result, *, repeats: int = 0, at_once: int | None = None) -> None:
        """Run every cell, at most ``at_once`` at the same time; ``repeats`` > 0 times them instead of measuring.

        Raises
        ------
        ProblemError
            A worker cannot even start.
        """
        waiting = list(cells)
        at_once = self.limits.jobs if at_once is None else at_once
        while waiting or self._busy():
            self._refill(min(self.limits.jobs, len(waiting) + len(self._busy())))
            self._hand_out(waiting, at_once, repeats)
            wait([worker.connection for worker in self._workers], timeout=POLL)
            for worker in list(self._workers):
                self._look_at(worker, on_result)

    def _busy(self) -> list[WorkerProcess]:
        return [worker for worker in self._workers if worker.task is not None]

    def _refill(self, count: int) -> None:
        while len(self._workers) < count:
            self._workers.append(WorkerProcess())

    def _hand_out(self, waiting: list[Cell], at_once: int, repeats: int) -> None:
        while waiting and len(self._busy()) < at_once:
            idle = [worker for worker in self._workers if worker.ready and worker.task is None]
            choices = [(self._rank(worker, cell), i, worker) for worker in idle for i, cell in enumerate(waiting)]
            choices = [choice for choice in choices if choice[0] is not None]
            if not choices:
                return
            _, index, worker = min(choices, key=lambda choice: choice[:2])
            cell = waiting.pop(index)
            worker.submit(
                cell, {"problem": cell.problem, "solver": cell.solver, "request": cell.request, "repeats": repeats}
            )

    def _rank(self, worker: WorkerProcess, cell: Cell) -> int | None:
        """How well the cell suits the worker, 0 best; None where it should wait for another that has compiled it."""
        pair = (cell.problem, cell.solver)
        if pair in worker.pairs:
            return 0
        if any(pair in other.pairs for other in self._workers):
            return None
        if cell.problem in worker.problems:
            return 1
        return 3 if any(cell.problem in other.problems for other in self._workers) else 2

    def _look_at(self, worker: WorkerProcess, on_result: Result) -> None:
        try:
            result = worker.receive()
        except EOFError:
            self._bury(worker, on_result, Status.crashed, f"the worker died in {worker.phase}: {worker.last_words()}.")
            return
        if result is not None:
            cell, worker.task = worker.task, None
            on_result(cell, result)
        elif worker.task is not None or not worker.ready:
            self._enforce(worker, on_result)

    def _enforce(self, worker: WorkerProcess, on_result: Result) -> None:
        """Kill a worker that is over its time or memory."""
        limit = START_LIMIT
        if worker.task is not None:
            limit = worker.task.request["max_seconds"] + (COMPILE_LIMIT if worker.phase == WARM_UP else GRACE)
        spent = time.monotonic() - worker.since
        if spent > limit:
            text = f"{worker.phase} did not end within {limit:g} s and was killed; raise max_seconds."
            self._bury(worker, on_result, Status.deadline, text)
            return
        used = worker.resident()
        if used > self.limits.memory:
            text = (
                f"{worker.phase} used {used / 2**30:.1f} GiB and was killed; the limit is {self.limits.memory / 2**30:.1f}."
            )
            self._bury(worker, on_result, Status.out_of_memory, text)

    def _bury(self, worker: WorkerProcess, on_result: Result, status: Status, message: str) -> None:
        cell, started = worker.task, worker.ready
        worker.kill()
        self._workers.remove(worker)
        if cell is not None:
            on_result(cell, {"status": status.label, "message": message})
        elif not started:
            raise ProblemError(f"a worker cannot start: {message}")
