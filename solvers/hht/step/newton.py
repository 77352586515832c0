"""Newton's iteration for one step: a factorisation is reused while it contracts; convergence is tested on q1 and v1.

The test takes increments of q1 and v1 relative to typical sizes, (H15).  Increments of a and of the multipliers are not
tested: they carry roundoff of g divided by h^2 and stop shrinking near h = 1e-4 for a pendulum of metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from solvers.hht.step.stopping import (
    converged,
    corrected,
    enough,
    force_rows_end,
    is_roundoff,
    measure,
    scaled,
    unmeasured,
)
from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.linear.matrix import renew, step_back
from solvers.kernel.sections import part, put, spend

MOST_ROUNDOFF = 1e-5  # relative increments above this are none, in the stiffest and longest chains
MIN_DAMPED = 1e-8  # smaller increments are not halved: roundoff of a and lam hides whether the next is smaller
CONSTRAINT_COST = 5.0  # of a matrix, in iterations of the constraint rows alone, whose machine code evaluates no force
COST_DECAY = 0.95  # factor per step on the remembered cost of a step that began with a stored matrix
NEXT_RATE = 0.1  # after an increment by each of two matrices: safety factor on the second's contraction, their ratio squared
NEEDLESS = 0.5  # contraction noted for a step whose first matrix would have done: the next one makes one matrix
MIN_RATE = 1e-3  # smaller ratios of increments count as this: a first one far too long feigns contraction
TWO_STEP_RATE = 0.5  # largest ratio of an increment to the one two before it for undamped iteration, (H29)
MAX_DAMPED = 40  # increments of the damped retry
MAX_HALVINGS = 12  # of one damped increment: 2^-12 of a step that fails is no progress


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    margin: float = 0.01  #: safety factor on a predicted error: single rows contract slower than the whole
    stagnation: float = 1e-10  #: increments over typical sizes up to which one that stops shrinking is roundoff
    stalled: float = 0.5  #: contraction with a fresh matrix from which the iteration counts as stalled
    other_step: float = 0.01  #: relative change of h from which a stored matrix is not used: it misjudges every increment
    refresh_rate: float = 0.02  #: contraction above which a new matrix costs less than the iterations it saves
    worst_rate: float = 0.9  #: contraction above which a fresh matrix has failed
    matrix_cost: float = 0.0  #: of a new matrix, in iterations; 0: judged by ``refresh_rate``
    remaining: float = 0.01  #: share of the step's tolerance left in force rows, (H35); 0: iterate to roundoff
    stiff: float = 10.0  #: imbalance over increment from which directions are stiff: they may have turned since
    finest: float = 1e-5  #: rtol below which force rows are iterated to roundoff: that costs hardly more
    max_iterations: int = 15  #: with a stored matrix; a fresh one needs 2 to 4


# Rows iterated: all to roundoff; or all until the force rows meet (H35), then the constraint rows alone.
ALL_ROWS, UNTIL_ALLOWED, CONSTRAINTS = range(3)
DONE, STALL, GO_ON, RENEW, RENEW_HERE, DIVERGES, FORCES_DONE, ALL_AGAIN = range(8)  # decisions after an increment


class Iteration(NamedTuple):
    """State of Newton's iteration after an increment."""

    rows: int  #: which rows are iterated: ALL_ROWS, UNTIL_ALLOWED or CONSTRAINTS
    lu: int  #: index of the factorisation; -1: factorise at the next iterate
    fresh: bool  #: the factorisation was made in this step
    size: float  #: size of the last increment: largest change of q1 and v1 over typical sizes, (H15)
    rate: float  #: ratio of the last two sizes with this matrix; 0: there is one increment only
    worst: float  #: largest rate seen with this matrix
    first: float  #: size of the first increment by this matrix
    taken: int  #: number of increments after the first
    stagnated: bool  #: a matrix at the iterate has already failed once to shrink the increment
    last_first: float  #: size of the first increment by the matrix before, of this step; infinity: none
    before: float  #: the same of the matrix before that one
    each: bool  #: a new matrix at every iterate, until one is expected to contract fast
    last: float  #: size of the last increment by the matrix before, of this step; infinity: none was taken


FRESH_ITERATIONS = 2.0  # iterations that a step with a fresh matrix takes


