"""Which share of a foreign solver's time is spent in the equations: a run of its own, never a timed one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from hhtbench.protocol import Problem
from hhtbench.request import Request
from solvers import _run
from solvers._guard import Guard


@dataclass
class Spent:
    """Seconds inside the equations' functions, and inside these with the guard that counts and copies."""

    functions: float = 0.0
    guarded: float = 0.0
    calls: int = field(default=0)


@dataclass(frozen=True)
class Share:
    """Of the time of one solve."""

    functions: float  #: in the equations' own functions
    guards: float  #: in counting, copying and checking around them
    calls: int
    microseconds: float  #: of one function call


@contextmanager
def watched() -> Iterator[Spent]:
    """Runs of foreign solvers that begin in here add the time of their callbacks."""
    spent = Spent()

    class Watching(Guard):
        """A guard with a stopwatch inside and one outside."""

        def wrap(self, function: Callable[..., Any], shape: tuple[int, ...], **points: int) -> Callable[..., Any]:
            return _timed(super().wrap(_timed(function, spent, "functions"), shape, **points), spent, "guarded")

    kept = _run.Guard
    _run.Guard = Watching  # type: ignore[misc]
    try:
        yield spent
    finally:
        _run.Guard = kept  # type: ignore[misc]


def _timed(function: Callable[..., Any], spent: Spent, name: str) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        begun = time.perf_counter()
        try:
            return function(*arguments)
        finally:
            setattr(spent, name, getattr(spent, name) + time.perf_counter() - begun)
            spent.calls += name == "functions"

    return call


def share_of(problem: Problem, solver: Any, request: Request) -> Share | None:
    """The shares of one solve; None where it calls no guarded functions, as HHT, whose steps hold the equations."""
    with watched() as spent:
        begun = time.perf_counter()
        solver.solve(problem, request)
        whole = time.perf_counter() - begun
    if not spent.calls:
        return None
    inside = spent.functions / whole
    return Share(inside, spent.guarded / whole - inside, spent.calls, 1e6 * spent.functions / spent.calls)
