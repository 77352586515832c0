"""Newton's iteration for one step: one factorisation kept while it contracts, convergence judged where it counts.

The test takes increments of q1 and v1 relative to typical sizes (H15).  Increments of a and of the multipliers do
not serve: they carry roundoff of g divided by h^2 and stop shrinking near h = 1e-4 for a pendulum of metres.
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

BLINDED = 1e-8  # increments up to it are not halved: roundoff of a and lam hides whether the next is smaller
CONSTRAINT_COST = 5.0  # of a matrix, in iterations of the constraint rows alone, whose machine code evaluates no force
FORGOTTEN = 0.95  # what counts, a step later, of the cost of a step that began with a stored matrix
LEAST_RATE = 1e-3  # a first increment far too long makes the next look like contraction: no ratio counts as less
SECOND = 0.5  # what of an increment remains two later at most, if increments are taken whole, (H29)
MAX_DAMPED = 40  # increments of the retry
MAX_HALVINGS = 12  # of one damped increment: 2^-12 of a step that fails is no progress


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    margin: float = 0.01  #: of a predicted error: contraction is measured on the whole step, single rows are slower
    stagnation: float = 1e-10  #: increments over typical sizes up to which one that stops shrinking is roundoff
    stalled: float = 0.5  #: contraction of a matrix at the very iterate from which it counts as none
    other_step: float = 0.01  #: relative change of h from which a stored matrix is not used: it misjudges every increment
    refresh_rate: float = 0.02  #: contraction above which a new matrix costs less than the iterations it saves
    worst_rate: float = 0.9  #: contraction above which a fresh matrix has failed
    matrix_cost: float = 0.0  #: of a new matrix, in iterations; 0: judged by ``refresh_rate``
    remaining: float = 0.01  #: of what is allowed of a step, left in force rows under error control, (H35); 0: roundoff
    stiff: float = 10.0  #: of an increment: a larger imbalance is of stiff directions, which may have turned since
    finest: float = 1e-5  #: relative tolerance below which they go to roundoff all the same: that takes hardly more
    max_iterations: int = 15  #: with a stored matrix; a fresh one needs 2 to 4


# What is iterated: all rows to roundoff; or all rows until the force rows may stop, (H35), then the constraint rows alone.
ALL_ROWS, UNTIL_ALLOWED, CONSTRAINTS = range(3)
DONE, STALL, GO_ON, RENEW, RENEW_HERE, GIVE_UP, FORCES_DONE, ALL_AGAIN = range(8)  # after an increment


class Iteration(NamedTuple):
    """Where Newton's iteration stands."""

    rows: int  #: that are iterated
    lu: int  #: of the matrix; -1: one at the iterate is to be made
    fresh: bool  #: it was made in this step
    size: float  #: of the last increment: largest change of q1 and v1 over typical sizes, (H15)
    rate: float  #: that over the one before it, by this matrix; 0: the first
    worst: float  #: largest rate seen with this matrix: one lucky ratio is no rate
    first: float  #: size of the first increment by this matrix
    taken: int  #: increments after that
    stagnated: bool  #: one at the very iterate has not shrunk the increment already


FRESH = 2.0  # iterations with a matrix at the iterate