@compiled
def newton(z: Any, stored: Any, h: Any, counts: Any) -> Any:
    """Solve the step by Newton's iteration; (ending code, index of the last factorisation, its worst contraction).

    ``stored``: index of the state's factorisation, or -1.  It is used while it contracts, then replaced by a fresh one.
    """
    i, spare = begun(z, stored, h), 1 - stored if stored >= 0 else 0
    kept, made, needless, stalls, at_once = i.lu >= 0, 0.0, 0.0, 0.0, i.each
    put(part(z, mem.BASE_X), 0, part(z, mem.X))
    for taken in range(z.i[mem.MAX_ITERATIONS]):
        counts[mem.NEWTON] += 1
        renewed = i.lu < 0
        if (renewed or i.rows != CONSTRAINTS) and not spend(z, counts):
            return mem.SPENT, -1, 0.0
        if renewed:
            ended = renew(z, spare, h, counts)
            if ended != mem.CONVERGED:
                return ended, -1, 0.0
            made += 1.0
            i = with_matrix(i, spare)
        code = mem.C_CONSTRAINTS if i.rows == CONSTRAINTS else mem.C_RESIDUAL
        in_q, in_v = corrected(z, i.lu, code, renewed, counts)
        moved = scaled(z, in_q, in_v)
        if not math.isfinite(moved):
            if i.fresh:
                return mem.NONFINITE, -1, 0.0
            counts[mem.NONFINITES] += 1
            i = with_new_matrix(i, False)
            continue
        i = incremented(i, moved)
        if at_once and made == 2.0 and i.taken == 0 and i.rate <= NEXT_RATE * part(z, mem.CONSTANTS)[mem.REFRESH_RATE]:
            needless = 1.0  # the first would have contracted as fast
        decision = judged(z, i, counts)
        if decision == DIVERGES:
            return mem.DIVERGED, -1, 0.0
        if decision not in (RENEW_HERE, ALL_AGAIN):
            step_back(z)
        if decision == DONE:
            part(z, mem.ATTEMPT)[mem.MADE] = made - needless - stalls
            part(z, mem.ATTEMPT)[mem.COST] = cost_with_kept(z, stored, i.fresh, taken + 1.0 if kept else 0.0)
            return mem.CONVERGED, i.lu, NEEDLESS if needless > 0.0 else i.worst
        if decision == RENEW_HERE and not i.fresh and i.size > MOST_ROUNDOFF:  # the stored matrix has led away
            put(part(z, mem.X), 0, part(z, mem.BASE_X))
            without_previous(z)
        stalls += 1.0 if decision == STALL else 0.0  # the next matrix is for increments of roundoff
        i = after(i, decision)
    return mem.DIVERGED, -1, 0.0


@compiled
def begun(z: Any, stored: Any, h: Any) -> Any:
    """Initial state of the iteration: which rows to iterate and whether to use the ``stored`` factorisation."""
    lu, worst, each = stored, 0.0, False
    unmeasured(z)
    without_previous(z)
    rows = UNTIL_ALLOWED if z.i[mem.STOPS_EARLY] else ALL_ROWS
    if lu >= 0:
        record, o = part(z, mem.RECORD + lu), part(z, mem.CONSTANTS)
        worst, each = record[mem.RATE], record[mem.RATE] >= 1.0
        # fewer increments than to roundoff tell less of it
        slow = worst == NEEDLESS or (rows == UNTIL_ALLOWED and worst > o[mem.REFRESH_RATE])
        dear = record[mem.KEPT_COST] > FRESH_ITERATIONS + o[mem.MATRIX_COST] > FRESH_ITERATIONS
        if each or slow or dear or abs(record[mem.MADE_H] - h) > o[mem.OTHER_STEP] * abs(h):
            lu, worst = -1, 0.0
    return Iteration(rows, lu, False, math.inf, 0.0, worst, 0.0, 0, False, math.inf, math.inf, each, math.inf)


@compiled
def without_previous(z: Any) -> None:
    """Forget the iterate before the last: it belongs to another step, or to another guess."""
    previous = part(z, mem.PREVIOUS)
    for i in range(previous.size):
        previous[i] = 0.0


@compiled
def cost_with_kept(z: Any, stored: Any, renewed: Any, taken: Any) -> Any:
    """Cost in iterations of a step begun with the ``stored`` matrix: ``taken`` now, or if 0 the remembered one, decayed."""
    o = part(z, mem.CONSTANTS)
    if taken > 0.0:
        return taken + o[mem.MATRIX_COST] if renewed else taken
    return COST_DECAY * part(z, mem.RECORD + stored)[mem.KEPT_COST] if stored >= 0 else 0.0


