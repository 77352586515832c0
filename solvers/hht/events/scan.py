"""Event functions along one step's dense output: sampled, and whether a sign changes."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import EPS
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import compiled, crosses, cubic
from solvers.hht.loops.sections import address, indices, invoke, part

EXTRA = 3  # samples of a step beside those inside: its start, a place just behind it, its end
LEAVING = 1e-8  # of the step after a start or a change: there the side that the motion leaves to is looked up
ZERO = 1e-12  # of the largest value in the step: what a start on the zero of an event function may be off
SPACINGS = 8.0  # of times, at most: that a start on a zero has no better time


@compiled
def scan(z: Any, counts: Any) -> Any:
    """CONVERGED where no event function changes its sign in the attempt in the direction asked for, else what happens.

    After a start or a change the values there are not known: one near zero counts as zero, and the motion leaves it
    without an event.
    """
    directions, times, values = indices(z, mem.DIRECTIONS), part(z, mem.SAMPLE_TIMES), part(z, mem.SAMPLE_VALUES)
    first, found = 0, False
    for e in range(directions.size):
        count = indices(z, mem.SAMPLES)[e] + EXTRA
        if not sample(z, e, first, count, counts):
            return mem.EVENT_NONFINITE
        for k in range(first + 1, first + count):
            found |= times[k] != times[k - 1] and crosses(values[k - 1], values[k], directions[e])
        first += count
    return mem.EVENT_FOUND if found else mem.CONVERGED


@compiled
def sample(z: Any, e: Any, first: Any, count: Any, counts: Any) -> Any:
    """The values of event ``e`` along the step into the samples from ``first`` on; False where one is not finite."""
    times, values = part(z, mem.SAMPLE_TIMES), part(z, mem.SAMPLE_VALUES)
    t0, t1 = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)[mem.T_END]
    begins, scale = z.i[mem.EVENTS_KNOWN] == 0, 0.0
    blurred = min(SPACINGS * EPS * abs(t0 / (t1 - t0)), 0.25 / (count - 2))  # of the step
    for k in range(count):
        at = first + k
        times[at] = t0 + max(LEAVING, 2.0 * blurred) * (t1 - t0) if k == 1 and begins else t0
        if k > 1:
            times[at] = t1 if k == count - 1 else t0 + (k - 1) / (count - 2) * (t1 - t0)
        if k > 1 or begins:
            counts[mem.LOOKS] += 1
            values[at] = value_at(z, e, times[at])
            if not math.isfinite(values[at]):
                return False
        else:
            values[at] = part(z, mem.EVENT_VALUES)[e]
        scale = max(scale, abs(values[at]))
    if begins and abs(values[first]) <= max(ZERO, blurred) * scale:
        values[first] = 0.0
    return True


@compiled
def value_at(z: Any, e: Any, t: Any) -> Any:
    """The value of event ``e`` at t in the attempt."""
    n, place, end, q, v = z.i[mem.N], part(z, mem.PLACE), part(z, mem.END), part(z, mem.Q), part(z, mem.V)
    t0, t1 = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)[mem.T_END]
    h = t1 - t0
    place[0] = t
    for i in range(n):
        place[1 + i], place[1 + n + i] = end[i], end[n + i]
        if t != t1:
            place[1 + i], place[1 + n + i] = cubic((t - t0) / h, h, q[i], end[i], v[i], end[n + i])
    at, code = address(z, mem.PLACE), indices(z, mem.EVENT_CODE)
    part(z, mem.EVENT)[0] = math.nan
    invoke(code[2 * e], (address(z, mem.EVENT), code[2 * e + 1], at, at + 8, at + 8 + 8 * n))
    return part(z, mem.EVENT)[0]


@compiled
def keep_values(z: Any) -> None:
    """The values at the end of the attempt are those at the start of the next."""
    first, values = 0, part(z, mem.SAMPLE_VALUES)
    for e in range(indices(z, mem.DIRECTIONS).size):
        first += indices(z, mem.SAMPLES)[e] + EXTRA
        part(z, mem.EVENT_VALUES)[e] = values[first - 1]
    z.i[mem.EVENTS_KNOWN] = 1
