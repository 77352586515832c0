"""Worker processes behind the interface of ``concurrent.futures``: a task that crashes, hangs or exhausts the memory
costs only itself.

Tasks go out one at a time, so nothing else is lost with a worker; they go where their problem and solver are loaded and
compiled already.

Pebble (5.2) and loky (3.7) were tried in this place.  With loky one killed worker fails every task that waits or runs (here
none), and one that hangs in C hangs for good.  With Pebble both cost their task only, but a process that a task has forked
survives its time limit, as does a worker in C after a kill of the runner (also with loky; ours are gone at once).  Neither
limits memory, separates compiling from solving in a time limit, or sends tasks of a compiled pair to the worker that has
it. Their overhead, 0.3 and 0.6 ms a task, is no smaller than here, 0.3 ms.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing.connection import wait
from typing import Any

from hhtbench.campaign.machine import machine_facts, total_memory, usable_cores
from hhtbench.campaign.process import WorkerProcess
from hhtbench.campaign.run import MEASURING, WARM_UP
from hhtbench.campaign.waiting import WaitingTasks
from hhtbench.catalogue.filespec import refuse_nested
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.result import Status

POLL = 0.05  # s between checks of deadlines and memory
GRACE = 5.0  # s beyond its budget before a worker is killed: a solver that obeys its budget ends by itself
START_LIMIT = 120.0  # s to start Python and import JAX
COMPILE_LIMIT = 60.0  # s for compiling, and for measuring, beyond the budget of the solve
MOST_KILLS = 3  # kills from outside under one task, after which the task counts as crashed
MOST_STARTS = 3  # consecutive failed starts of workers, after which the pool fails
MOST_KILLED_STARTS = 20  # consecutive workers killed from outside while they start, after which the pool fails
MEMORY_SHARE = 0.8  # share of the machine's memory that all workers together may use


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Number of worker processes and memory of each."""

    jobs: int = 2
    memory: int = 4 * 2**30  #: resident memory [bytes]


def machine_limits(jobs: int | None = None) -> Limits:
    """Return limits that share the machine's memory among ``jobs`` workers, by default one per core."""
    jobs = jobs or usable_cores()
    return Limits(jobs=jobs, memory=int(MEMORY_SHARE * total_memory() / jobs))


@dataclass(frozen=True, kw_only=True)
class Task:
    """One cell to solve and measure, or to time."""

    problem: str  #: canonical spec
    solver: str  #: canonical spec
    request: dict[str, Any]  #: as in :class:`~hhtbench.campaign.store.rows.RunRow`
    repeats: int = 0  #: > 0: time that many solves instead of measuring one


def run_task(task: Task) -> dict[str, Any]:
    """Run ``task`` and return its part of a row; a crash, a timeout or lack of memory becomes its ``status``.

    A :class:`WorkerPool` runs it in its own workers.  Any other executor calls it in a thread or on another machine; that
    process then starts workers of its own.
    """
    with _one_pool:
        pool = _pool_of_this_process()
    return dict(pool.submit(run_task, task).result())


_one_pool = threading.Lock()  # threads of one process share it


@cache
def _pool_of_this_process() -> WorkerPool:
    return WorkerPool(machine_limits())


@dataclass(eq=False)
class _Entry:
    """A submitted task with its future."""

    task: Task
    future: Future[dict[str, Any]]
    kills: int = 0  #: workers that somebody else has killed under it


