"""Rows that all repeat the first one, where its velocities or accelerations must have moved it."""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import AccelerationLevel, derive
from hhtbench.protocol import Problem
from hhtbench.trust.sizes import sizes_of

MOVED = 0.1  # of the typical size: by that much the start leads away over the interval, to first order


def frozen(problem: Problem, t: Vector, q: Matrix, v: Matrix) -> str:
    """That the rows t (k,), q and v (k, n) are one state bit by bit although it cannot rest; else ""."""
    if t.size < 2 or t[0] == t[-1] or q[0].tobytes() != q[-1].tobytes() or not (np.all(q == q[0]) and np.all(v == v[0])):
        return ""
    rates, size = [v[0]], np.split(sizes_of(problem, q, v), 2)
    try:
        found = AccelerationLevel(derive(problem.system, float(t[0]), q[0], v[0])).solve(
            float(t[0]), q[0].copy(), v[0].copy()
        )
        rates += [found.vdot] if found.converged else []
    except NonFiniteValue:
        pass
    way = max(float(np.max(np.abs(rate) / s)) for rate, s in zip(rates, size, strict=False)) * abs(float(t[-1] - t[0]))
    if way <= MOVED:
        return ""
    return f"motion: All rows are the state at t = {t[0]:.17g}, which leads away by {way:.2g} of its size over the interval."
