"""Accelerations and multipliers at a place by the KKT system, (H16): for the start, guesses and rows of output."""

from __future__ import annotations

import math
from typing import Any

from hhtbench.lowering.compile.loops import BoolArray, FloatMatrix
from solvers.hht.equations.formulas import EPS, FULL_RANK
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import called, compiled
from solvers.hht.loops.memory import Memory
from solvers.hht.loops.sections import (
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
from solvers.hht.step.newton import spend

MAX_ITERATIONS = 25  # quadratic convergence needs 6; the rest is for a poor guess
CONVERGED = 1e-13  # last increment relative to the unknowns


@compiled
def acceleration_level(z: Any, near: Any, counts: Any) -> Any:
    """Whether the acceleration level at PLACE determines v' and multipliers; their guess [lam, mu] begins at ``near``.

    By machine code where there is some, and in Python what that does not find: it looks closer.
    """
    if not spend(z, counts):
        return False
    n, constraints, found = z.i[mem.N], z.i[mem.M] + z.i[mem.P], part(z, mem.ACCELERATION_LEVEL)
    if z.i[mem.C_KKT] and determined(z, view(z.w, near, constraints)) > 0.0:
        x = part(z, mem.LEVEL_X)
        found[0] = 1.0
        put(found, put(found, 1, x[n:]), x[:n])
        return True
    at, guess = address(z, mem.PLACE), z.i[mem.BASE] + 8 * near
    arguments = at, at + 8, at + 8 + 8 * n, guess, guess + 8 * z.i[mem.M]
    call_python(z, mem.C_ACCELERATION, mem.ACCELERATION_LEVEL, arguments)
    return found[0] > 0.0


@compiled
def determined(z: Any, guess: Any) -> Any:
    """Least over largest pivot of the KKT matrix at PLACE, with [v', lam, mu] near the ``guess`` [lam, mu] in LEVEL_X.

    0.0 where it is singular to working precision, something is not finite, or no multipliers are found from the guess.
    """
    n, x, increment, at = z.i[mem.N], part(z, mem.LEVEL_X), part(z, mem.LEVEL_TERMS), address(z, mem.PLACE)
    linear, size = z.i[mem.LINEAR], part(z, mem.LEVEL_X).size
    for i in range(size):
        x[i] = 0.0 if linear or i < n else guess[i - n]
    for _ in range(MAX_ITERATIONS):
        call(z, mem.C_KKT, mem.LEVEL_TERMS, (at, at + 8, at + 8 + 8 * n, address(z, mem.LEVEL_X)))
        pivots = scaled_solve(z)
        if pivots == 0.0:
            return 0.0
        for i in range(size):
            x[i] -= increment[i]
        if linear or (small(increment[:n], x[:n]) and small(increment[n:size], x[n:])):
            return pivots
    return 0.0


@compiled
def small(increment: Any, x: Any) -> Any:
    """Whether the increment has converged, against the largest entry: of accelerations, or of multipliers."""
    return largest(increment) <= CONVERGED * largest(x)


@compiled
def scaled_solve(z: Any) -> Any:
    """The increment in place of the residual, after scaling rows and columns to size one; least over largest pivot, or 0.0.

    LAPACK sees the rows of the matrix as columns: it solves with the transpose of what it has factorised.
    """
    terms, scale = part(z, mem.LEVEL_TERMS), part(z, mem.LEVEL_SCALE)
    size, least, most = scale.size, math.inf, 0.0
    for j in range(size):
        scale[j] = 0.0
    for i in range(size):
        row = terms[size + i * size : size + (i + 1) * size]
        size_of_row = largest(row)
        if not 0.0 < size_of_row < math.inf:
            return 0.0
        factor = 1.0 / size_of_row
        terms[i] *= factor
        for j in range(size):
            row[j] *= factor
            scale[j] = max(scale[j], abs(row[j]))
    for j in range(size):
        if not scale[j] > 0.0:
            return 0.0
        scale[j] = 1.0 / scale[j]
    for i in range(size):
        row = terms[size + i * size : size + (i + 1) * size]
        for j in range(size):
            row[j] *= scale[j]
    right, order, pivots = (
        address(z, mem.LEVEL_TERMS),
        index_address(z, mem.LEVEL_LAPACK),
        index_address(z, mem.LEVEL_PIVOTS),
    )
    matrix, one, transposed, info = right + 8 * size, order + 8 * mem.ONE, order + 8 * mem.TRANSPOSED, order + 8 * mem.INFO
    invoke(z.i[mem.DGETRF], (order, order, matrix, order, pivots, info))
    for j in range(size):
        pivot = abs(terms[size + j * (size + 1)])
        least, most = min(least, pivot), max(most, pivot)
    if not least > FULL_RANK * EPS * most:
        return 0.0
    invoke(z.i[mem.DGETRS], (transposed, order, one, matrix, order, pivots, right, order, info))
    for j in range(size):
        terms[j] *= scale[j]
    return least / most if finite(terms[:size]) else 0.0


@called
def recover(z: Memory, rows: FloatMatrix, done: BoolArray) -> None:
    """Put the multipliers of every row of ``rows``, [t, q, v, lam, mu], in their places and mark it as ``done``.

    What is not finite, singular or does not converge is left as it is.
    """
    n = z.i[mem.N]
    for i in range(rows.shape[0]):
        row = rows[i]
        put(part(z, mem.PLACE), 0, row[: 1 + 2 * n])
        if determined(z, row[1 + 2 * n :]) > 0.0:
            done[i] = True
            indices(z, mem.COUNTED)[mem.RESIDUALS] += 1
            put(row, 1 + 2 * n, part(z, mem.LEVEL_X)[n:])


@called
def start(z: Memory) -> Any:
    """Whether the state before the first step stands in the memory: at PLACE, with the multipliers near LAM and MU.

    0 where a look by Python is needed: something is not finite or determined, or not as plainly good as START_BOUNDS ask.
    """
    n, number, place, at = z.i[mem.N], part(z, mem.NUMBER), part(z, mem.PLACE), address(z, mem.PLACE)
    checks, bounds, constraints = part(z, mem.START_CHECKS), part(z, mem.START_BOUNDS), z.i[mem.M] + z.i[mem.P]
    call(z, mem.C_FORCE, mem.FORCE, (at, at + 8, at + 8 + 8 * n))
    force = part(z, mem.FORCE)
    if not finite(force):
        return 0
    put(view(z.w, z.i[2 * mem.Q], 2 * n), 0, place[1:])
    for section in (mem.A, mem.F, mem.VDOT):
        put(part(z, section), 0, force[:n])
    put(part(z, mem.INVERSE_MASS), 0, force[n:])
    number[mem.T], number[mem.H], number[mem.KNOWN], number[mem.FACTOR] = place[0], 0.0, 0.0, -1.0
    number[mem.SIZE_Q], number[mem.SIZE_V] = largest(place[1 : 1 + n]), largest(place[1 + n :])
    checks[mem.ASYMMETRY], checks[mem.CONDITION] = judged_mass(z) if z.i[mem.VARIABLE] else (0.0, 0.0)
    checks[mem.VIOLATION], checks[mem.SPREAD] = 0.0, 1.0
    if constraints > 0:
        multipliers = view(z.w, z.i[2 * mem.LAM], constraints)
        pivots = determined(z, multipliers)
        if pivots == 0.0:
            return 0
        checks[mem.VIOLATION], checks[mem.SPREAD] = violation(z), 1.0 / pivots
        put(part(z, mem.VDOT), 0, part(z, mem.LEVEL_X)[:n])
        put(multipliers, 0, part(z, mem.LEVEL_X)[n:])
    for i in range(checks.size):
        if not checks[i] <= bounds[i]:
            return 0
    return 1


@compiled
def violation(z: Any) -> Any:
    """The largest of the constraint levels at PLACE, over its row's size and that of q or v; infinite for empty rows."""
    n, m, p, at = z.i[mem.N], z.i[mem.M], z.i[mem.P], address(z, mem.PLACE)
    call(z, mem.C_START_LEVELS, mem.START_LEVELS, (at, at + 8, at + 8 + 8 * n))
    terms, place, worst = part(z, mem.START_LEVELS), part(z, mem.PLACE), 0.0  # g, g_t, g_q, k, k_v, and the velocity level
    size_q, size_v = largest(place[1 : 1 + n]), largest(place[1 + n :])
    if not finite(terms):
        return math.inf
    for i in range(m + p):
        row = 2 * m + i * n if i < m else (2 + n) * m + p + (i - m) * n
        size = 0.0
        for j in range(n):
            size += abs(terms[row + j])
        if not size > 0.0:
            return math.inf
        worst = max(worst, abs(terms[(2 + n) * m + (1 + n) * p + i]) / (size * (size_v if size_v > 0.0 else 1.0)))
        if i < m:
            worst = max(worst, abs(terms[i]) / (size * (size_q if size_q > 0.0 else 1.0)))
    return worst


@compiled
def judged_mass(z: Any) -> Any:
    """How far the mass at PLACE is from symmetric, and a bound on its condition, its diagonal scaled to one."""
    n, at, inverse = z.i[mem.N], address(z, mem.PLACE), part(z, mem.INVERSE_MASS)
    call(z, mem.C_KKT, mem.LEVEL_TERMS, (at, at + 8, at + 8 + 8 * n, address(z, mem.LEVEL_X)))
    size, worst, total, of_inverse = part(z, mem.LEVEL_X).size, 0.0, 0.0, 0.0
    mass = part(z, mem.LEVEL_TERMS)[size:]
    for i in range(n):
        for j in range(n):
            scale = math.sqrt(abs(mass[i * (size + 1)] * mass[j * (size + 1)]))
            if not scale > 0.0:
                return math.inf, math.inf
            worst = max(worst, abs(mass[i * size + j] - mass[j * size + i]) / scale)
            total += (mass[i * size + j] / scale) ** 2
            of_inverse += (inverse[i * n + j] * scale) ** 2
    return worst, math.sqrt(total * of_inverse)
