"""Newton's matrix in compiled loops: factors or, of a small one, the inverse; corrections of the iterate by them."""

from __future__ import annotations

from typing import Any

from solvers.hht.kernels import factor_filled, solve_into
from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import compiled, inlined
from solvers.hht.native.parts import address, half, half_address, half_of_pivots, indices, part
from solvers.hht.native.tables import (
    BLOCKS,
    BUILT,
    C_EARLY,
    C_EARLY_MATRIX,
    C_MATRIX,
    C_RESIDUAL,
    COLUMNS,
    COMPUTED,
    CONVERGED,
    COUPLED,
    COUPLINGS,
    EARLY,
    EARLY_MATRIX,
    FACTOR_H,
    FACTORISATIONS,
    FRESH,
    INCREMENT,
    INSIDE,
    INVERSE_MATRIX,
    JACOBIANS,
    MAP_COLUMNS,
    MAP_STARTS,
    MAPS,
    NONFINITE,
    OUTSIDE,
    OWN,
    PLACES,
    RESIDUAL,
    RIGHT,
    ROWS,
    SINGULAR,
    SIZE,
    SLOTS,
    SMALL,
    STARTS,
    STEP,
    STORAGE,
    USES,
    VALUES,
    WORK,
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
def renew(z: Any, slot: Any, h: Any, counts: Any) -> Any:
    """The matrix at the iterate, into ``slot``, with what :func:`correct` takes; a failure's name, or CONVERGED."""
    counts[JACOBIANS] += 1
    ended = correct_afresh(z, slot, h) if z.i[SMALL] else factorise(z, slot, h)
    counts[FACTORISATIONS] += 1
    return ended


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


@inlined
def early(z: Any) -> None:
    """What every iterate's residual needs of the known values."""
    x, given = address(z, X), address(z, STEP)
    if z.i[SMALL]:  # x and what else varies are given, and not looked at
        invoke(z.i[C_EARLY], (address(z, EARLY), z.i[C_EARLY + 1], x, x, x, given))
    else:
        invoke(z.i[C_EARLY], (address(z, EARLY), z.i[C_EARLY + 1], x, given))


@compiled
def evaluate(z: Any) -> None:
    """The residual at the iterate."""
    x, given, early = address(z, X), address(z, STEP), address(z, EARLY)
    invoke(z.i[C_RESIDUAL], (address(z, RESIDUAL), z.i[C_RESIDUAL + 1], x, given, early))


@compiled
def step_back(z: Any) -> None:
    """x less the increment."""
    x, increment = part(z, X), part(z, INCREMENT)
    for i in range(x.size):
        x[i] -= increment[i]
