"""Newton's matrix in the compiled loops: evaluated at the iterate, factorised into one of two places, solved with.

One interface for four kinds: the inverse in straight-line machine code (small systems), band LU, LAPACK's LU of the full
matrix, and a factorisation held in Python (SuperLU).
"""

from __future__ import annotations

import math
from typing import Any

from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled, inlined
from solvers.kernel.linear.band import count_pivots, factor_blocks, solve_blocks
from solvers.kernel.numbers import EPS, FULL_RANK
from solvers.kernel.sections import (
    address,
    call,
    call_python,
    finite,
    index_address,
    indices,
    invoke,
    largest,
    part,
    put,
    view,
)

# unknowns up to which a product with the inverse, in L1 cache, is faster than two triangular solves
MAX_INVERTED = 48
MIN_ROW = 1e-300  # smallest row norm whose inverse does not overflow
SOLVES_TO_INVERT = 1.5  # solves per unknown after which computing the inverse pays


@compiled
def renew(z: Any, lu: Any, h: Any, counts: Any) -> Any:
    """Evaluate and factorise the matrix at the iterate into place ``lu``; returns CONVERGED or the reason for failure."""
    counts[mem.JACOBIANS] += 1
    made, noise = part(z, mem.MADE_AT + lu), part(z, mem.NOISE)
    noise[0] = noise[1] = -1.0  # that of increments by the matrix before, perhaps of a place far away
    before = put(made, put(made, 0, part(z, mem.X)), part(z, mem.PREVIOUS))
    put(made, before, view(z.w, z.i[2 * mem.STEP], made.size - before))
    ended = inverse_at(z, lu) if z.i[mem.KIND] == mem.KIND_INVERSE else factorise(z, lu)
    counts[mem.FACTORISATIONS] += 1
    record = part(z, mem.RECORD + lu)
    record[mem.MADE_H], record[mem.INVERTED], record[mem.KEPT_COST] = h, 0.0, 0.0
    record[mem.USES] = 1.0 if z.i[mem.KIND] == mem.KIND_INVERSE else 0.0
    return ended


@compiled
def inverse_at(z: Any, lu: Any) -> Any:
    """Compute a small system's correction at the iterate, and the inverse of its matrix into ``lu``."""
    fresh, sized = part(z, mem.FRESH), z.i[mem.SIZE] + 2
    x, previous, given = address(z, mem.X), address(z, mem.PREVIOUS), address(z, mem.STEP)
    call(z, mem.C_EARLY_MATRIX, mem.EARLY_MATRIX, (x, previous, given))
    call(z, mem.C_MATRIX, mem.FRESH, (x, previous, given, address(z, mem.EARLY_MATRIX)))
    if not finite(fresh):
        return mem.SINGULAR if fresh[fresh.size - 1] < math.inf else mem.NONFINITE
    increment, inverse, maps = part(z, mem.INCREMENT), part(z, mem.INVERSE + lu), part(z, mem.MAPS + lu)
    put(increment, 0, fresh[:sized])
    put(inverse, 0, fresh[sized : sized + inverse.size])
    put(maps, 0, fresh[sized + inverse.size : sized + inverse.size + maps.size])
    return mem.CONVERGED


@compiled
def factorise(z: Any, lu: Any) -> Any:
    """Evaluate residual and matrix at the iterate and factorise into ``lu``; returns CONVERGED or the reason for failure."""
    values, computed, targets, size = part(z, mem.VALUES), part(z, mem.COMPUTED), indices(z, mem.TARGETS), z.i[mem.SIZE]
    x, previous, given = address(z, mem.X), address(z, mem.PREVIOUS), address(z, mem.STEP)
    if z.i[mem.C_EARLY_MATRIX]:
        call(z, mem.C_EARLY_MATRIX, mem.EARLY_MATRIX, (x, previous, given))
    call(z, mem.C_MATRIX, mem.COMPUTED, (x, previous, given, address(z, mem.EARLY_MATRIX)))
    if not finite(computed):
        return mem.NONFINITE
    for k in range(targets.size):
        values[targets[k]] = computed[k]
    put(part(z, mem.RESIDUAL), 0, values[:size])
    entries, maps, own = values[size:], part(z, mem.MAPS + lu), z.i[mem.OWN]
    put(maps, 0, entries[own : own + maps.size])
    return factor(z, lu, entries)


@compiled
def factor(z: Any, lu: Any, entries: Any) -> Any:
    """LU of the row-scaled matrix with these ``entries``, into ``lu``; returns CONVERGED or the reason for failure."""
    scale_rows(z, lu, entries)
    if z.i[mem.KIND] == mem.KIND_BAND:
        return factor_band(z, lu)
    return factor_dense(z, lu) if z.i[mem.KIND] == mem.KIND_DENSE else factor_outside(z, lu)