@compiled
def incremented(i: Any, size: Any) -> Any:
    """State of the iteration after an increment of ``size``."""
    seen = math.isfinite(i.size)  # only this step's own: the last step's may have been better
    rate = size / (i.size if seen else i.last)  # 0 for the first
    worst = max(rate, i.worst, MIN_RATE)
    return Iteration(
        i.rows,
        i.lu,
        i.fresh,
        size,
        rate,
        worst,
        i.first if seen else size,
        i.taken + 1 if seen else 0,
        i.stagnated,
        i.last_first,
        i.before,
        i.each,
        i.last,
    )


@compiled
def after(i: Any, decision: Any) -> Any:
    """State of the iteration after a ``decision`` that continues it."""
    if decision == STALL:
        return Iteration(
            ALL_ROWS, -1, i.fresh, i.size, 0.0, 0.0, i.first, i.taken, True, i.last_first, i.before, i.each, math.inf
        )
    if decision in (RENEW, RENEW_HERE):
        return with_new_matrix(i, decision == RENEW)
    rows, size = i.rows, i.size
    if decision == FORCES_DONE:
        rows = CONSTRAINTS
    elif decision == ALL_AGAIN:
        rows, size = ALL_ROWS, math.inf
    return Iteration(
        rows, i.lu, i.fresh, size, i.rate, i.worst, i.first, i.taken, i.stagnated, i.last_first, i.before, i.each, i.last
    )


@compiled
def with_matrix(i: Any, lu: Any) -> Any:
    """State of the iteration with the new factorisation in place ``lu``."""
    return Iteration(
        i.rows, lu, True, i.size, 0.0, 0.0, i.first, i.taken, i.stagnated, i.last_first, i.before, i.each, i.last
    )


@compiled
def with_new_matrix(i: Any, taken: Any) -> Any:
    """State of the iteration that requests a new factorisation; ``taken``: where the last increment has led."""
    last_first, before = (i.first, i.last_first) if i.fresh else (math.inf, math.inf)
    last = i.size if taken else math.inf
    return Iteration(
        i.rows, -1, i.fresh, math.inf, 0.0, 0.0, i.first, i.taken, i.stagnated, last_first, before, i.each or i.fresh, last
    )


@compiled
def judged(z: Any, i: Any, counts: Any) -> Any:
    """Decide what follows an increment: one of DONE, STALL, GO_ON, RENEW, RENEW_HERE, DIVERGES, FORCES_DONE, ALL_AGAIN."""
    o = part(z, mem.CONSTANTS)
    rate = i.worst if i.rate != 0.0 else 0.0
    exact = i.taken == 0 or (i.each and i.rate <= o[mem.REFRESH_RATE])
    slow = i.fresh and i.rows != CONSTRAINTS and i.taken > 0 and i.rate > o[mem.REFRESH_RATE]
    if slow and not i.each and i.taken == 1 and i.size > MOST_ROUNDOFF:
        return RENEW_HERE  # a second increment by the first matrix may have led away
    if converged(z, i.size, rate) or (may_be_roundoff(z, i, counts) and converged(z, i.size, rate)):
        return DONE
    if i.rows == CONSTRAINTS and i.rate >= o[mem.STALLED]:
        return ALL_AGAIN
    if i.rows == UNTIL_ALLOWED and i.rate > 0.0 and force_rows_end(z, i.lu, i.worst, exact):
        return FORCES_DONE if z.i[mem.M] + z.i[mem.P] > 0 else DONE
    if i.fresh and i.rate >= o[mem.STALLED] and is_roundoff(z, i.lu, counts):
        return DONE if i.stagnated else STALL  # the second time with a matrix at the very iterate
    if i.taken == 0 and i.size > max(o[mem.WORST_RATE] * i.before, o[mem.STAGNATION]):
        return DIVERGES
    if slow and i.size > o[mem.STAGNATION]:
        return RENEW if max(i.size / MOST_ROUNDOFF, i.rate) < 1.0 else RENEW_HERE
    if i.taken == 0:
        each = i.each and i.fresh and i.rows != CONSTRAINTS and i.size > MOST_ROUNDOFF
        return RENEW if each and not 0.0 < i.rate * i.rate <= NEXT_RATE * o[mem.REFRESH_RATE] else GO_ON
    if i.fresh:
        return DIVERGES if i.rate > o[mem.WORST_RATE] else GO_ON
    if not outworn(z, i):
        return GO_ON
    return RENEW if i.rate < 1.0 else RENEW_HERE


