"""The one check of every success: shapes, order of times, finiteness, the start, counters, constraints, rows that stand still.

It integrates nothing and costs some microseconds, so that a solve need not be asked for it.
"""

from __future__ import annotations

from typing import Any

from hhtbench.counting import Clock
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.trust.frozen import frozen
from hhtbench.trust.levels import violated
from hhtbench.trust.rank import unknown_without_reason
from hhtbench.trust.rows import doubt_about


def check_success(problem: Problem, request: Request, solution: Any, clock: Clock | None = None) -> str:
    """Why what a solver returned as a success cannot be one; "" where nothing says so, or where it is no success.

    Functions of a NumPy system are called at few rows, and no more when the time of ``clock`` is over.
    """
    doubt = doubt_about(problem, request, solution)
    if doubt or not solution.success:
        return doubt
    return (
        unknown_without_reason(problem, solution, clock)
        or violated(problem, request, (solution.t, solution.q, solution.v), clock=clock)
        or frozen(problem, solution.t, solution.q, solution.v)
    )
