"""Newton's iteration of one step in a compiled loop: the algorithms of :mod:`solvers.hht.newton`.

What they cannot finish is left to the host engine, which makes that step from the same state.
"""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.laws import EPS, NOTHING
from solvers.hht.native.calls import view
from solvers.hht.native.compiled import compiled, digits, has_digit
from solvers.hht.native.matrix import correct, early, moved_by, renew, step_back
from solvers.hht.native.parts import part, put
from solvers.hht.native.tables import (
    BASE_X,
    BLINDED,
    CONSTANTS,
    CONVERGED,
    DIVERGED,
    EVALUATIONS,
    FACTOR_H,
    FULL,
    INCREMENT,
    LEAST_RATE,
    MARGIN,
    MAX_DAMPED,
    MAX_HALVINGS,
    MAX_ITERATIONS,
    NEWTON,
    NOISE_MARGIN,
    NONFINITE,
    OTHER_STEP,
    RATE,
    REFRESH_RATE,
    RESIDUALS,
    SECOND,
    SOLVES,
    SPENT,
    STAGNATION,
    STALLED,
    TOLERANCE,
    UNDISTURBED,
    WORST_RATE,
    N,
    Q,
    X,
)


@compiled
def newton(z: Any, kept: Any, h: Any, size_q: Any, size_v: Any, counts: Any) -> Any:
    """(how it ended, slot of the last matrix, its worst contraction); ``kept`` is the slot of the state's matrix, or -1."""
    o = part(z, CONSTANTS)
    slot, spare = kept, 1 - kept if kept >= 0 else 0
    if slot >= 0 and abs(part(z, FACTOR_H)[slot] - h) > o[OTHER_STEP] * abs(h):
        slot = -1
    worst = part(z, RATE)[slot] if slot >= 0 else 0.0
    fresh = stood = typical = False
    last, before, taken = math.inf, math.inf, 0
    per_q, per_v, ended = 0.0, 0.0, DIVERGED
    for _ in range(z.i[MAX_ITERATIONS]):
        counts[NEWTON] += 1
        if counts[RESIDUALS] >= z.i[EVALUATIONS]:
            return SPENT, -1, 0.0
        counts[RESIDUALS] += 1
        if slot < 0:
            ended = renew(z, spare, h, counts)
            if ended != CONVERGED:
                return ended, -1, 0.0
            slot, worst, fresh, last = spare, 0.0, True, math.inf
        counts[SOLVES] += 1
        in_q, in_v = correct(z, slot, ended == CONVERGED)
        ended = DIVERGED
        finite = math.isfinite(in_q + in_v)
        if finite and not typical:
            per_q, per_v, typical = 1.0 / size_if(size_q, in_q), 1.0 / size_if(size_v, in_v), True
        moved = max(in_q * per_q, in_v * per_v)
        if not (finite and math.isfinite(moved)):
            if fresh:
                return NONFINITE, -1, 0.0
            slot, typical = -1, False
            continue
        last, before = min(last, before), math.inf
        rate = moved / last if math.isfinite(last) else 0.0
        slowest = max(rate, worst, o[LEAST_RATE])
        if converged(moved, slowest if rate != 0.0 else 0.0, o[TOLERANCE], o[MARGIN]):
            step_back(z)
            return CONVERGED, slot, slowest
        if fresh and rate >= o[STALLED] and is_roundoff(z, slot, moved, per_q, per_v, counts):
            step_back(z)
            if stood:
                return CONVERGED, slot, slowest
            stood, slot, before = True, -1, moved
            continue
        taken = taken + 1 if last < math.inf else 0
        outworn = rate > o[REFRESH_RATE] and moved * rate > o[MARGIN] * o[TOLERANCE]
        if taken > 0 and (rate > o[WORST_RATE] if fresh else outworn):
            if fresh:
                return DIVERGED, -1, 0.0
            if rate < 1.0:
                step_back(z)
            slot = -1
            continue
        step_back(z)
        last = moved
    return DIVERGED, -1, 0.0


@compiled
def whole(z: Any, kept: Any, h: Any, size_q: Any, size_v: Any, counts: Any) -> Any:
    """The same with a fresh matrix each time and whole increments.

    :meth:`solvers.hht.newton.Iteration.solve_whole`.
    """
    spare, second = 1 - kept if kept >= 0 else 0, part(z, CONSTANTS)[SECOND]
    last, before, typical, per_q, per_v = math.inf, math.inf, False, 0.0, 0.0
    for _ in range(z.i[MAX_ITERATIONS]):
        if counts[RESIDUALS] >= z.i[EVALUATIONS]:
            return SPENT, -1, 0.0
        counts[NEWTON] += 1
        counts[RESIDUALS] += 1
        counts[SOLVES] += 1
        ended = renew(z, spare, h, counts)
        if ended != CONVERGED:
            return ended, -1, 0.0
        in_q, in_v = correct(z, spare, True)
        if not typical:
            per_q, per_v, typical = 1.0 / size_if(size_q, in_q), 1.0 / size_if(size_v, in_v), True
        moved = max(in_q * per_q, in_v * per_v)
        if is_last(z, spare, moved, moved / last, per_q, per_v, counts):
            step_back(z)
            return CONVERGED, spare, 0.0
        if not (math.isfinite(in_q + in_v) and moved <= second * before):
            return DIVERGED, -1, 0.0
        step_back(z)
        last, before = moved, last
    return DIVERGED, -1, 0.0


