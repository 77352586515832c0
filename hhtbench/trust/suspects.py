"""Rows that stand out from all others: those that hardly move, and a step to the next row that their velocities do not make.

Every row is looked at, with all others at once; what stands out is no proof, but a place for a window to begin.
"""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Matrix, Vector

STILL = 1e-3  # of the median speed of change: slower rows may be frozen
LEAP = 30.0  # times the median of what the velocities leave of the way to the next row: a larger one may be a jump
APART = 1e-9  # of the interval: the way between rows nearer to one another is roundoff


def stand_out(t: Vector, q: Matrix, v: Matrix, size: Vector) -> list[int]:
    """At most two rows i whose way to row i + 1 stands out, of rows t (k,), q and v (k, n); ``size`` (2n,) of [q, v]."""
    dt = np.diff(t)
    if dt.size < 3:
        return []
    way = np.diff(np.concatenate([q, v], axis=1), axis=0) / size
    usable = np.abs(dt) > APART * abs(t[-1] - t[0])
    length = np.where(usable, np.abs(dt), np.inf)
    speed = np.max(np.abs(way), axis=1) / length
    left = np.max(np.abs(np.diff(q, axis=0) - dt[:, None] * (v[1:] + v[:-1]) / 2) / size[: q.shape[1]], axis=1)
    found = []
    slow = np.flatnonzero(usable & (speed < STILL * np.median(speed[usable]))) if usable.any() else np.empty(0, int)
    if slow.size:
        found.append(int(slow[0]))
    worst = int(np.argmax(left))
    if left[worst] > LEAP * np.median(left):
        found.append(worst)
    return found
