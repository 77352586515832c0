"""The one check of every success: shapes, times, finiteness, the start, counters, constraints, rows that stand still.

It integrates nothing and takes some microseconds.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from hhtbench.arguments import all_finite
from hhtbench.checks.result.levels import violated
from hhtbench.checks.result.rank import unknown_without_reason
from hhtbench.checks.result.rows import doubt_about
from hhtbench.checks.result.sizes import sizes_of
from hhtbench.counting import Clock
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import AccelerationLevel, derive
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.result import Solution

MOVED = 0.1  # of the typical size: by that much the start leads away over the interval, to first order


def check_success(problem: Problem, request: Request, solution: Any, clock: Clock | None = None) -> str:
    """Why what a solver returned as a success cannot be one; "" where nothing says so, or where it is no success.

    Functions of a NumPy system are called at few rows, and no more when the time of ``clock`` is over.
    """
    doubt = doubt_about(problem, request, solution)
    if doubt or not solution.success:
        return doubt
    if not (all_finite(solution.lam) and all_finite(solution.mu)):
        doubt = unknown_without_reason(problem, solution, clock)
    doubt = doubt or violated(problem, request, (solution.t, solution.q, solution.v), clock=clock)
    return doubt or (_rests(problem, solution) if solution.q[0].tobytes() == solution.q[-1].tobytes() else "")


def _rests(problem: Problem, solution: Solution) -> str:
    """That the rows are one state bit by bit although it cannot rest; else ""."""
    t, q, v = solution.t, solution.q, solution.v
    if t[0] == t[-1] or not (np.all(q == q[0]) and np.all(v == v[0])):
        return ""
    rates, size = [v[0]], np.split(sizes_of(problem, q, v), 2)
    dynamics = derive(problem.system, float(t[0]), q[0], v[0])
    with suppress(NonFiniteValue):
        found = AccelerationLevel(dynamics).solve(float(t[0]), q[0].copy(), v[0].copy())
        rates += [found.vdot] if found.converged else []
    way = max(float(np.max(np.abs(rate) / s)) for rate, s in zip(rates, size, strict=False)) * abs(float(t[-1] - t[0]))
    if way <= MOVED:
        return ""
    return f"motion: All rows are the state at t = {t[0]:.17g}, which leads away by {way:.2g} of its size over the interval."
