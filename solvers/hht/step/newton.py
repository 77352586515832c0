"""Newton's iteration for one step: one factorisation kept while it contracts, convergence judged where it counts.

The test looks at increments of q1 and v1 relative to typical sizes (H15).  Increments of a and of the multipliers do
not serve: they carry roundoff of g divided by h^2 and stop shrinking near h = 1e-4 for a pendulum of metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from solvers.hht.equations.formulas import EPS
from solvers.hht.linear.matrix import correct, early, moved_by, renew, step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import compiled, digits, has_digit
from solvers.hht.loops.sections import part, put, view
from solvers.hht.step.stopping import converged, enough_for, forces_end, levels_hold, over_allowed, scaled


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    margin: float = 0.01  #: of a predicted error: contraction is measured on the whole step, single rows are slower
    stagnation: float = 1e-10  #: below it increments that stop shrinking are roundoff, above it that is measured, (H30)
    stalled: float = 0.5  #: contraction of a matrix at the very iterate from which it counts as none
    blinded: float = 1e-8  #: increments up to it are not halved: roundoff of a and lam hides whether the next is smaller
    second: float = 0.5  #: what of an increment is left two later at most, (H29)
    other_step: float = 0.01  #: relative change of h from which a kept matrix is not used: its maps misjudge every increment
    refresh_rate: float = 0.02  #: contraction above which a new matrix costs less than the iterations it saves
    worst_rate: float = 0.9  #: contraction above which a fresh matrix has failed
    noise_margin: float = 4.0  #: times the measured roundoff: several sums take part, increments above it still shrink
    matrix_cost: float = 0.0  #: of a new matrix, in iterations; 0: judged by ``refresh_rate``
    controlled_cost: float = 2.0  #: the same where the force rows stop early, at least
    remaining: float = 0.01  #: of what is allowed of a step, left in force rows under error control, (H35); 0: roundoff
    least_rate: float = 1e-3  #: a first increment far too long makes the next look like contraction: no ratio counts as less
    max_iterations: int = 15  #: with a kept matrix; a fresh one needs 2 to 4
    max_damped: int = 40  #: for the damped restart after a failure
    max_halvings: int = 12  #: of one damped increment: 2^-12 of a step that fails is no progress


DONE, HELD, LAST_USE, STALL, GO_ON, RENEW, RENEW_HERE, GIVE_UP = range(8)  # after an increment


class Increment(NamedTuple):
    """What the last increment tells."""

    size: float  #: largest change of q1 and v1 over typical sizes, (H15)
    part: float  #: of what is allowed of the step, (H26); NaN where nothing is
    rate: float  #: that over the one before it by this matrix; 0: the first
    slowest: float  #: worst rate seen with this matrix: one lucky ratio is no rate
    first: float  #: size of the first increment by this matrix
    taken: int  #: increments after that
    fresh: bool  #: the matrix was made in this step
    stagnated: bool  #: one at the very iterate has not shrunk the increment already


# Where force rows stop early: rates that say how the next steps begin, halved from step to step.
# Down to OUTWORN with a matrix of their own, above MISLED at the plain guess with one at every iterate.
OUTWORN, MISLED, FAILED = 1.0, 8.0, 128.0

DRAWN = 2654435761, 15  # bits of products with the golden ratio: a drawing of lots that is the same everywhere


@compiled
def newton(z: Any, lagged: Any, h: Any, counts: Any) -> Any:
    """(how it ended, slot of the last matrix, its worst contraction); ``lagged`` is the slot of the state's matrix, or -1.

    The lagged matrix serves as long as it contracts; a matrix at the iterate takes its place where it does not.
    """
    o = part(z, mem.CONSTANTS)
    slot, spare = lagged, 1 - lagged if lagged >= 0 else 0
    if slot >= 0 and abs(part(z, mem.RECORD + slot)[mem.MADE_H] - h) > o[mem.OTHER_STEP] * abs(h):
        slot = -1
    if slot >= 0 and z.i[mem.STOPS_EARLY] and part(z, mem.RECORD + slot)[mem.RATE] >= OUTWORN:
        slot = -1
    worst = part(z, mem.RECORD + slot)[mem.RATE] if slot >= 0 else 0.0
    fresh = stagnated = sized = False
    last, before, first, taken, used_up, ended = math.inf, math.inf, 0.0, 0, 0.0, mem.DIVERGED
    for _ in range(z.i[mem.MAX_ITERATIONS]):
        counts[mem.NEWTON] += 1
        if not spend(z, counts):
            return mem.SPENT, -1, 0.0
        if slot < 0:
            ended = renew(z, spare, h, counts)
            if ended != mem.CONVERGED:
                return ended, -1, 0.0
            slot, worst, fresh, last = spare, 0.0, True, math.inf
        in_q, in_v = corrected(z, slot, ended == mem.CONVERGED, counts)
        ended = mem.DIVERGED
        moved = scaled(z, in_q, in_v, not sized)
        sized = math.isfinite(moved)
        if not sized:
            if fresh:
                return mem.NONFINITE, -1, 0.0
            counts[mem.NONFINITES] += 1
            slot = -1
            continue
        last, before = min(last, before), math.inf
        rate = moved / last if math.isfinite(last) else 0.0  # only this step's own: the last step's may have been better
        slowest = max(rate, worst, o[mem.LEAST_RATE])  # one lucky ratio is no rate: the worst seen counts
        taken = taken + 1 if last < math.inf else 0
        first = first if taken > 0 else moved
        allowed = over_allowed(z, slot)
        decision = judged(z, slot, Increment(moved, allowed, rate, slowest, first, taken, fresh, stagnated), counts)
        if decision == GIVE_UP:
            return mem.DIVERGED, -1, 0.0
        if decision not in (RENEW_HERE, HELD, LAST_USE):
            step_back(z)
        if decision in (DONE, HELD, LAST_USE):
            if z.i[mem.STOPS_EARLY]:
                slowest = max(min(slowest, OUTWORN), OUTWORN if decision == LAST_USE else used_up)
            return mem.CONVERGED, slot, slowest
        if decision == GO_ON:
            last = moved
            continue
        slot = -1
        if decision == STALL:
            stagnated, before = True, moved
        else:
            used_up = max(used_up, OUTWORN if decision == RENEW else MISLED)
    return mem.DIVERGED, -1, 0.0


@compiled
def judged(z: Any, slot: Any, i: Any, counts: Any) -> Any:
    """What follows after the :class:`Increment` ``i``."""
    o, enough = part(z, mem.CONSTANTS), enough_for(z, slot)
    if converged(z, slot, i.size, i.slowest if i.rate != 0.0 else 0.0):
        return DONE
    ends = i.rate > 0.0 and forces_end(z, i.part, i.slowest)
    if ends and levels_hold(z, slot, counts):
        return LAST_USE if i.taken > 0 and outworn(z, i, i.size, enough, o[mem.MATRIX_COST]) else HELD
    if i.fresh and i.rate >= o[mem.STALLED] and not i.part > 1.0 and is_roundoff(z, slot, i.size, counts):
        return DONE if i.stagnated else STALL  # with a matrix at the very iterate too: roundoff is left
    if i.taken == 0:
        return GO_ON
    if i.fresh:
        return GIVE_UP if i.rate > o[mem.WORST_RATE] else GO_ON
    if o[mem.REMAINING] < i.part < math.inf:
        renews = outworn(z, i, i.part, o[mem.REMAINING], max(o[mem.MATRIX_COST], o[mem.CONTROLLED_COST]))
    else:
        renews = outworn(z, i, i.size, enough, o[mem.MATRIX_COST])
    if not renews:
        return GO_ON
    return RENEW if i.rate < 1.0 else RENEW_HERE


@compiled
def outworn(z: Any, i: Any, size: Any, enough: Any, cost: Any) -> Any:
    """Whether a new matrix costs less than shrinking the increment ``i``, of ``size``, to ``enough`` with this one."""
    o = part(z, mem.CONSTANTS)
    if cost > 0.0:  # told by the mean rate: single ratios alternate
        mean = (i.size / i.first) ** (1.0 / i.taken)
        return i.rate >= 1.0 or math.log(enough / size) < cost * math.log(mean)
    return i.rate > o[mem.REFRESH_RATE] and size * i.rate > o[mem.MARGIN] * enough  # else one more ends it


@compiled
def restarted(z: Any, lagged: Any, h: Any, damped: Any, counts: Any) -> Any:
    """The same with a fresh matrix each time.

    By whole increments, as long as every second is half as long, (H29); or ``damped``: halved while the next is not smaller.
    """
    o, spare = part(z, mem.CONSTANTS), 1 - lagged if lagged >= 0 else 0
    last, before, halvings, allowed = math.inf, math.inf, 0, math.nan
    for k in range(z.i[mem.MAX_DAMPED] if damped else z.i[mem.MAX_ITERATIONS]):
        if not spend(z, counts):
            return mem.SPENT, -1, 0.0
        counts[mem.NEWTON] += 1
        ended = renew(z, spare, h, counts)
        if ended != mem.CONVERGED:
            return ended, -1, 0.0
        in_q, in_v = corrected(z, spare, True, counts)
        if not math.isfinite(in_q + in_v):
            return mem.NONFINITE, -1, 0.0
        moved, last_allowed = scaled(z, in_q, in_v, k == 0), allowed
        allowed = over_allowed(z, spare)
        rate = moved / last if halvings == 0 else 0.0  # a halved increment tells no rate
        ends = converged(z, spare, moved, max(rate, o[mem.LEAST_RATE]) if rate != 0.0 else 0.0)
        if ends or (rate >= o[mem.STALLED] and not allowed > 1.0 and is_roundoff(z, spare, moved, counts)):
            step_back(z)
            return mem.CONVERGED, spare, 0.0
        of_pair = 0.0 if damped else max(moved, last) / before  # the next may be as large as the last, (H29)
        if forces_end(z, max(allowed, last_allowed), of_pair) and levels_hold(z, spare, counts):
            return mem.CONVERGED, spare, 0.0
        if damped:
            halvings = halved(z, spare, moved, counts)
            if halvings < 0:
                return -1 - halvings, -1, 0.0
        elif moved > o[mem.SECOND] * before:
            return mem.DIVERGED, -1, 0.0
        else:
            step_back(z)
        last, before = moved, last
    return mem.DIVERGED, -1, 0.0


@compiled
def halved(z: Any, slot: Any, moved: Any, counts: Any) -> Any:
    """How often an increment is halved until the next one is smaller; -1 less how it ended where it never is."""
    x, base, full, increment = part(z, mem.X), part(z, mem.BASE_X), part(z, mem.FULL), part(z, mem.INCREMENT)
    put(base, 0, x)
    put(full, 0, increment)
    size, fraction, next_size = length(full, x.size), 1.0, 0.0
    for halving in range(z.i[mem.MAX_HALVINGS]):
        if not spend(z, counts):
            return -1 - mem.SPENT
        for i in range(x.size):
            x[i] = base[i] - full[i] * fraction
        fraction *= 0.5
        corrected(z, slot, False, counts)
        next_size = length(increment, x.size)
        # the natural monotonicity test, independent of how rows are scaled; at the end roundoff of a, lam blinds it
        if next_size < size or moved <= part(z, mem.CONSTANTS)[mem.BLINDED]:
            return halving
    return -1 - (mem.DIVERGED if math.isfinite(next_size) else mem.NONFINITE)


@compiled
def spend(z: Any, counts: Any) -> Any:
    """One more evaluation of the residual; False where none is left."""
    if counts[mem.RESIDUALS] >= z.i[mem.EVALUATIONS]:
        return False
    counts[mem.RESIDUALS] += 1
    return True


@compiled
def corrected(z: Any, slot: Any, evaluated: Any, counts: Any) -> Any:
    """A correction, and where roundoff is measured what that makes of one with a new matrix."""
    counts[mem.SOLVES] += 1
    in_q, in_v = correct(z, slot, evaluated)
    if evaluated and z.i[mem.NOISY] and spend(z, counts):
        counts[mem.SOLVES] += 1
        record = part(z, mem.RECORD + slot)
        record[mem.NOISE_Q], record[mem.NOISE_V] = noise(z, slot, -1, 0)
    return in_q, in_v


@compiled
def is_roundoff(z: Any, slot: Any, moved: Any, counts: Any) -> Any:
    """Whether an increment that a matrix at the iterate did not shrink is of the size that roundoff makes it, (H30)."""
    o, evaluations = part(z, mem.CONSTANTS), 2 * digits(z.i[mem.N])
    if moved <= o[mem.STAGNATION] or counts[mem.RESIDUALS] + evaluations >= z.i[mem.EVALUATIONS]:
        return moved <= o[mem.STAGNATION]
    counts[mem.RESIDUALS] += evaluations
    counts[mem.SOLVES] += evaluations
    in_q, in_v = noise(z, slot, 0, evaluations)
    return moved <= o[mem.NOISE_MARGIN] * scaled(z, in_q, in_v, False)


@compiled
def noise(z: Any, slot: Any, first: Any, end: Any) -> Any:
    """The largest that roundoff of some entries of q, v, a, f changes in the increment, by its changes of q1 and of v1.

    Looked at is one roundoff of those entries whose number has the binary digit k // 2 equal to k % 2, (H30), for every k
    from ``first`` to ``end``, or for k = -1 of those that lots are drawn for; all away from zero, since the roundoff of
    regular values is not of both signs alike.
    """
    n, state, before = z.i[mem.N], view(z.w, z.i[2 * mem.Q], 4 * z.i[mem.N]), part(z, mem.UNDISTURBED)
    increment, full, in_q, in_v = part(z, mem.INCREMENT), part(z, mem.FULL), 0.0, 0.0
    put(before, 0, state)
    put(full, 0, increment)
    for k in range(first, end):
        for i in range(state.size):
            moves = (i * DRAWN[0] >> DRAWN[1]) % 2 == 1 if k < 0 else has_digit(i % n, k // 2, k % 2)
            state[i] = before[i] * (1.0 + EPS) if moves else before[i]
        early(z)
        correct(z, slot, False)
        for i in range(part(z, mem.X).size):
            increment[i] -= full[i]
        of_q, of_v = moved_by(z, slot, increment)
        in_q, in_v = max(in_q, of_q), max(in_v, of_v)
    put(state, 0, before)
    put(increment, 0, full)
    early(z)
    return in_q, in_v


@compiled
def length(x: Any, count: Any) -> Any:
    """Euclidean norm of the first ``count`` entries; NaN if there is one."""
    total = 0.0
    for i in range(count):
        total += x[i] * x[i]
    return math.sqrt(total)
