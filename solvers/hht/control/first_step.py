"""Length of the first step, and a substitute for the points before it, from the motion at the start."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.control.controller import ControlOptions
from solvers.hht.sources import called
from solvers.hht.step.stopping import weigh
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import acceleration_level
from solvers.kernel.compiled import compiled, inlined
from solvers.kernel.memory import Memory
from solvers.kernel.numbers import TINY
from solvers.kernel.sections import address, call_python, finite, indices, largest, part, put, spend, weighted_rms

PROBE = 1e-3  # of the time in which v and v' change q and v by their own size: where the change of v' is taken
CAUTION = 0.3  # safety factor on the suggested step: it is a guess, and a rejection costs a step
UNKNOWN = 1e-3  # first step relative to the interval where v' does not change: at rest, in free fall
STILL = 1e-10  # relative change of v' that is roundoff
SPACING = 2.0**-52  # shortest step relative to the size of times


@called
def plan_first_step(z: Memory, o: ControlOptions, stop: float, plain: bool) -> None:
    """Initialise step-size control at a start or restart towards ``stop`` [s], in the loops' memory, (H27).

    ``plain``: the first step's a0 is f there, ``start="f0"``.  A probe along v and v' estimates v'', from which the points
    before the first step are extrapolated.
    """
    n, control, vdot, left = z.i[mem.N], part(z, mem.CONTROL), part(z, mem.VDOT), stop - part(z, mem.NUMBER)[mem.T]
    longest = min(abs(left), o.max_step)
    probe = PROBE * min(longest, time_scale(z))
    signed = math.copysign(probe, left)
    known = jerk(z, signed, indices(z, mem.COUNTED))
    suggested = suggestion(z, probe, plain) if known else probe
    if suggested == 0.0:
        suggested = UNKNOWN * abs(left)
    suggested = max(suggested, SPACING * abs(stop - left), TINY)  # parts of the shortest intervals are zero
    control[mem.H_NEXT] = o.first_step if o.first_step > 0.0 else min(longest, suggested)  # not min_step: nothing told it
    control[mem.LAST], control[mem.LAST_ERROR], control[mem.HAS_REACTION_K] = signed, -1.0, 0.0
    before = part(z, mem.BEFORE)
    control[mem.LAST_BUT_ONE], control[mem.BOUND] = signed, math.inf
    for i in range(n):
        rate = before[i] if known else 0.0
        part(z, mem.Q_BEFORE)[i] = place_before(z, i, -signed, rate)
        part(z, mem.Q_FIRST)[i] = place_before(z, i, -2 * signed, rate)
        before[i] = vdot[i] - signed * before[i] if known else vdot[i]
    put(part(z, mem.ACCELERATION), 0, vdot)


@inlined
def place_before(z: Any, i: Any, s: Any, rate: Any) -> Any:
    """Coordinate i at s [s] from now by Taylor's formula with v, v' and v'' = ``rate``."""
    return part(z, mem.Q)[i] + s * (part(z, mem.V)[i] + s * (part(z, mem.VDOT)[i] / 2 + s * rate / 6))


@compiled
def suggestion(z: Any, probe: Any, plain: Any) -> Any:
    """|h| [s] whose leading local errors, h^3/12 |v''| in q and h^3/12 |v'''| in v, equal the tolerances; 0.0: unknown.

    If the first step's a0 is ``plain`` f, also |alpha| h^2 |v''| / 2 in v.
    """
    n, change, vdot, weights = z.i[mem.N], part(z, mem.BEFORE), part(z, mem.VDOT), part(z, mem.WEIGHTS)
    if largest(change) * probe <= STILL * largest(vdot):
        return 0.0
    root, _ = weigh(z, part(z, mem.Q), part(z, mem.V))
    in_q, in_v = weighted_rms(change, weights[:n]) / root, weighted_rms(change, weights[n:]) / root
    alpha, least = abs(part(z, mem.CONSTANTS)[mem.ALPHA]), math.inf
    if in_q > 0.0:
        least = min(least, CAUTION * (12 / in_q) ** (1 / 3))
    if in_v > 0.0:
        least = min(least, CAUTION * (12 / (in_v * rate_of(z, probe))) ** (1 / 3))
    if in_v > 0.0 and alpha > 0.0 and plain:
        least = min(least, CAUTION * math.sqrt(2 / (alpha * in_v)))
    return least if least < math.inf else 0.0


@compiled
def rate_of(z: Any, probe: Any) -> Any:
    """Rate [1/s] at which v'' changes: v''/v' or sqrt(v''/v), whichever is smaller; a lower bound at rest."""
    change, speed, acceleration = mean(part(z, mem.BEFORE)), mean(part(z, mem.V)), mean(part(z, mem.VDOT))
    rate = math.inf
    if acceleration > change * probe:
        rate = change / acceleration
    if speed > change * probe * probe:
        rate = min(rate, math.sqrt(change / speed))
    return max(rate if rate < math.inf else 0.0, PROBE / probe)


@compiled
def mean(x: Any) -> Any:
    """Root mean square of ``x``."""
    total = 0.0
    for i in range(x.size):
        total += x[i] * x[i]
    return math.sqrt(total / x.size)


@compiled
def time_scale(z: Any) -> Any:
    """Time [s] in which q changes by its size along v, or along v' from rest; a q near zero is sized by its tolerances."""
    n, number = z.i[mem.N], part(z, mem.NUMBER)
    speed, acceleration, scale = number[mem.SIZE_V], largest(part(z, mem.VDOT)), math.inf
    relative, absolute = largest(part(z, mem.RTOL)[:n]), largest(part(z, mem.ATOL)[:n])
    size = max(number[mem.SIZE_Q], absolute / relative if relative > 0.0 else 0.0)
    if size == 0.0:
        size = 1.0
    if speed > 0.0:
        scale = size / speed
    if acceleration > 0.0:
        scale = min(scale, math.sqrt(size / acceleration))
    if acceleration > 0.0 and speed > 0.0:
        scale = min(scale, speed / acceleration)
    return scale


@compiled
def jerk(z: Any, h: Any, counts: Any) -> Any:
    """Put v'' (n,), by a difference of v' over a step of h [s] along v and v', into BEFORE; False if unavailable."""
    n, t, place, change = z.i[mem.N], part(z, mem.NUMBER)[mem.T], part(z, mem.PLACE), part(z, mem.BEFORE)
    q, v, vdot, at = part(z, mem.Q), part(z, mem.V), part(z, mem.VDOT), address(z, mem.PLACE)
    if not math.isfinite(h) or t + h == t:
        return False
    place[0] = t + h
    for i in range(n):
        place[1 + i], place[1 + n + i] = q[i] + h * v[i], v[i] + h * vdot[i]
    there = part(z, mem.FORCE)
    if z.i[mem.M] + z.i[mem.P] > 0:
        if not acceleration_level(z, z.i[2 * mem.LAM], counts):
            return False
        there = part(z, mem.ACCELERATION_LEVEL)[1 + z.i[mem.M] + z.i[mem.P] :]
    elif spend(z, counts):
        call_python(z, mem.C_FORCE, mem.FORCE, (at, at + 8, at + 8 + 8 * n))
    else:
        return False
    for i in range(n):
        change[i] = (there[i] - vdot[i]) / h
    return finite(change)