@compiled
def newton(z: Any, stored: Any, h: Any, counts: Any) -> Any:
    """(how it ended, place of the last matrix, its worst contraction); ``stored`` is that of the state's matrix, or -1.

    The stored matrix serves as long as it contracts; a matrix at the iterate takes its place where it does not.
    """
    i, spare = begun(z, stored, h), 1 - stored if stored >= 0 else 0
    kept = i.lu >= 0
    for taken in range(z.i[mem.MAX_ITERATIONS]):
        counts[mem.NEWTON] += 1
        renewed = i.lu < 0
        if (renewed or i.rows != CONSTRAINTS) and not spend(z, counts):
            return mem.SPENT, -1, 0.0
        if renewed:
            ended = renew(z, spare, h, counts)
            if ended != mem.CONVERGED:
                return ended, -1, 0.0
            i = Iteration(i.rows, spare, True, i.size, 0.0, 0.0, i.first, i.taken, i.stagnated)
        code = mem.C_CONSTRAINTS if i.rows == CONSTRAINTS else mem.C_RESIDUAL
        in_q, in_v = corrected(z, i.lu, code, renewed, counts)
        moved = scaled(z, in_q, in_v)
        if not math.isfinite(moved):
            if i.fresh:
                return mem.NONFINITE, -1, 0.0
            counts[mem.NONFINITES] += 1
            i = with_new_matrix(i)
            continue
        i = incremented(i, moved)
        decision = judged(z, i, counts)
        if decision == GIVE_UP:
            return mem.DIVERGED, -1, 0.0
        if decision not in (RENEW_HERE, ALL_AGAIN):
            step_back(z)
        if decision == DONE:
            part(z, mem.ATTEMPT)[mem.COST] = cost_with_kept(z, stored, i.fresh, taken + 1.0 if kept else 0.0)
            return mem.CONVERGED, i.lu, i.worst
        i = after(i, decision)
    return mem.DIVERGED, -1, 0.0


@compiled
def begun(z: Any, stored: Any, h: Any) -> Any:
    """The iteration before the first increment."""
    lu, worst = stored, 0.0
    unmeasured(z)
    rows = UNTIL_ALLOWED if z.i[mem.STOPS_EARLY] else ALL_ROWS
    if lu >= 0:
        record, o = part(z, mem.RECORD + lu), part(z, mem.CONSTANTS)
        worst = record[mem.RATE]
        slow = rows == UNTIL_ALLOWED and worst > o[mem.REFRESH_RATE]  # fewer increments than to roundoff tell less of it
        dear = record[mem.KEPT_COST] > FRESH + o[mem.MATRIX_COST] > FRESH
        if slow or dear or abs(record[mem.MADE_H] - h) > o[mem.OTHER_STEP] * abs(h):
            lu, worst = -1, 0.0
    return Iteration(rows, lu, False, math.inf, 0.0, worst, 0.0, 0, False)


@compiled
def cost_with_kept(z: Any, stored: Any, renewed: Any, taken: Any) -> Any:
    """Iterations of a step that begins with the ``stored`` matrix: those ``taken`` by this one; 0: remembered."""
    o = part(z, mem.CONSTANTS)
    if taken > 0.0:
        return taken + o[mem.MATRIX_COST] if renewed else taken
    return FORGOTTEN * part(z, mem.RECORD + stored)[mem.KEPT_COST] if stored >= 0 else 0.0


@compiled
def incremented(i: Any, size: Any) -> Any:
    """The iteration after an increment of ``size``."""
    seen = math.isfinite(i.size)  # only this step's own: the last step's may have been better
    rate = size / i.size if seen else 0.0
    worst = max(rate, i.worst, LEAST_RATE)
    return Iteration(
        i.rows, i.lu, i.fresh, size, rate, worst, i.first if seen else size, i.taken + 1 if seen else 0, i.stagnated
    )


@compiled
def after(i: Any, decision: Any) -> Any:
    """The iteration after a ``decision`` that does not end it."""
    if decision == STALL:
        return Iteration(ALL_ROWS, -1, i.fresh, i.size, 0.0, 0.0, i.first, i.taken, True)
    if decision in (RENEW, RENEW_HERE):
        return with_new_matrix(i)
    rows, size = i.rows, i.size
    if decision == FORCES_DONE:
        rows = CONSTRAINTS
    elif decision == ALL_AGAIN:
        rows, size = ALL_ROWS, math.inf
    return Iteration(rows, i.lu, i.fresh, size, i.rate, i.worst, i.first, i.taken, i.stagnated)


@compiled
def with_new_matrix(i: Any) -> Any:
    """The iteration with a matrix that is to be made: there is no rate by it yet."""
    return Iteration(i.rows, -1, i.fresh, math.inf, 0.0, 0.0, i.first, i.taken, i.stagnated)


