"""Newton's iteration of one step in a compiled loop: the algorithm of :mod:`solvers.hht.newton`, without its damped half.

What it cannot finish is left to the host engine, which makes that step from the same state.
"""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.kernels import factor_filled, solve_into
from solvers.hht.laws import NOTHING
from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import compiled
from solvers.hht.native.parts import address, half, half_address, half_of_pivots, indices, part
from solvers.hht.native.tables import (
    BLOCKS,
    BUILT,
    C_EARLY_MATRIX,
    C_MATRIX,
    C_RESIDUAL,
    COLUMNS,
    COMPUTED,
    CONSTANTS,
    CONVERGED,
    COUPLED,
    COUPLINGS,
    DIVERGED,
    EARLY,
    EARLY_MATRIX,
    EVALUATIONS,
    FACTOR_H,
    FACTORISATIONS,
    FRESH,
    INCREMENT,
    INSIDE,
    INVERSE_MATRIX,
    JACOBIANS,
    LEAST_RATE,
    MAP_COLUMNS,
    MAP_STARTS,
    MAPS,
    MARGIN,
    MAX_ITERATIONS,
    NEWTON,
    NONFINITE,
    OTHER_STEP,
    OUTSIDE,
    OWN,
    PLACES,
    RATE,
    REFRESH_RATE,
    RESIDUAL,
    RESIDUALS,
    RIGHT,
    ROWS,
    SINGULAR,
    SIZE,
    SLOTS,
    SMALL,
    SOLVES,
    SPENT,
    STAGNATION,
    STARTS,
    STEP,
    STORAGE,
    TOLERANCE,
    USES,
    VALUES,
    WORK,
    WORST_RATE,
    N,
    X,
)

INVERTED = (
    48  # unknowns up to which a product with the inverse, all of it in the nearest memory, is faster than two triangles
)

OFTEN = 1.5  # solves for an unknown whose cost beyond products with the inverse is that of making it


@compiled
def solve(z: Any, slot: Any, right: Any, out: Any) -> None:
    """``out`` (size,): the inverse of the matrix in ``slot`` times ``right``."""
    if z.i[SMALL]:
        times_inverse(z, slot, right, out)
        return
    solve_into(
        right,
        indices(z, ROWS),
        indices(z, COLUMNS),
        half(z, STORAGE, slot),
        half_of_pivots(z, slot),
        indices(z, BLOCKS),
        indices(z, STARTS),
        indices(z, COUPLED),
        half(z, COUPLINGS, slot),
        part(z, WORK),
        out,
    )


@compiled
def solve_often(z: Any, slot: Any, right: Any, out: Any) -> None:
    """The same for Newton's iteration, with an inverse once a kept matrix has served so often that it would have paid."""
    uses, size = part(z, USES), z.i[SIZE]
    uses[slot] += 1.0
    if size > INVERTED or uses[slot] <= OFTEN * size:
        solve(z, slot, right, out)
        return
    if part(z, BUILT)[slot] == 0.0:
        invert(z, slot)
    times_inverse(z, slot, right, out)


@compiled
def times_inverse(z: Any, slot: Any, right: Any, out: Any) -> None:
    """``out`` (size,): the product of the kept inverse with ``right``."""
    columns, size = half(z, INVERSE_MATRIX, slot), z.i[SIZE]
    for i in range(size):
        out[i] = 0.0
    for j in range(size):
        value, at = right[j], j * size
        for i in range(size):
            out[i] += columns[at + i] * value


@compiled
def invert(z: Any, slot: Any) -> None:
    """The inverse of the matrix in ``slot``, column by column."""
    right, columns, size = part(z, RIGHT), half(z, INVERSE_MATRIX, slot), z.i[SIZE]
    for j in range(size):
        for i in range(size):
            right[i] = 1.0 if i == j else 0.0
        solve(z, slot, right, columns[j * size : (j + 1) * size])
    part(z, BUILT)[slot] = 1.0


@compiled
def moved_by(z: Any, slot: Any, increment: Any) -> Any:
    """Largest magnitudes of an increment's change of q1 and of v1; NaN if there is one."""
    starts, columns, maps, n = indices(z, MAP_STARTS), indices(z, MAP_COLUMNS), half(z, MAPS, slot), z.i[N]
    in_q = in_v = 0.0
    for i in range(2 * n):
        total = 0.0
        for e in range(starts[i], starts[i + 1]):
            total += maps[e] * increment[columns[e]]
        size = abs(total)
        if size != size:
            return size, size
        if i < n:
            in_q = max(in_q, size)
        else:
            in_v = max(in_v, size)
    return in_q, in_v


