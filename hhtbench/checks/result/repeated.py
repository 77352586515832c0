"""Plausibility of what a campaign measures beside a solve: work per time, and the end of a second solve."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Solution

ANOTHER, GLOBAL = 0.4, 1e4  # largest believable difference of two ends: over the size, and over the relative tolerance
FASTEST = 1e-10  # s: no computer takes a step, or evaluates a force, in less


def impossible_work(counters: Counters, seconds: float) -> str:
    """Name a counter that is too large for ``seconds`` of wall time; "" if none."""
    for field in fields(Counters):
        value = getattr(counters, field.name)
        if isinstance(value, (int, np.integer)) and value * FASTEST > seconds:
            return f"counters: {value:.3g} {field.name} within {seconds:.2g} s are more than a computer can do."
    return ""


def ends_elsewhere(problem: Problem, request: Request, first: Solution, again: Solution) -> str:
    """Describe the difference between the ends of two solves of the same request; "" if it is believable."""
    if not (first.t.size and again.t.size and first.t[-1] == again.t[-1]):
        return ""
    rtol = 0.0 if request.rtol is None else float(np.max(request.rtol))
    allowed = min(ANOTHER, GLOBAL * rtol) if rtol > 0.0 else ANOTHER
    for name in ("q", "v"):
        one, other = getattr(first, name), getattr(again, name)[-1]
        size = max(float(np.max(np.abs(one))), float(np.max(getattr(problem.scales, name))))
        off = float(np.max(np.abs(one[-1] - other)))
        if off > allowed * size:
            return (
                f"repetition: solved again with its last row only, it ends with {name} off by {off / size:.2g} of its size."
            )
    return ""
