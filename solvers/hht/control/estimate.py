"""The local error of a step, (H23) to (H26): consistent with the constraints, filtered by the step's own matrix."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import GAUSS, ROUNDOFF
from solvers.hht.sources import cubic, roundoff_of, third_difference
from solvers.hht.step.stopping import weigh
from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.linear.matrix import respond
from solvers.kernel.numbers import EPS
from solvers.kernel.sections import address, call, part, put, view, weighted_rms

FILTERED = 3.0  # ratio of unfiltered to filtered error from which the response of stiff forces is computed, (H59)
SLIGHT = 1e-4  # smaller errors relative to the tolerance do not matter to the controller


@compiled
def begin(z: Any, at: Any, scale: Any) -> None:
    """Set RIGHT: accelerations (n,) at address ``at``, divided by ``scale``, in the force rows, zero elsewhere."""
    right, n = part(z, mem.RIGHT), z.i[mem.N]
    if z.i[mem.C_INERTIA]:
        call(z, mem.C_INERTIA, mem.WORK, (z.i[mem.BASE] + 8 * at, address(z, mem.STEP)))
        at = z.i[2 * mem.WORK]
    source = view(z.w, at, n)
    for i in range(right.size):
        right[i] = source[i] / scale if i < n else 0.0


@compiled
def put_levels(z: Any, lu: Any, sign: Any, position: Any) -> None:
    """Put ``sign`` times the constraint violations in LEVELS into the constraint rows of RIGHT."""
    right, off, h, m = part(z, mem.RIGHT), part(z, mem.LEVELS), part(z, mem.RECORD + lu)[mem.MADE_H], z.i[mem.M]
    for i in range(m):
        if position:
            right[z.i[mem.O_LAM0] + i] = sign * off[i] * (2 / (h * h))
        right[z.i[mem.O_LAM1] + i] = sign * off[m + i] / h
    for i in range(z.i[mem.P]):
        right[z.i[mem.O_MU] + i] = sign * off[2 * m + i] / h


@compiled
def levels_at(z: Any, t: Any) -> None:
    """Evaluate the constraint levels at t and the q, v in PLACE, into LEVELS."""
    part(z, mem.PLACE)[0] = t
    at = address(z, mem.PLACE)
    call(z, mem.C_LEVELS, mem.LEVELS, (at, at + 8, at + 8 + 8 * z.i[mem.N]))


@compiled
def filtered(z: Any, lu: Any, t1: Any, h: Any, inside: Any) -> Any:
    """Errors of q and v filtered by the matrix in ``lu``, as weighted root mean square.

    If ``inside``, second value: distance of dense output from the constraints inside the step, over the tolerances, (H28).
    """
    n, raw, made, o = z.i[mem.N], z.i[2 * mem.RAW], part(z, mem.RECORD + lu)[mem.MADE_H], part(z, mem.CONSTANTS)
    error, weights, solution, change = part(z, mem.ERROR), part(z, mem.WEIGHTS), part(z, mem.SOLUTION), part(z, mem.CHANGE)
    in_q, in_v = o[mem.BETA] * (made / h) * (made / h), made * o[mem.GAMMA]
    begin(z, raw, in_q)
    respond(z, lu)
    for i in range(n):
        error[i] = change[i]
        if z.i[mem.O_RK] >= 0:
            error[i] -= 0.5 * made * made * solution[z.i[mem.O_RK] + i]
    begin(z, raw + n, in_v)
    respond(z, lu)
    begin(z, z.i[2 * mem.CHANGE] + n, in_v)  # once more, together with what the error of q makes of v across the constraints
    if z.i[mem.M] + z.i[mem.P] > 0:
        place, end = part(z, mem.PLACE), part(z, mem.END)
        for i in range(n):
            place[1 + i], place[1 + n + i] = end[i] + error[i], end[n + i]
        levels_at(z, t1)
        put_levels(z, lu, -1.0, False)
    respond(z, lu)
    put(error, n, change[n:])
    size = weighted_rms(error, weights)
    if not inside:
        return size, 0.0
    begin(z, raw, math.inf)
    levels_inside(z, h)
    put_levels(z, lu, 1.0, True)
    respond(z, lu)
    return size, weighted_rms(change, weights)


@compiled
def levels_inside(z: Any, h: Any) -> None:
    """Evaluate the constraint levels of dense output inside the step, where the error of its v is largest."""
    n, end, q, v, place = z.i[mem.N], part(z, mem.END), part(z, mem.Q), part(z, mem.V), part(z, mem.PLACE)
    for i in range(n):
        place[1 + i], place[1 + n + i] = cubic(GAUSS, h, q[i], end[i] - q[i], v[i], end[n + i])
    levels_at(z, part(z, mem.NUMBER)[mem.T] + GAUSS * h)


@compiled
def roundoff(z: Any, h: Any) -> Any:
    """Roundoff of q and v in a step of h [s] over the tolerance, (H26)."""
    n, q, v, error = z.i[mem.N], part(z, mem.Q), part(z, mem.V), part(z, mem.ERROR)
    relative, _ = weigh(z, q, v)
    for i in range(n):
        error[i], error[n + i] = roundoff_of(q[i], v[i], h)
    return weighted_rms(error, part(z, mem.WEIGHTS)) / relative


@compiled
def missed(z: Any, h: Any) -> Any:
    """Put the position row's error with exact a, (H59), into MISSED; returns its size in q, (H26), and in v over h."""
    n, control, o, weights = z.i[mem.N], part(z, mem.CONTROL), part(z, mem.CONSTANTS), part(z, mem.WEIGHTS)
    steps, off = (control[mem.LAST_BUT_ONE], control[mem.LAST], h), part(z, mem.MISSED)
    first, before, q, end = part(z, mem.Q_FIRST), part(z, mem.Q_BEFORE), part(z, mem.Q), part(z, mem.END)
    for i in range(n):
        off[i] = (1 + 3 * o[mem.ALPHA] * o[mem.ALPHA]) / 2 * third_difference(steps, (first[i], before[i], q[i], end[i]))
    return weighted_rms(off, weights[:n]), weighted_rms(off, weights[n:]) * o[mem.GAMMA] / (o[mem.BETA] * abs(h))