@compiled
def scale_rows(z: Any, lu: Any, entries: Any) -> None:
    """Divide each row of the matrix by its largest entry, into SCALED.

    Rows of constraints have the user's units: unscaled, pivoting would favour large rows and Newton's iteration stall with
    small ones violated (compare ``dgeequb`` of LAPACK).
    """
    starts, scales, scaled = indices(z, mem.ROW_STARTS), part(z, mem.ROW_SCALES + lu), part(z, mem.SCALED)
    for i in range(scales.size):
        most = 0.0
        for e in range(starts[i], starts[i + 1]):
            most = max(most, abs(entries[e]))
        scales[i] = 1.0 / max(most, MIN_ROW) if most > 0.0 else 1.0
        for e in range(starts[i], starts[i + 1]):
            scaled[e] = entries[e] * scales[i]


@compiled
def factor_band(z: Any, lu: Any) -> Any:
    """Factorise the diagonal blocks as bands and copy the entries that couple them."""
    storage, entries = stored(z, lu), part(z, mem.SCALED)
    blocks = indices(z, mem.BLOCKS)
    least, most = factor_blocks(storage, indices(z, mem.PIVOTS + lu), blocks)
    outside, couplings, record = indices(z, mem.OUTSIDE), part(z, mem.COUPLINGS + lu), part(z, mem.RECORD + lu)
    for k in range(outside.size):
        couplings[k] = entries[outside[k]]
    record[mem.LEAST_PIVOT], record[mem.RANK] = least, z.i[mem.SIZE] - 1  # at most, where it ended at a zero
    if least > 0.0:
        record[mem.RANK] = count_pivots(storage, blocks, FULL_RANK * EPS * most)
    return mem.CONVERGED if least > 0.0 else mem.SINGULAR


@inlined
def stored(z: Any, lu: Any) -> Any:
    """Copy the scaled matrix to where its factors will be."""
    entries = part(z, mem.SCALED)
    inside, places, storage = indices(z, mem.INSIDE), indices(z, mem.PLACES), part(z, mem.STORAGE + lu)
    for k in range(storage.size):
        storage[k] = 0.0
    for k in range(inside.size):
        storage[places[k]] = entries[inside[k]]
    return storage


@compiled
def factor_dense(z: Any, lu: Any) -> Any:
    """LAPACK's LU with partial pivoting (dgetrf) of the full matrix, column-major."""
    storage = stored(z, lu)
    order, matrix, pivots = index_address(z, mem.LAPACK), address(z, mem.STORAGE + lu), index_address(z, mem.PIVOTS + lu)
    invoke(z.i[mem.DGETRF], (order, order, matrix, order, pivots, order + 8 * mem.INFO))
    size, record, least, most, rank = z.i[mem.SIZE], part(z, mem.RECORD + lu), abs(storage[0]), 0.0, 0
    for j in range(size):
        pivot = abs(storage[j * (size + 1)])
        least, most = min(least, pivot), max(most, pivot)
    for j in range(size):
        rank += 1 if abs(storage[j * (size + 1)]) > FULL_RANK * EPS * most else 0
    record[mem.LEAST_PIVOT], record[mem.RANK] = least, rank
    return mem.CONVERGED if least > 0.0 else mem.SINGULAR


@compiled
def factor_outside(z: Any, lu: Any) -> Any:
    """Factorise in Python (SuperLU), which keeps the factors."""
    part(z, mem.LU_ASKED)[0] = lu
    call_python(z, mem.C_FACTOR, mem.FACTOR_RESULT, (address(z, mem.LU_ASKED), address(z, mem.SCALED)))
    result, record = part(z, mem.FACTOR_RESULT), part(z, mem.RECORD + lu)
    record[mem.LEAST_PIVOT], record[mem.RANK] = result[1], result[2]
    return mem.CONVERGED if result[0] > 0.0 else mem.SINGULAR


@compiled
def solve(z: Any, lu: Any, right: Any, out: Any) -> None:
    """Solve with the matrix in ``lu``: ``out`` (size,) is its inverse times ``right``."""
    kind, work, scales = z.i[mem.KIND], part(z, mem.WORK), part(z, mem.ROW_SCALES + lu)
    if kind == mem.KIND_INVERSE:
        times_inverse(z, lu, right, out)
    elif kind == mem.KIND_BAND:
        solve_blocks(z, lu, right, work, out)
    elif kind == mem.KIND_DENSE:
        for i in range(scales.size):
            work[i] = scales[i] * right[i]
        order, pivots = index_address(z, mem.LAPACK), index_address(z, mem.PIVOTS + lu)
        matrix = address(z, mem.STORAGE + lu)
        one, no, info = order + 8 * mem.ONE, order + 8 * mem.TRANSPOSED, order + 8 * mem.INFO
        invoke(z.i[mem.DGETRS], (no, order, one, matrix, order, pivots, address(z, mem.WORK), order, info))
        put(out, 0, work)
    else:
        for i in range(scales.size):
            work[i] = scales[i] * right[i]
        part(z, mem.LU_ASKED)[0] = lu
        call_python(z, mem.C_SOLVE, mem.SOLVED, (address(z, mem.LU_ASKED), address(z, mem.WORK)))
        put(out, 0, part(z, mem.SOLVED))