@compiled
def judged(z: Any, i: Any, counts: Any) -> Any:
    """What follows after an increment."""
    o = part(z, mem.CONSTANTS)
    rate = i.worst if i.rate != 0.0 else 0.0
    if converged(z, i.size, rate) or (may_be_roundoff(z, i, counts) and converged(z, i.size, rate)):
        return DONE
    if i.rows == CONSTRAINTS and i.rate >= o[mem.STALLED]:
        return ALL_AGAIN
    if i.rows == UNTIL_ALLOWED and i.rate > 0.0 and force_rows_end(z, i.lu, i.worst):
        return FORCES_DONE if z.i[mem.M] + z.i[mem.P] > 0 else DONE
    if i.fresh and i.rate >= o[mem.STALLED] and is_roundoff(z, i.lu, counts):
        return DONE if i.stagnated else STALL  # the second time with a matrix at the very iterate
    if i.taken == 0:
        return GO_ON
    if i.fresh:
        return GIVE_UP if i.rate > o[mem.WORST_RATE] else GO_ON
    if not outworn(z, i):
        return GO_ON
    return RENEW if i.rate < 1.0 else RENEW_HERE


@compiled
def may_be_roundoff(z: Any, i: Any, counts: Any) -> Any:
    """Whether the increment may be roundoff, which then is measured, at most once a step: that costs an iteration."""
    shrinks = i.rate < part(z, mem.CONSTANTS)[mem.STALLED] and i.size > BLINDED
    if not z.i[mem.NOISY] or i.taken == 0 or part(z, mem.NOISE)[0] >= 0.0 or shrinks or not spend(z, counts):
        return False
    measure(z, i.lu, 0, counts)
    return True


@compiled
def outworn(z: Any, i: Any) -> Any:
    """Whether a new matrix costs less than the iterations that this one still takes."""
    o, least = part(z, mem.CONSTANTS), enough(z)
    cost = o[mem.MATRIX_COST] if i.rows != CONSTRAINTS else max(o[mem.MATRIX_COST], CONSTRAINT_COST)
    if cost > 0.0:  # told by the mean rate: single ratios alternate
        mean = (i.size / i.first) ** (1.0 / i.taken)
        return i.rate >= 1.0 or math.log(least / i.size) < cost * math.log(mean)
    return i.rate > o[mem.REFRESH_RATE] and i.size * i.rate > o[mem.MARGIN] * least  # else one more ends it


@compiled
def restarted(z: Any, stored: Any, h: Any, damped: Any, counts: Any) -> Any:
    """The same with a matrix at every iterate: whole increments while they contract, (H29), or ``damped`` ones."""
    o, spare = part(z, mem.CONSTANTS), 1 - stored if stored >= 0 else 0
    last, before, halvings = math.inf, math.inf, 0
    unmeasured(z)
    part(z, mem.ATTEMPT)[mem.COST] = 0.0
    for _ in range(MAX_DAMPED if damped else z.i[mem.MAX_ITERATIONS]):
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
        rate = moved / last if halvings == 0 else 0.0  # a halved increment tells no rate
        ends = converged(z, moved, max(rate, LEAST_RATE) if rate != 0.0 else 0.0)
        if ends or (rate >= o[mem.STALLED] and is_roundoff(z, spare, counts)):
            step_back(z)
            return mem.CONVERGED, spare, 0.0
        if damped:
            halvings = halved(z, spare, moved, counts)
            if halvings < 0:
                return -1 - halvings, -1, 0.0
        elif moved > SECOND * before:
            return mem.DIVERGED, -1, 0.0
        else:
            step_back(z)
        last, before = moved, last
    return mem.DIVERGED, -1, 0.0


@compiled
def halved(z: Any, lu: Any, moved: Any, counts: Any) -> Any:
    """How often an increment is halved until the next one is smaller; -1 less how it ended where it never is."""
    x, base, full, increment = part(z, mem.X), part(z, mem.BASE_X), part(z, mem.FULL), part(z, mem.INCREMENT)
    put(base, 0, x)
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
        if next_size < size or moved <= BLINDED:
            return halving
    return -1 - (mem.DIVERGED if math.isfinite(next_size) else mem.NONFINITE)


@compiled
def length(x: Any, count: Any) -> Any:
    """Euclidean norm of the first ``count`` entries; NaN if there is one."""
    total = 0.0
    for i in range(count):
        total += x[i] * x[i]
    return math.sqrt(total)
