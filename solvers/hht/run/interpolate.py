"""Compiled interpolation of output rows within the accepted steps."""

from __future__ import annotations

from hhtbench.lowering.compile.loops import BoolArray, FloatArray, FloatMatrix
from solvers.hht.sources import called, cubic, smooth_rise
from solvers.kernel.sections import put


@called
def interpolate(n: int, m: int, steps: FloatMatrix, times: FloatArray, rows: FloatMatrix, between: BoolArray) -> None:
    """Fill ``rows`` [t, q, v, lam, mu] at ``times`` within the ``steps``, both in the direction of the motion, by (H17).

    ``steps`` are rows [t, h, q, v, a, lam at both ends, mu]; of two with one time (an event has changed the state) the
    second is used.  Multipliers are those of the step's end after a row, first order; rows ``between`` ends are marked.
    """
    k, count = 0, steps.shape[0]
    direction = -1.0 if steps[count - 1, 0] < steps[0, 0] else 1.0
    for i in range(times.size):
        t, row = times[i], rows[i]
        while k + 1 < count and direction * steps[k + 1, 0] <= direction * t:
            k += 1
        start = steps[k]
        between[i] = start[0] != t
        end = steps[k + 1] if between[i] else start
        row[0] = t
        put(row, 1, start[2 : 2 + 2 * n])
        put(row, 1 + 2 * n, end[2 + 3 * n + m :])
        if between[i]:
            h = end[0] - start[0]
            s = (t - start[0]) / h
            for j in range(n):
                q, v = 2 + j, 2 + n + j
                rise = smooth_rise(h, start[q], end[q], start[v], end[v])
                row[1 + j], row[1 + n + j] = cubic(s, h, start[q], rise, start[v], end[v])
