"""Rows that stand out from all others: slow ones, and those whose velocities or accelerations do not make the next row.

Every row is looked at, with all others at once, and the accelerations at some; what stands out is no proof, but a place for
a window to begin.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector

STILL = 1e-3  # of the median speed of change: slower rows may be frozen
LEAP = 30.0  # times the median of what the velocities leave of the way to the next row: a larger one may be a jump
APART = 1e-9  # of the interval: the way between rows nearer to one another is roundoff

Between = Callable[[Vector, Matrix, Matrix], Matrix]  # vdot (k, n) at t (k,), q and v (k, n)


def stand_out(rows: Any, size: Vector) -> list[int]:
    """Those ``rows`` i, with t, q, v, whose way to row i + 1 stands out; ``size`` (2n,) of [q, v].

    At most three: the first that hardly moves, the slowest of these, and the one whose velocities leave most of its way.
    """
    t = rows.t
    dt = np.diff(t)
    if dt.size < 3:
        return []
    usable = np.abs(dt) > APART * abs(t[-1] - t[0])
    way, left = _ways(t, rows.q, rows.v, size)
    speed = way / np.where(usable, np.abs(dt), np.inf)
    found = set()
    slow = np.flatnonzero(usable & (speed < STILL * np.median(speed[usable]))) if usable.any() else np.empty(0, int)
    if slow.size:
        found |= {int(slow[0]), int(slow[np.argmin(speed[slow])])}
    return sorted(found | set(_largest(left)))


def bends(t: Vector, y: Matrix, vdot: Matrix, between: Between, parts: Matrix, size: Vector) -> list[int]:
    """Rows i whose way to row i + 1 the accelerations make least, of rows y = [q, v] (k, 2n) at ``t`` (k,).

    Three leave something of it: for v the trapezoidal rule, for q that with end corrections, and the accelerations
    ``between``, at ``parts`` (p, k - 1) of each way, where cubic Hermite polynomials lead.  A force that acts in between,
    and that neither row knows of, shows in these only.
    """
    if t.size < 4:
        return []
    n, dt = size.size // 2, np.diff(t)[:, None]
    q, v = y[:, :n], y[:, n:]
    with np.errstate(all="ignore"):
        left_of_q = np.diff(q, axis=0) - dt * (v[1:] + v[:-1]) / 2 + dt**2 * np.diff(vdot, axis=0) / 12
        left_of_v = np.diff(v, axis=0) / dt - (vdot[1:] + vdot[:-1]) / 2
        inside = []
        for s in parts[:, :, None]:
            there = (1 - s) * vdot[:-1] + s * vdot[1:] + 6 * s * (1 - s) * left_of_v
            found = between(t[:-1] + s[:, 0] * np.diff(t), _hermite(s, dt, q, v), _hermite(s, dt, v, vdot))
            inside.append(np.abs(found - there))
        left = left_of_q / size[:n], left_of_v / size[n:], np.max(inside, axis=0) / size[n:]
        worst = [np.nan_to_num(np.max(np.abs(one), axis=1), posinf=0.0) for one in left]
    return sorted({i for one in worst for i in _largest(one)})


def _hermite(s: Matrix, dt: Matrix, x: Matrix, rate: Matrix) -> Matrix:
    """Cubic Hermite polynomials through ``x`` (k, n) with ``rate`` (k, n), at ``s`` (k - 1, 1) of each way; (k - 1, n)."""
    way = np.diff(x, axis=0)
    return x[:-1] + s * way + s * (1 - s) * ((1 - s) * (dt * rate[:-1] - way) - s * (dt * rate[1:] - way))


def _largest(left: Vector) -> list[int]:
    worst = int(np.argmax(left))
    return [worst] if left[worst] > LEAP * np.median(left) else []


def _ways(t: Vector, q: Matrix, v: Matrix, size: Vector) -> tuple[Vector, Vector]:
    """The largest parts, in units of ``size``, of ways to the next row and of what velocities leave of them, (k - 1,)."""
    way = np.max(np.abs(np.diff(np.concatenate([q, v], axis=1), axis=0)) / size, axis=1)
    left = np.diff(q, axis=0) - np.diff(t)[:, None] * (v[1:] + v[:-1]) / 2
    return way, np.max(np.abs(left) / size[: q.shape[1]], axis=1)
