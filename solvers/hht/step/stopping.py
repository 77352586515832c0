"""Stopping tests of Newton's iteration: all rows by (H15), under error control the force rows by (H35).

For large systems the roundoff of an increment is measured by one counted evaluation, (H30).
"""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import NOTHING
from solvers.hht.sources import allowed, relative_part, relative_tolerance
from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.linear.matrix import correct, early, move, moved_by
from solvers.kernel.numbers import EPS, TINY
from solvers.kernel.sections import address, call, largest, part, put, spend, view, weighted_rms

DRAWS = 12  # random subsets by which roundoff is measured once increments stop shrinking
HASH = 2654435761, 15  # Knuth's multiplicative hash and a shift: a random subset that is the same on every machine
FAR = 1e4  # times the roundoff of one subset: more is no roundoff of any
NOISE_MARGIN = 4.0  # safety factor on the measured roundoff: increments above the product still shrink
AT_ORIGIN = 1e-6  # relative to the displacement in a step: smaller coordinates have no size of their own
ROUNDOFFS = 16.0  # increments of v below so many roundoffs of q over h are roundoff of the positions


@compiled
def typical_sizes(h: Any, size_q: Any, size_v: Any, accelerations: Any) -> Any:
    """Typical sizes of q and v in a step of length ``h`` [s], for the convergence test, (H15).

    A coordinate at the origin is measured by its displacement in the step, a velocity at rest by the forces that hold it.
    """
    of_q, of_v = max(size_q, h * size_v, TINY), max(size_v, h * accelerations, TINY)
    return (h * of_v if of_q < AT_ORIGIN * h * of_v else of_q), of_v


@compiled
def scaled(z: Any, in_q: Any, in_v: Any) -> Any:
    """Size of an increment: changes of q1 and v1 over typical sizes, (H15); at rest in the origin over the first change."""
    typical, own = part(z, mem.TYPICAL), part(z, mem.RECIPROCAL)
    if not math.isfinite(in_q + in_v):
        return math.nan
    if own[0] == 0.0:
        own[0] = 1.0 / (typical[0] if typical[0] > NOTHING else max(typical[0], in_q))
        own[1] = 1.0 / (typical[1] if typical[1] > NOTHING else max(typical[1], in_v))
    return max(in_q * own[0], in_v * own[1])


@compiled
def enough(z: Any) -> Any:
    """Size up to which an increment needs not shrink further: the tolerance, or measured roundoff if larger."""
    o, noise, own = part(z, mem.CONSTANTS), part(z, mem.NOISE), part(z, mem.RECIPROCAL)
    return max(o[mem.TOLERANCE], NOISE_MARGIN * max(noise[0] * own[0], noise[1] * own[1]))


@compiled
def converged(z: Any, moved: Any, rate: Any) -> Any:
    """True if the last increment, or the error predicted from it by the contraction ``rate``, is small enough."""
    least, margin = enough(z), part(z, mem.CONSTANTS)[mem.MARGIN]
    return moved <= least or (0.0 < rate < 1.0 and moved * rate <= margin * least * (1.0 - rate))


@compiled
def force_rows_end(z: Any, lu: Any, rate: Any, exact: Any) -> Any:
    """True if the error left in the force rows is a small part of the step's tolerance, so that they may stop, (H35).

    Tested are the predicted error of the increment and, unless it is ``exact`` (its matrix is of its place, or of one before
    it and contracts fast where each iterate has its matrix), the imbalance of forces before it; the predicted error of the
    latter is not used where it is large against the increment.
    """
    o = part(z, mem.CONSTANTS)
    if not 0.0 < rate < 1.0:
        return False
    enough, size = o[mem.REMAINING] * (1.0 - rate) / rate, share_of_allowed(z, lu)
    if exact or size > enough:
        return size <= enough
    imbalance(z)
    left = weighted_rms(part(z, mem.CHANGE), part(z, mem.WEIGHTS)) / part(z, mem.ATTEMPT)[mem.ROOT_TOLERANCE]
    return left <= o[mem.REMAINING] or (left <= enough and left <= o[mem.STIFF] * size)


@compiled
def share_of_allowed(z: Any, lu: Any) -> Any:
    """Last increment of q1 and v1 over the step's tolerance, in the norm of (H26)."""
    tried = part(z, mem.ATTEMPT)
    if tried[mem.ROOT_TOLERANCE] == 0.0:  # what the start allows: the step's end is not known yet
        tried[mem.ROOT_TOLERANCE], _ = weigh(z, part(z, mem.Q), part(z, mem.V))
    if z.i[mem.KIND] == mem.KIND_INVERSE:  # others know CHANGE already
        move(z, lu, part(z, mem.INCREMENT))
    return weighted_rms(part(z, mem.CHANGE), part(z, mem.WEIGHTS)) / tried[mem.ROOT_TOLERANCE]


