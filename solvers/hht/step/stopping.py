"""When an increment is small enough: of all rows by (H15), under error control of the force rows by (H35).

And what roundoff makes of one, measured where it matters, (H30), with evaluations that are counted.
"""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import EPS, NOTHING, TINY
from solvers.hht.linear.matrix import correct, early, move, moved_by, step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import allowed, compiled, digits, has_digit, relative_part, relative_tolerance
from solvers.hht.loops.sections import largest, part, put, view

DRAWN = 2654435761, 15  # bits of products with the golden ratio: a random subset that is the same everywhere
WIDER = 1024.0  # roundoffs: what is smooth makes as many times as much of an increment as of one, noise does not
ORIGIN = 16.0  # roundoffs of what forces make of q in a step
AT_REST = 1e-9  # of q, that v would move it by in the run
UNLIKE = 8.0  # times what roundoff makes of increments, by the wider change: larger ones are noise


@compiled
def scaled(z: Any, in_q: Any, in_v: Any) -> Any:
    """Changes of q1 and v1 over typical sizes, (H15); of what is at rest in the origin the first change is typical."""
    typical, own = part(z, mem.TYPICAL), part(z, mem.RECIPROCAL)
    if not math.isfinite(in_q + in_v):
        return math.nan
    if own[0] == 0.0:
        own[0] = 1.0 / (typical[0] if typical[0] > NOTHING else max(typical[0], in_q))
        own[1] = 1.0 / (typical[1] if typical[1] > NOTHING else max(typical[1], in_v))
    return max(in_q * own[0], in_v * own[1])


@compiled
def enough(z: Any) -> Any:
    """Increments, over typical sizes, that need not shrink further: the tolerance, or roundoff where it is larger."""
    o, noise, own = part(z, mem.CONSTANTS), part(z, mem.NOISE), part(z, mem.RECIPROCAL)
    return max(o[mem.TOLERANCE], o[mem.NOISE_MARGIN] * max(noise[0] * own[0], noise[1] * own[1]))


@compiled
def converged(z: Any, moved: Any, rate: Any) -> Any:
    """Whether the last increment, or with a margin what the contraction ``rate`` leaves of it, needs not shrink further."""
    least, margin = enough(z), part(z, mem.CONSTANTS)[mem.MARGIN]
    return moved <= least or (0.0 < rate < 1.0 and moved * rate <= margin * least * (1.0 - rate))


@compiled
def force_rows_end(z: Any, slot: Any, rate: Any) -> Any:
    """Whether what the contraction ``rate`` leaves in the force rows is a small part of what is allowed of the step, (H35).

    Of the increment, and of the imbalance before it; of that itself, where the matrix answers with far less.
    """
    tried, change, weights, o = part(z, mem.ATTEMPT), part(z, mem.CHANGE), part(z, mem.WEIGHTS), part(z, mem.CONSTANTS)
    if not 0.0 < rate < 1.0:
        return False
    if tried[mem.ROOT_TOLERANCE] == 0.0:  # what the start allows: the step's end is not known yet
        tried[mem.ROOT_TOLERANCE], _ = weigh(z, part(z, mem.Q), part(z, mem.V))
    if z.i[mem.KIND] == mem.KIND_INVERSE:  # others know CHANGE already
        move(z, slot, part(z, mem.INCREMENT))
    enough, root = o[mem.REMAINING] * (1.0 - rate) / rate, tried[mem.ROOT_TOLERANCE]
    size = weighted_rms(change, weights) / root
    if size > enough:
        return False
    imbalance(z)
    left = weighted_rms(change, weights) / root
    return left <= o[mem.REMAINING] or (left <= enough and left <= o[mem.STIFF] * size)


@compiled
def imbalance(z: Any) -> None:
    """The accelerations left in the force rows before the last increment as changes of q1 and v1, into CHANGE."""
    n, o, change, h = z.i[mem.N], part(z, mem.CONSTANTS), part(z, mem.CHANGE), part(z, mem.STEP)[0]
    rows = part(z, mem.RESIDUAL)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        rows = part(z, mem.INCREMENT)[z.i[mem.SIZE] + 2 :]
    for i in range(n):
        left = abs(rows[i])
        if z.i[mem.O_R0] >= 0:
            left = max(left, abs(rows[z.i[mem.O_R0] + i]))
        if z.i[mem.O_R1] >= 0:
            left = max(left, abs(rows[z.i[mem.O_R1] + i]))
        if z.i[mem.O_RK] >= 0:
            left = max(left, abs(rows[z.i[mem.O_RK] + i]))
        change[i], change[n + i] = h * h * o[mem.BETA] * left, h * o[mem.GAMMA] * left