@compiled
def solve_often(z: Any, lu: Any, right: Any, out: Any) -> None:
    """Solve as :func:`solve`, by an explicit inverse once the factorisation has been used often enough to pay for it."""
    record, size = part(z, mem.RECORD + lu), z.i[mem.SIZE]
    record[mem.USES] += 1.0
    if size > MAX_INVERTED or z.i[mem.KIND] == mem.KIND_CALLBACK or record[mem.USES] <= SOLVES_TO_INVERT * size:
        solve(z, lu, right, out)
        return
    if record[mem.INVERTED] == 0.0:
        invert(z, lu)
    times_inverse(z, lu, right, out)


@compiled
def times_inverse(z: Any, lu: Any, right: Any, out: Any) -> None:
    """``out``: the product of the inverse in ``lu`` with ``right``."""
    columns, size = part(z, mem.INVERSE + lu), z.i[mem.SIZE]
    for i in range(size):
        out[i] = 0.0
    for j in range(size):
        factor, at = right[j], j * size
        if factor != 0.0:  # those of error estimates are zero in half of their rows
            for i in range(size):
                out[i] += columns[at + i] * factor


@compiled
def invert(z: Any, lu: Any) -> None:
    """Compute the inverse of the matrix in ``lu``, column by column."""
    right, columns, size = part(z, mem.RIGHT), part(z, mem.INVERSE + lu), z.i[mem.SIZE]
    for j in range(size):
        for i in range(size):
            right[i] = 1.0 if i == j else 0.0
        solve(z, lu, right, columns[j * size : (j + 1) * size])
    part(z, mem.RECORD + lu)[mem.INVERTED] = 1.0


@compiled
def move(z: Any, lu: Any, increment: Any) -> None:
    """Changes of q1 and v1 due to an increment of the unknowns, into CHANGE."""
    starts, columns, maps = indices(z, mem.MAP_STARTS), indices(z, mem.MAP_COLUMNS), part(z, mem.MAPS + lu)
    changes = part(z, mem.CHANGE)
    for i in range(changes.size):
        total = 0.0
        for e in range(starts[i], starts[i + 1]):
            total += maps[e] * increment[columns[e]]
        changes[i] = total


@compiled
def moved_by(z: Any, lu: Any, increment: Any) -> Any:
    """Largest changes of q1 and of v1 due to an increment; NaN if any is."""
    move(z, lu, increment)
    changes, n = part(z, mem.CHANGE), z.i[mem.N]
    in_q, in_v = largest(changes[:n]), largest(changes[n:])
    both = in_q + in_v
    return (in_q, in_v) if both == both else (both, both)


@compiled
def respond(z: Any, lu: Any) -> None:
    """Solve for the right-hand side in RIGHT: unknowns into SOLUTION, changes of q1 and v1 into CHANGE."""
    solve(z, lu, part(z, mem.RIGHT), part(z, mem.SOLUTION))
    move(z, lu, part(z, mem.SOLUTION))


@compiled
def correct(z: Any, lu: Any, code: Any, evaluated: Any) -> Any:
    """Compute the Newton correction with the matrix in ``lu`` into INCREMENT; returns its largest changes of q1 and v1.

    ``code`` computes the residual or its constraint rows alone.  ``evaluated``: the residual (of a small system the
    correction itself) is already there.  NaN if any change is.
    """
    increment = part(z, mem.INCREMENT)
    if z.i[mem.KIND] == mem.KIND_INVERSE:
        if not evaluated:
            inverse, maps = address(z, mem.INVERSE + lu), address(z, mem.MAPS + lu)
            x, given, early = address(z, mem.X), address(z, mem.STEP), address(z, mem.EARLY)
            call(z, code, mem.INCREMENT, (x, inverse, maps, given, early))
            part(z, mem.RECORD + lu)[mem.USES] += 1.0
        return increment[z.i[mem.SIZE]], increment[z.i[mem.SIZE] + 1]
    if not evaluated:
        call(z, code, mem.RESIDUAL, (address(z, mem.X), address(z, mem.STEP), address(z, mem.EARLY)))
    solve_often(z, lu, part(z, mem.RESIDUAL), increment)
    return moved_by(z, lu, increment)


@inlined
def early(z: Any) -> None:
    """Precompute the part of the residual that depends on known values only; callbacks in Python compute it each time."""
    x, given = address(z, mem.X), address(z, mem.STEP)
    if z.i[mem.KIND] == mem.KIND_INVERSE:  # x and other varying arguments are passed but not used
        call(z, mem.C_EARLY, mem.EARLY, (x, x, x, given))
    elif z.i[mem.C_EARLY]:
        call(z, mem.C_EARLY, mem.EARLY, (x, given))


@compiled
def step_back(z: Any) -> None:
    """Subtract the increment from the iterate x, which becomes the one before."""
    x, increment, previous = part(z, mem.X), part(z, mem.INCREMENT), part(z, mem.PREVIOUS)
    previous[0] = 1.0
    put(previous, 1, x)
    for i in range(x.size):
        x[i] -= increment[i]