@compiled
def correct_afresh(z: Any, slot: Any, h: Any) -> Any:
    """A small system's correction with the matrix at the iterate, kept in ``slot``; a failure's name, or CONVERGED."""
    fresh, size, early = part(z, FRESH), z.i[SIZE], address(z, EARLY_MATRIX)
    x, given = address(z, X), address(z, STEP)
    invoke(z.i[C_EARLY_MATRIX], (early, z.i[C_EARLY_MATRIX + 1], x, given))
    invoke(z.i[C_MATRIX], (address(z, FRESH), z.i[C_MATRIX + 1], x, given, early))
    total = 0.0
    for k in range(fresh.size):
        total += fresh[k] * 0.0
    if total != 0.0:  # there is a NaN or an infinity
        return SINGULAR
    increment, inverse, maps = part(z, INCREMENT), half(z, INVERSE_MATRIX, slot), half(z, MAPS, slot)
    k = size + 2
    for i in range(k):
        increment[i] = fresh[i]
    for i in range(inverse.size):
        inverse[i] = fresh[k + i]
    k += inverse.size
    for i in range(maps.size):
        maps[i] = fresh[k + i]
    part(z, FACTOR_H)[slot], part(z, USES)[slot] = h, 1.0
    return CONVERGED


@compiled
def correct(z: Any, slot: Any, evaluated: Any) -> Any:
    """The correction with the matrix in ``slot`` into INCREMENT; its largest changes of q1 and of v1, NaN if there is one.

    ``evaluated``: the residual is there, or of a small system the correction itself.
    """
    increment = part(z, INCREMENT)
    if z.i[SMALL]:
        if not evaluated:
            inverse, maps = half_address(z, INVERSE_MATRIX, slot), half_address(z, MAPS, slot)
            x, given, early = address(z, X), address(z, STEP), address(z, EARLY)
            invoke(z.i[C_RESIDUAL], (address(z, INCREMENT), z.i[C_RESIDUAL + 1], x, inverse, maps, given, early))
            part(z, USES)[slot] += 1.0
        return increment[z.i[SIZE]], increment[z.i[SIZE] + 1]
    if not evaluated:
        evaluate(z)
    solve_often(z, slot, part(z, RESIDUAL), increment)
    return moved_by(z, slot, increment)


@compiled
def factorise(z: Any, slot: Any, h: Any) -> Any:
    """Residual and factors of the matrix at the iterate, into ``slot``; a failure's name, or CONVERGED."""
    values, computed, slots, size = part(z, VALUES), part(z, COMPUTED), indices(z, SLOTS), z.i[SIZE]
    x, given, early = address(z, X), address(z, STEP), address(z, EARLY_MATRIX)
    invoke(z.i[C_EARLY_MATRIX], (early, z.i[C_EARLY_MATRIX + 1], x, given))
    invoke(z.i[C_MATRIX], (address(z, COMPUTED), z.i[C_MATRIX + 1], x, given, early))
    total = 0.0
    for k in range(slots.size):
        values[slots[k]] = computed[k]
        total += computed[k] * 0.0
    if total != 0.0:  # there is a NaN or an infinity
        return NONFINITE
    residual = part(z, RESIDUAL)
    for i in range(size):
        residual[i] = values[i]
    entries = values[size:]
    inside, places, storage = indices(z, INSIDE), indices(z, PLACES), half(z, STORAGE, slot)
    for k in range(storage.size):
        storage[k] = 0.0
    for k in range(inside.size):
        storage[places[k]] = entries[inside[k]]
    if factor_filled(storage, half_of_pivots(z, slot), indices(z, BLOCKS)) != 0:
        return SINGULAR
    outside, couplings, maps, own = indices(z, OUTSIDE), half(z, COUPLINGS, slot), half(z, MAPS, slot), z.i[OWN]
    for k in range(outside.size):
        couplings[k] = entries[outside[k]]
    for k in range(maps.size):
        maps[k] = entries[own + k]
    part(z, FACTOR_H)[slot], part(z, USES)[slot], part(z, BUILT)[slot] = h, 0.0, 0.0
    return CONVERGED


@compiled
def evaluate(z: Any) -> None:
    """The residual at the iterate."""
    x, given, early = address(z, X), address(z, STEP), address(z, EARLY)
    invoke(z.i[C_RESIDUAL], (address(z, RESIDUAL), z.i[C_RESIDUAL + 1], x, given, early))


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
            counts[JACOBIANS] += 1
            ended = correct_afresh(z, spare, h) if z.i[SMALL] else factorise(z, spare, h)
            counts[FACTORISATIONS] += 1
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
        if fresh and moved <= o[STAGNATION] and rate >= 0.5:
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
def size_if(size: Any, change: Any) -> Any:
    """A typical size, that of the first change for what is at rest in the origin."""
    return size if size > NOTHING else max(size, change)


@compiled
def converged(moved: Any, rate: Any, tolerance: Any, margin: Any) -> Any:
    """Whether the last increment, or with a margin what contraction leaves of it, is small enough."""
    return moved <= tolerance or (0.0 < rate < 1.0 and moved * rate <= margin * tolerance * (1.0 - rate))


@compiled
def step_back(z: Any) -> None:
    """x less the increment."""
    x, increment = part(z, X), part(z, INCREMENT)
    for i in range(x.size):
        x[i] -= increment[i]