@compiled
def imbalance(z: Any) -> None:
    """Put the accelerations unbalanced in the force rows, as changes of q1 and v1, into CHANGE."""
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
    """Put the tolerances of a step to q1, v1 into WEIGHTS; returns the root of the relative tolerance and the size of q."""
    n, number, weights = z.i[mem.N], part(z, mem.NUMBER), part(z, mem.WEIGHTS)
    rtol, atol = part(z, mem.RTOL), part(z, mem.ATOL)
    size_q, size_v = max(number[mem.SIZE_Q], largest(q1)), max(number[mem.SIZE_V], largest(v1))
    of_q = weigh_part(rtol[:n], atol[:n], part(z, mem.Q), q1, size_q, weights[:n])
    of_v = weigh_part(rtol[n:], atol[n:], part(z, mem.V), v1, size_v, weights[n:])
    return math.sqrt(relative_tolerance(of_q, of_v)), size_q


@compiled
def weigh_part(rtol: Any, atol: Any, before: Any, after: Any, size: Any, weights: Any) -> Any:
    """Put the tolerances of q, or of v, into ``weights`` (n,); returns the relative tolerance at that ``size``."""
    least = math.inf
    for i in range(weights.size):
        weights[i] = allowed(rtol[i], atol[i], before[i], after[i])
        if size > NOTHING:
            least = min(least, relative_part(size, rtol[i], atol[i]))
    return least


@compiled
def corrected(z: Any, lu: Any, code: Any, evaluated: Any, counts: Any) -> Any:
    """Compute a correction by the residual function ``code`` and count it."""
    counts[mem.SOLVES] += 1
    return correct(z, lu, code, evaluated)


@compiled
def is_roundoff(z: Any, lu: Any, counts: Any) -> Any:
    """True if an increment that has stopped shrinking is roundoff of q and v.

    Sizes are taken at both ends of the step, since a system at rest before it has none.
    """
    number, h, o = part(z, mem.NUMBER), abs(part(z, mem.STEP)[0]), part(z, mem.CONSTANTS)
    n, end, own = z.i[mem.N], part(z, mem.END), part(z, mem.RECIPROCAL)
    in_q, in_v = moved_by(z, lu, part(z, mem.INCREMENT))
    compute_end(z)
    size_q, size_v = typical_sizes(h, largest(end[:n]), largest(end[n : 2 * n]), largest(end[3 * n : 4 * n]))
    if not math.isfinite(size_q + size_v):
        return False
    of_q, of_v = max(1.0 / own[0], size_q), max(1.0 / own[1], size_v)  # for this test alone: the iterate may be far away
    room = ROUNDOFFS * EPS * max(number[mem.SIZE_Q], size_q) / h
    if in_q <= o[mem.STAGNATION] * of_q and in_v <= max(o[mem.STAGNATION] * of_v, room):
        return True
    noise = part(z, mem.NOISE)
    for draw in range(DRAWS):
        if spend(z, counts):
            measure(z, lu, draw, counts)
        if in_q > FAR * noise[0] and in_v > FAR * noise[1]:
            return False
    return in_q <= NOISE_MARGIN * noise[0] and in_v <= NOISE_MARGIN * noise[1]


@compiled
def compute_end(z: Any) -> None:
    """Compute the state at the end of the step from the present iterate, into END."""
    x, given, known = address(z, mem.X), address(z, mem.STEP), address(z, mem.EARLY)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        call(z, mem.C_END, mem.END, (x, x, x, given, known))
    else:
        call(z, mem.C_END, mem.END, (x, given, known))


@compiled
def measure(z: Any, lu: Any, draw: Any, counts: Any) -> None:
    """Raise NOISE to the size that roundoff gives to increments of q1 and v1, (H30), by one perturbed evaluation.

    A random half of the entries of q, v, a, f, another one for each ``draw``, is changed by eps away from zero: the
    roundoff of regular values has one sign more often than the other.
    """
    state, before, found = view(z.w, z.i[2 * mem.Q], 4 * z.i[mem.N]), part(z, mem.UNDISTURBED), part(z, mem.NOISE)
    increment, full = part(z, mem.INCREMENT), part(z, mem.FULL)
    counts[mem.SOLVES] += 1
    put(before, 0, state)
    put(full, 0, increment)
    for i in range(state.size):
        if (i * HASH[0] >> (HASH[1] + draw)) % 2 == 1:
            state[i] = before[i] * (1.0 + EPS)
    early(z)
    correct(z, lu, mem.C_RESIDUAL, False)
    for i in range(part(z, mem.X).size):
        increment[i] -= full[i]
    in_q, in_v = moved_by(z, lu, increment)
    found[0], found[1] = max(found[0], in_q), max(found[1], in_v)
    put(state, 0, before)
    put(increment, 0, full)
    early(z)


@compiled
def unmeasured(z: Any) -> None:
    """Reset the sizes that increments are measured by, and their measured roundoff."""
    noise = part(z, mem.NOISE)
    part(z, mem.RECIPROCAL)[0] = 0.0
    noise[0] = noise[1] = -1.0