@compiled
def damped(z: Any, kept: Any, h: Any, size_q: Any, size_v: Any, counts: Any) -> Any:
    """The same with a fresh matrix each time and increments halved while the next one is not smaller.

    :meth:`solvers.hht.newton.Iteration.solve_damped`.
    """
    o, x, base, full, increment = part(z, CONSTANTS), part(z, X), part(z, BASE_X), part(z, FULL), part(z, INCREMENT)
    spare = 1 - kept if kept >= 0 else 0
    last, rate, typical, halved, per_q, per_v = math.inf, 0.0, False, False, 0.0, 0.0
    counts[RESIDUALS] += 1
    ended = renew(z, spare, h, counts)
    for _ in range(z.i[MAX_DAMPED]):
        if ended != CONVERGED:
            return ended, -1, 0.0
        if counts[RESIDUALS] + z.i[MAX_HALVINGS] >= z.i[EVALUATIONS]:
            return SPENT, -1, 0.0
        counts[NEWTON] += 1
        counts[SOLVES] += 1
        in_q, in_v = correct(z, spare, True)
        if not math.isfinite(in_q + in_v):
            return NONFINITE, -1, 0.0
        if not typical:
            per_q, per_v, typical = 1.0 / size_if(size_q, in_q), 1.0 / size_if(size_v, in_v), True
        moved = max(in_q * per_q, in_v * per_v)
        rate = moved / last if last < math.inf and not halved else 0.0  # a halved increment tells no rate
        if is_last(z, spare, moved, rate, per_q, per_v, counts):
            step_back(z)
            return CONVERGED, spare, 0.0
        put(base, 0, x)
        put(full, 0, increment)
        size, part_of, smaller = length(full, x.size), 1.0, False
        for halving in range(z.i[MAX_HALVINGS]):
            for i in range(x.size):
                x[i] = base[i] - full[i] * part_of
            halved, part_of = halving > 0, 0.5 * part_of
            counts[RESIDUALS] += 1
            counts[SOLVES] += 1
            correct(z, spare, False)
            # the natural monotonicity test, independent of how rows are scaled; at the end roundoff of a, lam blinds it
            if length(increment, x.size) < size or moved <= o[BLINDED]:
                smaller = True
                break
        if not smaller:
            return DIVERGED, -1, 0.0
        last = moved
        counts[RESIDUALS] += 1
        ended = renew(z, spare, h, counts)
    return DIVERGED, -1, 0.0


@compiled
def is_last(z: Any, slot: Any, moved: Any, rate: Any, per_q: Any, per_v: Any, counts: Any) -> Any:
    """:meth:`solvers.hht.newton.Iteration._is_last`."""
    o = part(z, CONSTANTS)
    if converged(moved, max(rate, o[LEAST_RATE]) if rate != 0.0 else 0.0, o[TOLERANCE], o[MARGIN]):
        return True
    return rate >= o[STALLED] and is_roundoff(z, slot, moved, per_q, per_v, counts)


@compiled
def is_roundoff(z: Any, slot: Any, moved: Any, per_q: Any, per_v: Any, counts: Any) -> Any:
    """:meth:`solvers.hht.newton.Iteration._is_roundoff`."""
    o, n = part(z, CONSTANTS), z.i[N]
    evaluations = 2 * digits(n)
    if moved <= o[STAGNATION] or counts[RESIDUALS] + evaluations >= z.i[EVALUATIONS]:
        return moved <= o[STAGNATION]
    counts[RESIDUALS] += evaluations
    counts[SOLVES] += evaluations
    noise, state, kept = 0.0, view(z.w, z.i[2 * Q], 4 * n), part(z, UNDISTURBED)
    increment, full = part(z, INCREMENT), part(z, FULL)
    put(kept, 0, state)
    put(full, 0, increment)
    for k in range(evaluations):
        for i in range(state.size):  # q, v, a, f
            state[i] = kept[i] * (1.0 + EPS) if has_digit(i % n, k // 2, k % 2) else kept[i]
        early(z)
        correct(z, slot, False)
        for i in range(part(z, X).size):
            increment[i] -= full[i]
        in_q, in_v = moved_by(z, slot, increment)
        noise = max(noise, in_q * per_q, in_v * per_v)
    put(state, 0, kept)
    put(increment, 0, full)
    early(z)
    return moved <= o[NOISE_MARGIN] * noise


@compiled
def length(x: Any, count: Any) -> Any:
    """Euclidean norm of the first ``count`` entries; NaN if there is one."""
    total = 0.0
    for i in range(count):
        total += x[i] * x[i]
    return math.sqrt(total)


@compiled
def size_if(size: Any, change: Any) -> Any:
    """A typical size, that of the first change for what is at rest in the origin."""
    return size if size > NOTHING else max(size, change)


@compiled
def converged(moved: Any, rate: Any, tolerance: Any, margin: Any) -> Any:
    """Whether the last increment, or with a margin what contraction leaves of it, is small enough."""
    return moved <= tolerance or (0.0 < rate < 1.0 and moved * rate <= margin * tolerance * (1.0 - rate))
