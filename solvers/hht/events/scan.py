"""Sampling of event functions along one step's dense output, and detection of sign changes."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.sources import crosses, cubic
from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.sections import address, indices, invoke, part

EXTRA = 2  # samples in addition to those inside a step: its start and its end


@compiled
def scan(z: Any, counts: Any) -> Any:
    """CONVERGED if no event function changes sign in its direction in the attempt, else EVENT_FOUND or EVENT_NONFINITE."""
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
    """Sample event ``e`` along the step, from index ``first`` on; False if a value is not finite.

    After a start at a zero, values count as zero while they are roundoff.
    """
    times, values, known = part(z, mem.SAMPLE_TIMES), part(z, mem.SAMPLE_VALUES), part(z, mem.EVENT_VALUES)
    t0, t1 = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)[mem.T_END]
    roundoff = known[known.size // 2 + e]
    times[first], values[first] = t0, known[e]
    for k in range(1, count):
        at = first + k
        times[at] = t1 if k == count - 1 else t0 + k / (count - 1) * (t1 - t0)
        counts[mem.LOOKS] += 1
        values[at] = value_at(z, e, times[at])
        if not math.isfinite(values[at]):
            return False
        if roundoff > 0.0 and abs(values[at]) <= roundoff:
            values[at] = known[e]
        else:
            roundoff = 0.0
    return True


@compiled
def value_at(z: Any, e: Any, t: Any) -> Any:
    """Value of event ``e`` at time t within the attempt."""
    n, place, end, q, v = z.i[mem.N], part(z, mem.PLACE), part(z, mem.END), part(z, mem.Q), part(z, mem.V)
    t0, t1 = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)[mem.T_END]
    h = t1 - t0
    place[0] = t
    for i in range(n):
        place[1 + i], place[1 + n + i] = end[i], end[n + i]
        if t != t1:
            place[1 + i], place[1 + n + i] = cubic((t - t0) / h, h, q[i], end[i] - q[i], v[i], end[n + i])
    at, code = address(z, mem.PLACE), indices(z, mem.EVENT_CODE)
    part(z, mem.EVENT)[0] = math.nan
    invoke(code[2 * e], (address(z, mem.EVENT), code[2 * e + 1], at, at + 8, at + 8 + 8 * n))
    return part(z, mem.EVENT)[0]


@compiled
def keep_values(z: Any) -> None:
    """Store the event values at the attempt's end as those at the start of the next step."""
    first, values, known = 0, part(z, mem.SAMPLE_VALUES), part(z, mem.EVENT_VALUES)
    events = indices(z, mem.DIRECTIONS).size
    for e in range(events):
        first += indices(z, mem.SAMPLES)[e] + EXTRA
        if values[first - 1] != known[e]:  # it has left its zero
            known[e], known[events + e] = values[first - 1], 0.0
