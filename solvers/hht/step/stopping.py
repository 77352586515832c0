"""When an increment is small enough: of all rows by (H15), under error control of the force rows by (H35)."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import EPS, NOTHING
from solvers.hht.linear.matrix import move, respond, step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import allowed, compiled, relative_part, relative_tolerance
from solvers.hht.loops.sections import address, call, largest, part, put

FINEST = 1e-3  # root of the relative tolerance, (H26): below it a step takes little more than one iteration anyway
STIFF = 10.0  # of an increment: a larger imbalance is of stiff directions, or across constraints


@compiled
def scaled(z: Any, in_q: Any, in_v: Any, first: Any) -> Any:
    """Changes of q1 and v1 over typical sizes, (H15); of what is at rest in the origin the ``first`` change is typical."""
    typical, own = part(z, mem.TYPICAL), part(z, mem.RECIPROCAL)
    if first:
        own[0] = 1.0 / (typical[0] if typical[0] > NOTHING else max(typical[0], in_q))
        own[1] = 1.0 / (typical[1] if typical[1] > NOTHING else max(typical[1], in_v))
    return max(in_q * own[0], in_v * own[1]) if math.isfinite(in_q + in_v) else math.nan


@compiled
def enough_for(z: Any, slot: Any) -> Any:
    """Increments, over typical sizes, that need not shrink further: the tolerance, or roundoff where it is larger."""
    o, record, own = part(z, mem.CONSTANTS), part(z, mem.RECORD + slot), part(z, mem.RECIPROCAL)
    if not z.i[mem.NOISY]:
        return o[mem.TOLERANCE]
    return max(o[mem.TOLERANCE], o[mem.NOISE_MARGIN] * max(record[mem.NOISE_Q] * own[0], record[mem.NOISE_V] * own[1]))


@compiled
def converged(z: Any, slot: Any, moved: Any, rate: Any) -> Any:
    """Whether the last increment, or with a margin what the contraction ``rate`` leaves of it, needs not shrink further."""
    enough, margin = enough_for(z, slot), part(z, mem.CONSTANTS)[mem.MARGIN]
    return moved <= enough or (0.0 < rate < 1.0 and moved * rate <= margin * enough * (1.0 - rate))


@compiled
def over_allowed(z: Any, slot: Any) -> Any:
    """The increment in the norm of (H26); NaN where all rows go to roundoff: with prescribed steps and fine tolerances."""
    root = part(z, mem.ATTEMPT)[mem.ROOT_TOLERANCE]
    if not z.i[mem.STOPS_EARLY] or root < FINEST:
        return math.nan
    move(z, slot, part(z, mem.INCREMENT))
    return weighted_rms(part(z, mem.CHANGE), part(z, mem.WEIGHTS)) / root


@compiled
def forces_end(z: Any, size: Any, rate: Any) -> Any:
    """Whether what contraction leaves of an increment of ``size`` (H26) is a small part of what is allowed, (H35).

    And the imbalance too; itself, where the matrix answers with far less: stiff directions may have turned since.
    """
    enough = part(z, mem.CONSTANTS)[mem.REMAINING]
    if not (0.0 < rate < 1.0 and size * rate <= enough * (1.0 - rate)):
        return False
    left = imbalance(z)
    return left <= enough or (left <= STIFF * size and left * rate <= enough * (1.0 - rate))


@compiled
def imbalance(z: Any) -> Any:
    """The accelerations left in the force rows before the last increment as changes of q1 and v1, in the norm of (H26)."""
    n, o, weights, change, h = (
        z.i[mem.N],
        part(z, mem.CONSTANTS),
        part(z, mem.WEIGHTS),
        part(z, mem.CHANGE),
        part(z, mem.STEP)[0],
    )
    rows = part(z, mem.RESIDUAL)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        rows = part(z, mem.INCREMENT)[z.i[mem.SIZE] + 2 :]
    for i in range(n):
        left = abs(rows[i])
        if z.i[mem.O_R1] >= 0:
            left = max(left, abs(rows[z.i[mem.O_R1] + i]))
        if z.i[mem.O_RK] >= 0:
            left = max(left, abs(rows[z.i[mem.O_RK] + i]))
        change[i], change[n + i] = h * h * o[mem.BETA] * left, h * o[mem.GAMMA] * left
    return weighted_rms(change, weights) / part(z, mem.ATTEMPT)[mem.ROOT_TOLERANCE]


@compiled
def levels_hold(z: Any, slot: Any, counts: Any) -> Any:
    """Whether, after the last increment, the constraint rows alone converge by (H15) with the matrix in ``slot``, (H35).

    Where they do not the iterate is as before.
    """
    n, x, before, end, place = z.i[mem.N], part(z, mem.X), part(z, mem.BASE_X), part(z, mem.END), part(z, mem.PLACE)
    put(before, 0, x)
    step_back(z)
    if z.i[mem.M] + z.i[mem.P] == 0:
        return True
    o, change, solution, last = part(z, mem.CONSTANTS), part(z, mem.CHANGE), part(z, mem.SOLUTION), math.inf
    enough = enough_for(z, slot)
    for _ in range(z.i[mem.MAX_ITERATIONS]):
        end_of(z)
        put(place, 1, end[: 2 * n])
        levels_at(z, part(z, mem.STEP)[1])
        begin(z, change[:0], 1.0)
        put_levels(z, slot, 1.0, True)
        respond(z, slot)
        counts[mem.SOLVES] += 1
        moved = scaled(z, largest(change[:n]), largest(change[n:]), False)
        rate = max(moved / last, o[mem.LEAST_RATE])
        shrinks = moved < o[mem.STALLED] * last
        ends = moved <= enough and (moved * rate <= EPS or not shrinks)
        if not ends and not shrinks:
            break
        for i in range(x.size):
            x[i] -= solution[i]
        if ends:
            return True
        last = moved
    put(x, 0, before)
    return False


@compiled
def end_of(z: Any) -> None:
    """The state after a step to the iterate, into END."""
    x, given, known = address(z, mem.X), address(z, mem.STEP), address(z, mem.EARLY)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        call(z, mem.C_END, mem.END, (x, x, x, given, known))
    else:
        call(z, mem.C_END, mem.END, (x, given, known))


@compiled
def begin(z: Any, source: Any, scale: Any) -> None:
    """A right-hand side of ``source`` (n,) over ``scale`` in the force rows, and else zero."""
    right = part(z, mem.RIGHT)
    for i in range(right.size):
        right[i] = source[i] / scale if i < source.size else 0.0


@compiled
def put_levels(z: Any, slot: Any, sign: Any, position: Any) -> None:
    """Put ``sign`` times what is in LEVELS into the constraint rows of the right-hand side."""
    right, off, h, m = part(z, mem.RIGHT), part(z, mem.LEVELS), part(z, mem.RECORD + slot)[mem.MADE_H], z.i[mem.M]
    for i in range(m):
        if position:
            right[z.i[mem.O_LAM0] + i] = sign * off[i] * (2 / (h * h))
        right[z.i[mem.O_LAM1] + i] = sign * off[m + i] / h
    for i in range(z.i[mem.P]):
        right[z.i[mem.O_MU] + i] = sign * off[2 * m + i] / h


@compiled
def levels_at(z: Any, t: Any) -> None:
    """The constraint levels at t and the q, v in PLACE."""
    part(z, mem.PLACE)[0] = t
    at = address(z, mem.PLACE)
    call(z, mem.C_LEVELS, mem.LEVELS, (at, at + 8, at + 8 + 8 * z.i[mem.N]))


@compiled
def weigh(z: Any, q1: Any, v1: Any) -> Any:
    """Put what is allowed of a step to q1, v1 into WEIGHTS; returns the root of the relative tolerance and the size of q."""
    n, q, v, number, weights = z.i[mem.N], part(z, mem.Q), part(z, mem.V), part(z, mem.NUMBER), part(z, mem.WEIGHTS)
    rtol, atol = part(z, mem.RTOL), part(z, mem.ATOL)
    of_q = of_v = math.inf
    size_q, size_v = max(number[mem.SIZE_Q], largest(q1)), max(number[mem.SIZE_V], largest(v1))
    for i in range(n):
        weights[i] = allowed(rtol[i], atol[i], q[i], q1[i])
        weights[n + i] = allowed(rtol[n + i], atol[n + i], v[i], v1[i])
        if size_q > NOTHING:
            of_q = min(of_q, relative_part(size_q, rtol[i], atol[i]))
        if size_v > NOTHING:
            of_v = min(of_v, relative_part(size_v, rtol[n + i], atol[n + i]))
    return math.sqrt(relative_tolerance(of_q, of_v)), size_q


@compiled
def weighted_rms(x: Any, weights: Any) -> Any:
    """Root mean square of x over ``weights``, as ``formulas.rms``; infinity where it is not finite."""
    total = 0.0
    for i in range(x.size):
        total += (x[i] / weights[i]) ** 2
    return math.sqrt(total / x.size) if math.isfinite(total) else math.inf