@compiled
def weigh(z: Any, q1: Any, v1: Any) -> Any:
    """Put what is allowed of a step to q1, v1 into WEIGHTS; returns the root of the relative tolerance and the size of q."""
    n, number, weights = z.i[mem.N], part(z, mem.NUMBER), part(z, mem.WEIGHTS)
    rtol, atol = part(z, mem.RTOL), part(z, mem.ATOL)
    size_q, size_v = max(number[mem.SIZE_Q], largest(q1)), max(number[mem.SIZE_V], largest(v1))
    of_q = weigh_part(rtol[:n], atol[:n], part(z, mem.Q), q1, size_q, weights[:n])
    of_v = weigh_part(rtol[n:], atol[n:], part(z, mem.V), v1, size_v, weights[n:])
    return math.sqrt(relative_tolerance(of_q, of_v)), size_q


@compiled
def weigh_part(rtol: Any, atol: Any, before: Any, after: Any, size: Any, weights: Any) -> Any:
    """Put what is allowed of q, or of v, of that ``size`` into ``weights`` (n,); returns the relative tolerance."""
    least = math.inf
    for i in range(weights.size):
        weights[i] = allowed(rtol[i], atol[i], before[i], after[i])
        if size > NOTHING:
            least = min(least, relative_part(size, rtol[i], atol[i]))
    return least


@compiled
def weighted_rms(x: Any, weights: Any) -> Any:
    """Root mean square of x over ``weights``; infinity where it is not finite."""
    total = 0.0
    for i in range(x.size):
        ratio = x[i] / weights[i]
        total += ratio * ratio  # a square by ** rounds otherwise in Python, once in a thousand
    return math.sqrt(total / x.size) if math.isfinite(total) else math.inf


@compiled
def spend(z: Any, counts: Any) -> Any:
    """One more evaluation of the residual; False where none is left."""
    if counts[mem.RESIDUALS] >= z.i[mem.EVALUATIONS]:
        return False
    counts[mem.RESIDUALS] += 1
    return True


@compiled
def corrected(z: Any, slot: Any, code: Any, evaluated: Any, counts: Any) -> Any:
    """A counted correction by ``code``."""
    counts[mem.SOLVES] += 1
    return correct(z, slot, code, evaluated)


@compiled
def is_roundoff(z: Any, slot: Any, code: Any, moved: Any, counts: Any) -> Any:
    """Whether an increment that a matrix at the iterate did not shrink is of the size that roundoff makes it, (H30).

    Of the rows that ``code`` computes.
    """
    return (
        is_unseen(z, slot)
        or moved <= part(z, mem.CONSTANTS)[mem.STAGNATION]
        or moved <= measured(z, slot, code, EPS, counts)
    )


@compiled
def is_unseen(z: Any, slot: Any) -> Any:
    """Whether v and an increment move q by less than its roundoff in the step, and v did in the run: it rests up to such."""
    number, tried = part(z, mem.NUMBER), part(z, mem.ATTEMPT)
    h, size_q = abs(tried[mem.H_TRIED]), number[mem.SIZE_Q]
    if z.i[mem.M] == 0 or number[mem.SIZE_V] * (tried[mem.ELAPSED] + h) > AT_REST * size_q:
        return False
    in_q, in_v = moved_by(z, slot, part(z, mem.INCREMENT))
    return max(in_q, max(in_v, number[mem.SIZE_V]) * h) <= ORIGIN * EPS * size_q


@compiled
def is_coarse(z: Any, slot: Any, moved: Any) -> Any:
    """Whether an increment of constrained motion is too much of q or of v to be left, be it roundoff.

    Of typical sizes, and of v itself: what forces would make of that may be far more where they cancel one another.  What
    share of them it is goes into ROUNDOFF if it is too much, and else into LEFT if none has been more.  What rests has no
    sizes to be measured by, in the origin or where nothing has moved.
    """
    number, tried, o = part(z, mem.NUMBER), part(z, mem.ATTEMPT), part(z, mem.CONSTANTS)
    if z.i[mem.M] + z.i[mem.P] == 0 or moved <= o[mem.STAGNATION]:
        return False
    _, in_v = moved_by(z, slot, part(z, mem.INCREMENT))
    h = abs(tried[mem.H_TRIED])
    if max(number[mem.SIZE_Q], h * number[mem.SIZE_V]) <= ORIGIN * EPS * h * part(z, mem.TYPICAL)[1]:
        return False  # at rest in the origin: q and v are what forces round to
    if is_unseen(z, slot):
        return False
    size_v = max(number[mem.SIZE_V], h * largest(part(z, mem.VDOT)), TINY)
    if h * size_v <= ORIGIN * EPS * number[mem.SIZE_Q]:  # it is no size: q does not see it in a step
        size_v = number[mem.SIZE_Q] / h
    share = max(moved, in_v / size_v)
    moves = moved > o[mem.COARSE] or in_v * h > o[mem.COARSE] * number[mem.SIZE_Q]  # else it may rest
    if not (moves and share > o[mem.COARSE]):
        tried[mem.LEFT] = max(tried[mem.LEFT], share)
        return False
    tried[mem.ROUNDOFF] = share
    return True