class WorkerPool(Executor):
    """Executor for :func:`run_task` only; a context manager that leaves no process behind.

    One thread starts the workers, hands out tasks, and watches deadlines and memory.  It lives as long as the workers do,
    since the system ends a worker with the thread that started it.

    A crash or lack of memory is attributed to a task only in a worker that has done nothing else before, since earlier
    tasks may have caused it.  A worker killed from outside proves nothing about its task.
    """

    def __init__(self, limits: Limits) -> None:
        refuse_nested()
        self.limits = limits
        self._lock = threading.Lock()
        self._arrived: deque[_Entry] = deque()  # submitted, not yet seen by the thread
        self._closed = False
        self._cancelled = False
        self._failure: BaseException | None = None  # why nothing more can be run
        self._bell = self._ring = -1  # ends of a pipe: what wakes the thread
        self._thread: threading.Thread | None = None
        self._waiting = WaitingTasks()
        self._again: deque[_Entry] = deque()  # wait for a worker of their own
        self._workers: list[WorkerProcess] = []
        self._unanswered: set[_Entry] = set()  # entries that the thread has seen and not answered
        self._failed_starts = 0  # in a row
        self._killed_starts = 0  # in a row
        self._looked = 0.0

    def __exit__(self, kind: Any, *_: object) -> None:
        """Wait for all tasks; after an exception, Ctrl-C included, end them."""
        self.shutdown(wait=True, cancel_futures=kind is not None)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit ``run_task, task``; the future's result is a mapping, and it raises only if no worker can start."""
        if fn is not run_task or kwargs or len(args) != 1 or not isinstance(args[0], Task):
            raise TypeError("a WorkerPool runs nothing but run_task(Task(...)).")
        entry = _Entry(args[0], Future())
        with self._lock:
            if self._failure is not None:
                raise self._failure
            if self._closed:
                raise RuntimeError("the pool is closed; no task can be submitted.")
            self._arrived.append(entry)
            if self._thread is None:
                self._bell, self._ring = os.pipe()
                self._thread = threading.Thread(target=self._serve, name="hhtbench workers", daemon=True)
                self._thread.start()
            elif len(self._arrived) == 1:
                self._wake()
        return entry.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers once all tasks are done; with ``cancel_futures`` end them now, with their tasks."""
        with self._lock:
            self._closed = True
            self._cancelled = self._cancelled or cancel_futures
            self._wake()
        if wait and self._thread is not None:
            self._thread.join()

    def _wake(self) -> None:
        """Wake the pool's thread through its pipe; the caller holds the lock, under which the thread closes the pipe at its
        end.
        """
        if self._ring >= 0:
            os.write(self._ring, b"!")

    def _serve(self) -> None:
        """Main function of the pool's thread: hand out tasks and collect results until the pool is closed."""
        try:
            while not self._cancelled and (not self._closed or self._left()):
                self._turn()
        except BaseException as error:  # noqa: BLE001 - it is raised where a future is waited for
            self._failure = error
        for worker in self._workers:
            worker.kill()
        with self._lock:
            self._closed = True
            self._unanswered.update(self._arrived)
            os.close(self._bell)
            os.close(self._ring)
            self._bell = self._ring = -1
        for entry in self._unanswered:
            if self._failure is None:
                entry.future.cancel()
            if entry.future.running() or entry.future.set_running_or_notify_cancel():
                entry.future.set_exception(self._failure or CancelledError("the pool was shut down."))

    def _turn(self) -> None:
        with self._lock:
            arrived = list(self._arrived)
            self._arrived.clear()
        self._unanswered.update(arrived)
        for entry in arrived:
            self._waiting.put((entry.task.problem, entry.task.solver), entry)
        self._refill()
        for worker in self._workers:
            if worker.ready and worker.task is None:
                self._hand_out(worker)
        waiting = not self._left() and all(worker.ready for worker in self._workers)
        said = wait([self._bell, *(worker.connection for worker in self._workers)], timeout=None if waiting else POLL)
        if self._bell in said:
            os.read(self._bell, 65536)
        self._receive(said)

    def _left(self) -> bool:
        return bool(self._arrived or self._again or self._waiting or self._busy())

    def _refill(self) -> None:
        """Start workers up to the limit; tasks in ``_again`` need a fresh worker each."""
        fresh = sum(worker.tasks == 0 for worker in self._workers)
        wanted = len(self._busy()) + len(self._waiting) + len(self._again)
        while len(self._workers) < self.limits.jobs and (fresh < len(self._again) or len(self._workers) < wanted):
            try:
                self._workers.append(WorkerProcess())
            except OSError as error:
                self._start_failed(str(error))
                return
            fresh += 1

    def _start_failed(self, why: str, killed: bool = False) -> None:
        self._failed_starts += not killed
        self._killed_starts += killed
        if self._failed_starts >= MOST_STARTS or self._killed_starts >= MOST_KILLED_STARTS:
            raise ProblemError(f"a worker cannot start, tried {self._failed_starts + self._killed_starts} times: {why}")

    def _busy(self) -> list[WorkerProcess]:
        return [worker for worker in self._workers if worker.task is not None]

    def _hand_out(self, worker: WorkerProcess) -> None:
        if worker.tasks == 0:
            self._failed_starts = self._killed_starts = 0
            if self._again:
                entry = self._again.popleft()
                worker.submit(entry, asdict(entry.task))
                return
        while (entry := self._waiting.take(worker)) is not None:
            if entry.future.set_running_or_notify_cancel():
                worker.submit(entry, asdict(entry.task))
                return
            self._unanswered.discard(entry)

    def _receive(self, said: list[Any]) -> None:
        """Read results of the workers with news, and every ``POLL`` seconds check all, since one may have died silently."""
        every = time.monotonic() > self._looked + POLL
        if every:
            self._looked = time.monotonic()
        for worker in list(self._workers):
            if every or worker.connection in said:
                self._check_limits(worker)

    def _check_limits(self, worker: WorkerProcess) -> None:
        try:
            result = worker.receive()
        except EOFError:
            self._bury(worker, Status.crashed, f"the worker died in {worker.phase}: {worker.last_words()}.")
            return
        if result is not None:
            entry, worker.task = worker.task, None
            if worker.worn:
                self._dismiss(worker)
            else:
                self._hand_out(worker)  # before the result is delivered: the worker need not wait for its processing
            self._answer(entry, result)
        elif worker.task is not None or not worker.ready:
            self._enforce(worker)

    def _enforce(self, worker: WorkerProcess) -> None:
        """Kill a worker that exceeds its time or memory."""
        limit = START_LIMIT
        if worker.task is not None:
            limit = worker.task.task.request["max_seconds"] + (
                COMPILE_LIMIT if worker.phase in (WARM_UP, MEASURING) else GRACE
            )
        spent = time.monotonic() - worker.since
        if spent > limit:
            text = f"{worker.phase} did not end within {limit:g} s and was killed; raise max_seconds."
            self._bury(worker, Status.deadline, text)
            return
        used = worker.resident()
        if used > self.limits.memory:
            text = (
                f"{worker.phase} used {used / 2**30:.1f} GiB and was killed; the limit is {self.limits.memory / 2**30:.1f}."
            )
            self._bury(worker, Status.out_of_memory, text)

    def _dismiss(self, worker: WorkerProcess) -> None:
        worker.kill()
        self._workers.remove(worker)
        self._waiting.lost(worker)

    def _bury(self, worker: WorkerProcess, status: Status, message: str) -> None:
        """Remove a failed worker; its task ends with ``status`` or is tried again."""
        killed_by = worker.killed_by  # before we kill it
        entry: _Entry | None = worker.task
        self._dismiss(worker)
        if entry is None:
            if not worker.ready:
                self._start_failed(message, killed_by is not None)
            return
        entry.kills += killed_by is not None
        if self._proves_nothing(entry, worker, status, killed_by is not None):
            self._again.append(entry)
            return
        times = f" It was killed from outside under this task {entry.kills} times." if entry.kills > 1 else ""
        self._answer(entry, {"status": status.label, "message": f"{message}{times}"})

    def _answer(self, entry: _Entry, result: dict[str, Any]) -> None:
        self._unanswered.discard(entry)
        entry.future.set_result({"environment": machine_facts(), **result})

    @staticmethod
    def _proves_nothing(entry: _Entry, worker: WorkerProcess, status: Status, killed: bool) -> bool:
        """True if the worker's end may come from outside or from its earlier tasks, so that the task is tried again."""
        if killed:
            return entry.kills < MOST_KILLS
        return worker.tasks > 1 and status is not Status.deadline