@compiled
def may_be_roundoff(z: Any, i: Any, counts: Any) -> Any:
    """Measure the roundoff of increments if the last one may consist of it, at most once a step; True if measured."""
    known = i.size > (MIN_DAMPED if i.rate < part(z, mem.CONSTANTS)[mem.STALLED] else MOST_ROUNDOFF)
    if not z.i[mem.NOISY] or i.taken == 0 or part(z, mem.NOISE)[0] >= 0.0 or known or not spend(z, counts):
        return False
    measure(z, i.lu, 0, counts)
    return True


@compiled
def outworn(z: Any, i: Any) -> Any:
    """True if a new matrix costs less than the iterations still needed with this one."""
    o, least = part(z, mem.CONSTANTS), enough(z)
    cost = o[mem.MATRIX_COST] if i.rows != CONSTRAINTS else max(o[mem.MATRIX_COST], CONSTRAINT_COST)
    if cost > 0.0:  # by the mean rate: single ratios alternate
        mean = (i.size / i.first) ** (1.0 / i.taken)
        return i.rate >= 1.0 or math.log(least / i.size) < cost * math.log(mean)
    return i.rate > o[mem.REFRESH_RATE] and i.size * i.rate > o[mem.MARGIN] * least  # else one more ends it


@compiled
def restarted(z: Any, stored: Any, h: Any, damped: Any, counts: Any) -> Any:
    """Solve the step with a new matrix at every iterate; undamped while (H29) holds, or ``damped`` by halving."""
    o, spare = part(z, mem.CONSTANTS), 1 - stored if stored >= 0 else 0
    last, before, halvings = math.inf, math.inf, 0
    unmeasured(z)
    without_previous(z)
    part(z, mem.ATTEMPT)[mem.COST] = 0.0
    for made in range(MAX_DAMPED if damped else z.i[mem.MAX_ITERATIONS]):
        part(z, mem.ATTEMPT)[mem.MADE] = made + 1.0
        if not spend(z, counts):
            return mem.SPENT, -1, 0.0
        counts[mem.NEWTON] += 1
        ended = renew(z, spare, h, counts)
        if ended != mem.CONVERGED:
            return ended, -1, 0.0
        in_q, in_v = corrected(z, spare, mem.C_RESIDUAL, True, counts)
        if not math.isfinite(in_q + in_v):
            return mem.NONFINITE, -1, 0.0
        moved = scaled(z, in_q, in_v)
        rate = moved / last if halvings == 0 else 0.0  # a halved increment gives no rate
        ends = converged(z, moved, max(rate, MIN_RATE) if rate != 0.0 else 0.0)
        if ends or (rate >= o[mem.STALLED] and is_roundoff(z, spare, counts)):
            step_back(z)
            return mem.CONVERGED, spare, 0.0
        if damped:
            halvings = halved(z, spare, moved, counts)
            if halvings < 0:
                return -1 - halvings, -1, 0.0
        elif moved > TWO_STEP_RATE * before:
            return mem.DIVERGED, -1, 0.0
        else:
            step_back(z)
        last, before = moved, last
    return mem.DIVERGED, -1, 0.0


@compiled
def halved(z: Any, lu: Any, moved: Any, counts: Any) -> Any:
    """Halve the increment until the next one is smaller; number of halvings, or -1 - code if none helps."""
    x, base, full, increment = part(z, mem.X), part(z, mem.BASE_X), part(z, mem.FULL), part(z, mem.INCREMENT)
    put(base, 0, x)
    part(z, mem.PREVIOUS)[0] = 1.0
    put(part(z, mem.PREVIOUS), 1, x)
    put(full, 0, increment)
    size, fraction, next_size = length(full, x.size), 1.0, 0.0
    for halving in range(MAX_HALVINGS):
        if not spend(z, counts):
            return -1 - mem.SPENT
        for i in range(x.size):
            x[i] = base[i] - full[i] * fraction
        fraction *= 0.5
        corrected(z, lu, mem.C_RESIDUAL, False, counts)
        next_size = length(increment, x.size)
        # the natural monotonicity test, independent of how rows are scaled; at the end roundoff of a, lam blinds it
        if next_size < size or moved <= MIN_DAMPED:
            return halving
    return -1 - (mem.DIVERGED if math.isfinite(next_size) else mem.NONFINITE)


@compiled
def length(x: Any, count: Any) -> Any:
    """Euclidean norm of the first ``count`` entries; NaN if there is one."""
    total = 0.0
    for i in range(count):
        total += x[i] * x[i]
    return math.sqrt(total)