@compiled
def is_noise(z: Any, slot: Any, code: Any, moved: Any, counts: Any) -> Any:
    """Whether such an increment of constrained motion is noise of no function, or as coarse, and not roundoff."""
    if z.i[mem.M] + z.i[mem.P] == 0 or moved <= part(z, mem.CONSTANTS)[mem.STAGNATION]:
        return False
    if is_coarse(z, slot, moved):
        return True
    if is_unseen(z, slot):
        return False
    most = UNLIKE * measured(z, slot, code, WIDER * EPS, counts)
    noisy = moved > most or measured(z, slot, code, EPS, counts) > most  # it may be small by chance
    if not noisy or code == mem.C_CONSTRAINTS:
        return noisy
    corrected(z, slot, mem.C_CONSTRAINTS, False, counts)  # what their own rounding makes where they are nearly dependent
    rounding = UNLIKE * measured(z, slot, mem.C_CONSTRAINTS, EPS, counts)
    corrected(z, slot, code, False, counts)
    return moved > rounding


@compiled
def measured(z: Any, slot: Any, code: Any, change: Any, counts: Any) -> Any:
    """What increments over typical sizes have of noise, by :func:`noise` of every digit; 0 where no evaluations are left."""
    evaluations = 2 * digits(z.i[mem.N])
    if counts[mem.RESIDUALS] + evaluations >= z.i[mem.EVALUATIONS]:
        return 0.0
    counts[mem.RESIDUALS] += evaluations
    counts[mem.SOLVES] += evaluations
    in_q, in_v = noise(z, slot, code, change, 0, evaluations)
    return part(z, mem.CONSTANTS)[mem.NOISE_MARGIN] * scaled(z, in_q, in_v)


@compiled
def noise(z: Any, slot: Any, code: Any, change: Any, first: Any, end: Any) -> Any:
    """The largest that a ``change`` of some entries of q, v, a, f makes of the increment's q1 and v1, times EPS over it.

    Of the increment by the rows that ``code`` computes.  What is smooth gives the same for every change, roundoff, and what
    has noise less for larger ones, (H30).  Changed are those entries whose number has the binary digit k // 2 equal to k % 2
    for every k from ``first`` to ``end``, or for k = -1 a random subset of them; all away from zero, since the roundoff of
    regular values is not of both signs alike.
    """
    n, state, before = z.i[mem.N], view(z.w, z.i[2 * mem.Q], 4 * z.i[mem.N]), part(z, mem.UNDISTURBED)
    increment, full, in_q, in_v = part(z, mem.INCREMENT), part(z, mem.FULL), 0.0, 0.0
    put(before, 0, state)
    put(full, 0, increment)
    for k in range(first, end):
        for i in range(state.size):
            moves = (i * DRAWN[0] >> DRAWN[1]) % 2 == 1 if k < 0 else has_digit(i % n, k // 2, k % 2)
            state[i] = before[i] * (1.0 + change) if moves else before[i]
        early(z)
        correct(z, slot, code, False)
        for i in range(part(z, mem.X).size):
            increment[i] -= full[i]
        of_q, of_v = moved_by(z, slot, increment)
        in_q, in_v = max(in_q, of_q), max(in_v, of_v)
    put(state, 0, before)
    put(increment, 0, full)
    early(z)
    return in_q * (EPS / change), in_v * (EPS / change)


@compiled
def measure_once(z: Any, slot: Any, counts: Any) -> None:
    """Put what roundoff makes of increments into NOISE, by one evaluation; of noise that is much by a wider one."""
    found, o = part(z, mem.NOISE), part(z, mem.CONSTANTS)
    counts[mem.SOLVES] += 1
    found[0], found[1] = noise(z, slot, mem.C_RESIDUAL, EPS, -1, 0)
    if enough(z) > o[mem.STAGNATION] and spend(z, counts):
        counts[mem.SOLVES] += 1
        in_q, in_v = noise(z, slot, mem.C_RESIDUAL, WIDER * EPS, -1, 0)
        if enough(z) > UNLIKE * o[mem.NOISE_MARGIN] * scaled(z, in_q, in_v):
            found[0], found[1] = in_q, in_v


@compiled
def onto_constraints(z: Any, slot: Any, counts: Any) -> Any:
    """Whether the constraint rows alone, with the matrix in ``slot``, go to roundoff of their own, (H30)."""
    o, last = part(z, mem.CONSTANTS), math.inf
    for _ in range(z.i[mem.MAX_ITERATIONS]):
        counts[mem.NEWTON] += 1
        in_q, in_v = corrected(z, slot, mem.C_CONSTRAINTS, False, counts)
        moved = scaled(z, in_q, in_v)
        met, stalls = moved <= o[mem.TOLERANCE], not moved < o[mem.STALLED] * last
        if stalls and not met:
            met = is_roundoff(z, slot, mem.C_CONSTRAINTS, moved, counts)
            met = met and not is_noise(z, slot, mem.C_CONSTRAINTS, moved, counts)
        step_back(z)
        if met or stalls:
            return met
        last = moved
    return False


@compiled
def unmeasured(z: Any) -> None:
    """Neither sizes that increments are measured by are known, nor roundoff."""
    noise = part(z, mem.NOISE)
    part(z, mem.RECIPROCAL)[0] = 0.0
    noise[0] = noise[1] = -1.0
