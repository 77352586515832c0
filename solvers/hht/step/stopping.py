"""When an increment is small enough: of all rows by (H15), under error control of the force rows by (H35).

Large systems measure what roundoff makes of one, (H30), with an evaluation that is counted.
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

DRAWS = 12  # such subsets, of increments that do not shrink
DRAWN = 2654435761, 15  # bits of products with the golden ratio: a random subset that is the same everywhere
NOISE_MARGIN = 4.0  # times the measured roundoff: several sums take part, increments above it still shrink
AT_ORIGIN = 1e-6  # of the way in a step: coordinates below it have no size of their own
ROUNDOFFS = 16.0  # of q over the step: increments of v below them cannot be told from roundoff of the positions


@compiled
def typical_sizes(h: Any, size_q: Any, size_v: Any, accelerations: Any) -> Any:
    """What is typical of q and v in a step of length ``h`` [s], for the convergence test, (H15).

    What begins in the origin has the size of its way, and what is held at rest that of the forces that hold it.
    """
    of_q, of_v = max(size_q, h * size_v, TINY), max(size_v, h * accelerations, TINY)
    return (h * of_v if of_q < AT_ORIGIN * h * of_v else of_q), of_v


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
    return max(o[mem.TOLERANCE], NOISE_MARGIN * max(noise[0] * own[0], noise[1] * own[1]))


@compiled
def converged(z: Any, moved: Any, rate: Any) -> Any:
    """Whether the last increment, or with a margin what the contraction ``rate`` leaves of it, needs not shrink further."""
    least, margin = enough(z), part(z, mem.CONSTANTS)[mem.MARGIN]
    return moved <= least or (0.0 < rate < 1.0 and moved * rate <= margin * least * (1.0 - rate))


@compiled
def force_rows_end(z: Any, lu: Any, rate: Any) -> Any:
    """Whether what the contraction ``rate`` leaves in the force rows is a small part of what is allowed of the step, (H35).

    Of the increment, and of the imbalance before it; of that itself, where the matrix answers with far less.
    """
    o = part(z, mem.CONSTANTS)
    if not 0.0 < rate < 1.0:
        return False
    enough, size = o[mem.REMAINING] * (1.0 - rate) / rate, share_of_allowed(z, lu)
    if size > enough:
        return False
    imbalance(z)
    left = weighted_rms(part(z, mem.CHANGE), part(z, mem.WEIGHTS)) / part(z, mem.ATTEMPT)[mem.ROOT_TOLERANCE]
    return left <= o[mem.REMAINING] or (left <= enough and left <= o[mem.STIFF] * size)


@compiled
def share_of_allowed(z: Any, lu: Any) -> Any:
    """The last increment of q1 and v1 over what is allowed of the step, in the norm of (H26)."""
    tried = part(z, mem.ATTEMPT)
    if tried[mem.ROOT_TOLERANCE] == 0.0:  # what the start allows: the step's end is not known yet
        tried[mem.ROOT_TOLERANCE], _ = weigh(z, part(z, mem.Q), part(z, mem.V))
    if z.i[mem.KIND] == mem.KIND_INVERSE:  # others know CHANGE already
        move(z, lu, part(z, mem.INCREMENT))
    return weighted_rms(part(z, mem.CHANGE), part(z, mem.WEIGHTS)) / tried[mem.ROOT_TOLERANCE]


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
def corrected(z: Any, lu: Any, code: Any, evaluated: Any, counts: Any) -> Any:
    """A counted correction by ``code``."""
    counts[mem.SOLVES] += 1
    return correct(z, lu, code, evaluated)


@compiled
def is_roundoff(z: Any, lu: Any, counts: Any) -> Any:
    """Whether an increment that has stopped shrinking is roundoff of q and v.

    Their sizes are those of both ends of the step, which are computed here: what rested until now has no size.
    """
    number, h, o = part(z, mem.NUMBER), abs(part(z, mem.STEP)[0]), part(z, mem.CONSTANTS)
    n, end, own = z.i[mem.N], part(z, mem.END), part(z, mem.RECIPROCAL)
    in_q, in_v = moved_by(z, lu, part(z, mem.INCREMENT))
    compute_end(z)
    size_q, size_v = typical_sizes(h, largest(end[:n]), largest(end[n : 2 * n]), largest(end[3 * n : 4 * n]))
    if not math.isfinite(size_q + size_v):
        return False
    own[0], own[1] = min(own[0], 1.0 / size_q), min(own[1], 1.0 / size_v)
    room = ROUNDOFFS * EPS * max(number[mem.SIZE_Q], size_q) / h
    if in_q * own[0] <= o[mem.STAGNATION] and in_v <= max(o[mem.STAGNATION] / own[1], room):
        return True
    noise = part(z, mem.NOISE)
    for draw in range(DRAWS):
        if spend(z, counts):
            measure(z, lu, draw, counts)
    return in_q <= NOISE_MARGIN * noise[0] and in_v <= NOISE_MARGIN * noise[1]


@compiled
def compute_end(z: Any) -> None:
    """The state after the step for the present iterate, into END."""
    x, given, known = address(z, mem.X), address(z, mem.STEP), address(z, mem.EARLY)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        call(z, mem.C_END, mem.END, (x, x, x, given, known))
    else:
        call(z, mem.C_END, mem.END, (x, given, known))


@compiled
def measure(z: Any, lu: Any, draw: Any, counts: Any) -> None:
    """Raise NOISE to what roundoff makes of increments' q1 and v1, (H30): by one evaluation with arguments changed by it.

    Changed are a random half of the entries of q, v, a, f, another for every ``draw``, all away from zero: the roundoff of
    regular values is not of both signs alike.
    """
    state, before, found = view(z.w, z.i[2 * mem.Q], 4 * z.i[mem.N]), part(z, mem.UNDISTURBED), part(z, mem.NOISE)
    increment, full = part(z, mem.INCREMENT), part(z, mem.FULL)
    counts[mem.SOLVES] += 1
    put(before, 0, state)
    put(full, 0, increment)
    for i in range(state.size):
        if (i * DRAWN[0] >> (DRAWN[1] + draw)) % 2 == 1:
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
    """Neither sizes that increments are measured by are known, nor roundoff."""
    noise = part(z, mem.NOISE)
    part(z, mem.RECIPROCAL)[0] = 0.0
    noise[0] = noise[1] = -1.0
