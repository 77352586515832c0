"""Chrono's step control, for comparison: doubled after five easy steps, halved where Newton's iteration is hard.

It looks at no error, and is made of the public steps of :class:`~solvers.hht.solver.HHT`, as anyone's own control can be.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.result import Solution, Status
from solvers._ending import empty_solution
from solvers._start import Failure
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import guesses

ROW = 5  # easy steps before the step is doubled
MOST = 6  # iterations of an easy step; one that needs more counts as a failure


def chrono_steps(hht: HHT, h: float, t1: float) -> Iterator[Status]:
    """Step ``hht`` on to ``t1`` [s], forward, from what :meth:`HHT.init_step` prepared with steps of ``h`` [s].

    Yields success after every easy step; last, where not even the shortest is easy, the status that says so.
    """
    easy = 0
    while hht.state.t < t1:
        before, iterations = hht.state, hht.counters.newton_iterations or 0
        status = hht.step(tstop=t1)
        if status is Status.time_resolution:
            yield status
            return
        if status is not Status.success or (hht.counters.newton_iterations or 0) - iterations > MOST:
            h, easy = h / 2, 0
            hht.restart(before, step=h)
            continue
        yield status
        easy += 1
        if easy == ROW:
            h, easy = 2 * h, 0
            hht.restart(hht.state, step=h)


def solve_as_chrono(problem: Problem, request: Request, alpha: float) -> Solution:
    """States at ``request.t_eval``, without multipliers; the first step is the one that error control accepts."""
    began, times, (t0, t1) = time.perf_counter(), np.asarray(request.t_eval), problem.t_span
    hht = HHT(problem.system, alpha=alpha, start="trapezoidal")
    start: dict[str, Any] = {"t0": t0, "q0": problem.q0, "v0": problem.v0, **guesses(problem)}
    rows, ends = [np.zeros((0, 2 * problem.q0.size))], [-np.inf]
    status = hht.init_step(rtol=request.rtol, atol=request.atol, **start)
    if status is Status.success and (status := hht.step(tstop=t1)) is Status.success:
        h = hht.state.h or t1 - t0
        status = hht.init_step(step=h, **start)
    steps = chrono_steps(hht, h, t1) if status is Status.success else iter([status])
    for status in steps:
        if status is Status.success and request.max_seconds and time.perf_counter() - began > request.max_seconds:
            status = Status.deadline
        if status is not Status.success:
            break
        rows.append(np.hstack(hht.interpolate(times[(times > ends[-1]) & (times <= hht.state.t)])))
        ends.append(hht.state.t)
    q, v = np.hsplit(np.concatenate(rows), 2)
    counters = replace(hht.counters, steps_accepted=len(ends) - 1)  # hard ones were withdrawn
    return replace(empty_solution(problem.q0.size, Failure(status, hht.message), counters), t=times[: len(q)], q=q, v=v)