@compiled
def answered(z: Any, lu: Any, t1: Any, counts: Any) -> Any:
    """Sizes of E_q and E_v of (H59), from MISSED and the response by the matrix in ``lu``.

    Puts E_q into ERROR, whose v stays that of the filtered error, and the change of v into CHANGE.
    """
    n, off, error, change = z.i[mem.N], part(z, mem.MISSED), part(z, mem.ERROR), part(z, mem.CHANGE)
    place, end, weights, answer = part(z, mem.PLACE), part(z, mem.END), part(z, mem.WEIGHTS), part(z, mem.ANSWER)
    if z.i[mem.C_ANSWER]:
        call(z, mem.C_ANSWER, mem.ANSWER, (address(z, mem.MISSED), address(z, mem.STEP), address(z, mem.END)))
        counts[mem.RESIDUALS] += 1
    else:
        for i in range(n):
            answer[i] = 0.0
    begin(z, z.i[2 * mem.ANSWER], 1.0)
    if z.i[mem.M] + z.i[mem.P] > 0:
        for i in range(n):
            place[1 + i], place[1 + n + i] = end[i] + off[i], end[n + i]
        levels_at(z, t1)
        put_levels(z, lu, 1.0, True)
    respond(z, lu)
    for i in range(n):
        error[i] = off[i] - change[i]
        change[i] = 0.0
    return weighted_rms(error, weights), weighted_rms(change, weights)


@compiled
def estimate(z: Any, counts: Any) -> Any:
    """Size of the attempt's error, (H26), or infinity; leaves f + r at its end in the last third of RAW."""
    n, end, number, tried = z.i[mem.N], part(z, mem.END), part(z, mem.NUMBER), part(z, mem.ATTEMPT)
    h, t1, lu = tried[mem.H_TRIED], tried[mem.T_END], int(tried[mem.SLOT])
    given = address(z, mem.X), address(z, mem.STEP), address(z, mem.CONTROL), address(z, mem.END)
    call(z, mem.C_RAW, mem.RAW, given)
    relative, size_q = weigh(z, end[:n], end[n : 2 * n])
    weights, least = part(z, mem.WEIGHTS), math.inf
    for i in range(n):
        least = min(least, weights[n + i])
    seen = EPS * size_q <= ROUNDOFF * abs(h) * least  # otherwise v inside the step is roundoff of q over h
    stored = int(number[mem.FACTOR])
    found = 0.0
    if stored >= 0 and stored != lu:  # the matrix before it: stiffness met in this very step is no filter
        found, _ = filtered(z, stored, t1, h, False)
    again, off = filtered(z, lu, t1, h, seen and z.i[mem.M] + z.i[mem.P] > 0)
    size = (found if found > again else again) / relative
    if z.i[mem.STIFF_FORCES] and math.isfinite(size):
        in_q, in_v = missed(z, h)
        if in_q > FILTERED * size * relative and max(in_q / relative, in_v) > SLIGHT:
            left, in_v = answered(z, lu, t1, counts)
            size = left / relative if left > FILTERED * size * relative else size
            off = max(off, in_v) if seen else off
    return max(size, off) if math.isfinite(size) else math.inf
