"""Queue of tasks that finds the task that suits a worker best in constant time."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable
from typing import Any

ENOUGH_TO_COMPILE = 4  # waiting tasks of one pair for which another worker compiles it too


class WaitingTasks:
    """Queue of tasks by pair of problem and solver; a worker is given what it has loaded and compiled, if possible.

    Order of preference: a pair that the worker has; a new pair of a problem that it has; a new pair of a problem that no
    worker has; a new pair of another worker's problem; a pair of another worker with so many tasks that compiling it again
    pays.  A pair is new until a worker takes its first task; the rest of it waits for that worker.  Every set below is a
    dict without values, which keeps the order of arrival.
    """

    def __init__(self) -> None:
        self._tasks: dict[tuple[str, str], deque[Any]] = {}  # pairs of which some wait
        self._owners: dict[tuple[str, str], dict[Hashable, None]] = defaultdict(dict)
        self._own: dict[Hashable, dict[tuple[str, str], None]] = defaultdict(dict)  # pairs of a worker, some wait
        self._new: dict[str, dict[tuple[str, str], None]] = {}  # new pairs by problem, some wait
        self._loaded: dict[str, dict[Hashable, None]] = defaultdict(dict)  # workers that have a problem
        self._familiar: dict[Hashable, dict[str, None]] = defaultdict(dict)  # problems of a worker with new pairs
        self._untouched: dict[str, None] = {}  # problems with new pairs that nobody has
        self._long: dict[tuple[str, str], None] = {}  # pairs that somebody has, many wait
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def put(self, pair: tuple[str, str], task: Any) -> None:
        """Append ``task`` to the queue of ``pair`` (problem, solver)."""
        self._tasks.setdefault(pair, deque()).append(task)
        self._count += 1
        self._note(pair)

    def take(self, worker: Hashable) -> Any:
        """Remove and return the task that suits ``worker`` best, or None; the worker then owns the task's pair."""
        pair = self._best(worker)
        if pair is None:
            return None
        self._assign(pair, worker)
        task = self._tasks[pair].popleft()
        self._count -= 1
        self._note(pair)
        return task

    def lost(self, worker: Hashable) -> None:
        """Forget ``worker``, which is gone: pairs that only it had are new again."""
        self._own.pop(worker, None)
        self._familiar.pop(worker, None)
        for problem in [problem for problem, workers in self._loaded.items() if worker in workers]:
            del self._loaded[problem][worker]
            if problem in self._new and not self._loaded[problem]:
                self._untouched[problem] = None
        for pair in [pair for pair, workers in self._owners.items() if worker in workers]:
            del self._owners[pair][worker]
            self._note(pair)

    def _best(self, worker: Hashable) -> tuple[str, str] | None:
        for pair in self._own[worker]:
            return pair
        for problem in (*self._first(self._familiar[worker]), *self._first(self._untouched), *self._first(self._new)):
            return next(iter(self._new[problem]))
        return next(iter(self._long), None)

    @staticmethod
    def _first(some: dict[str, Any]) -> tuple[str, ...]:
        for name in some:
            return (name,)
        return ()

    def _assign(self, pair: tuple[str, str], worker: Hashable) -> None:
        problem = pair[0]
        self._owners[pair][worker] = None
        self._own[worker][pair] = None
        self._loaded[problem][worker] = None
        self._untouched.pop(problem, None)
        if problem in self._new:
            self._familiar[worker][problem] = None
            self._drop_new(pair)

    def _note(self, pair: tuple[str, str]) -> None:
        """Update the sets for ``pair`` after its tasks or its owners have changed."""
        waiting, owners = self._tasks.get(pair, ()), self._owners.get(pair, {})
        if not waiting:
            self._tasks.pop(pair, None)
        for worker in owners:
            if waiting:
                self._own[worker][pair] = None
            else:
                self._own[worker].pop(pair, None)
        if owners and len(waiting) >= ENOUGH_TO_COMPILE:
            self._long[pair] = None
        else:
            self._long.pop(pair, None)
        if waiting and not owners:
            self._add_new(pair)
        else:
            self._drop_new(pair)

    def _add_new(self, pair: tuple[str, str]) -> None:
        problem = pair[0]
        self._new.setdefault(problem, {})[pair] = None
        for worker in self._loaded.get(problem, {}):
            self._familiar[worker][problem] = None
        if not self._loaded.get(problem):
            self._untouched[problem] = None

    def _drop_new(self, pair: tuple[str, str]) -> None:
        problem = pair[0]
        pairs = self._new.get(problem, {})
        pairs.pop(pair, None)
        if not pairs:
            self._new.pop(problem, None)
            self._untouched.pop(problem, None)
            for worker in self._loaded.get(problem, {}):
                self._familiar[worker].pop(problem, None)
