"""Accelerations and multipliers from the KKT system, (H16), for starts, guesses and output rows.

Its matrix is full and solved by LAPACK; for large systems it is given by its entries.
"""

from __future__ import annotations

import math
from typing import Any

from hhtbench.lowering.compile.loops import BoolArray, FloatMatrix
from solvers.kernel import memory as mem
from solvers.kernel.compiled import called, compiled, inlined
from solvers.kernel.entries import by_entries, compute_entries, factor_entries, solve_entries
from solvers.kernel.linear.matrix import step_back
from solvers.kernel.memory import Memory
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
    spend,
    view,
)

MAX_ITERATIONS = 25  # quadratic convergence needs 6; a poor guess needs more
CONVERGED = 1e-13  # last increment relative to the unknowns


@compiled
def acceleration_level(z: Any, near: Any, counts: Any) -> Any:
    """Solve the acceleration level at PLACE with the guess [lam, mu] at address ``near``; True if it is determined.

    By machine code where possible, else, or if that fails, by the more thorough iteration in Python.
    """
    if not spend(z, counts):
        return False
    n, constraints, found = z.i[mem.N], z.i[mem.M] + z.i[mem.P], part(z, mem.ACCELERATION_LEVEL)
    if (z.i[mem.C_KKT] or by_entries(z)) and determined(z, view(z.w, near, constraints)) > 0.0:
        x = unknowns(z)
        found[0] = 1.0
        put(found, put(found, 1, x[n:]), x[:n])
        return True
    at, guess = address(z, mem.PLACE), z.i[mem.BASE] + 8 * near
    arguments = at, at + 8, at + 8 + 8 * n, guess, guess + 8 * z.i[mem.M]
    call_python(z, mem.C_ACCELERATION, mem.ACCELERATION_LEVEL, arguments)
    return found[0] > 0.0


@inlined
def unknowns(z: Any) -> Any:
    """View of the unknowns [v', lam, mu] (n + m + p,)."""
    return part(z, mem.X if by_entries(z) else mem.LEVEL_X)


@compiled
def determined(z: Any, guess: Any) -> Any:
    """Solve the KKT system at PLACE from the ``guess`` [lam, mu]; returns the least over the largest pivot.

    By entries it returns 1.0.  0.0 if the matrix is singular to working precision, a value is not finite, or the iteration
    does not converge.
    """
    n, x, linear, entries = z.i[mem.N], unknowns(z), z.i[mem.LINEAR], by_entries(z)
    increment = part(z, mem.INCREMENT if entries else mem.LEVEL_TERMS)
    for i in range(x.size):
        x[i] = 0.0 if linear or i < n else guess[i - n]
    for _ in range(MAX_ITERATIONS):
        pivots = newton_by_entries(z) if entries else newton(z)
        if pivots == 0.0:
            return 0.0
        if linear or (small(increment[:n], x[:n]) and small(increment[n : x.size], x[n:])):
            return pivots
    return 0.0


@compiled
def newton(z: Any) -> Any:
    """One Newton iteration; returns the least over the largest pivot, or 0.0 on failure."""
    n, x, increment, at = z.i[mem.N], part(z, mem.LEVEL_X), part(z, mem.LEVEL_TERMS), address(z, mem.PLACE)
    call(z, mem.C_KKT, mem.LEVEL_TERMS, (at, at + 8, at + 8 + 8 * n, address(z, mem.LEVEL_X)))
    pivots = scaled_factor(z)
    if pivots == 0.0 or not scaled_solve(z):
        return 0.0
    for i in range(x.size):
        x[i] -= increment[i]
    return pivots


@compiled
def newton_by_entries(z: Any) -> Any:
    """One Newton iteration by the entries of the matrix; 1.0, or 0.0 on failure."""
    compute_entries(z)
    if not (factor_entries(z, z.i[mem.SIZE]) and solve_entries(z)):
        return 0.0
    step_back(z)
    return 1.0


@compiled
def small(increment: Any, x: Any) -> Any:
    """True if the increment has converged relative to the largest entry of ``x`` (accelerations, or multipliers)."""
    return largest(increment) <= CONVERGED * largest(x)


@compiled
def scaled_factor(z: Any) -> Any:
    """Factorise the matrix in place with rows and columns scaled; returns least over largest pivot, or 0.0.

    LAPACK reads rows as columns, so later solves use the transpose.
    """
    terms, scale, of_row = part(z, mem.LEVEL_TERMS), part(z, mem.LEVEL_SCALE), part(z, mem.LEVEL_ROW_SCALE)
    size, least, most = scale.size, math.inf, 0.0
    for j in range(size):
        scale[j] = 0.0
    for i in range(size):
        row = terms[size + i * size : size + (i + 1) * size]
        size_of_row = largest(row)
        if not 0.0 < size_of_row < math.inf:
            return 0.0
        factor = of_row[i] = 1.0 / size_of_row
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
    matrix, order = address(z, mem.LEVEL_TERMS) + 8 * size, index_address(z, mem.LEVEL_LAPACK)
    pivots, info = index_address(z, mem.LEVEL_PIVOTS), order + 8 * mem.INFO
    invoke(z.i[mem.DGETRF], (order, order, matrix, order, pivots, info))
    for j in range(size):
        pivot = abs(terms[size + j * (size + 1)])
        least, most = min(least, pivot), max(most, pivot)
    return least / most if least > FULL_RANK * EPS * most else 0.0


@compiled
def scaled_solve(z: Any) -> Any:
    """Replace the residual by the increment, with the factors of :func:`scaled_factor`; True if it is finite."""
    terms, scale, of_row = part(z, mem.LEVEL_TERMS), part(z, mem.LEVEL_SCALE), part(z, mem.LEVEL_ROW_SCALE)
    size, right, order = scale.size, address(z, mem.LEVEL_TERMS), index_address(z, mem.LEVEL_LAPACK)
    one, transposed, info = order + 8 * mem.ONE, order + 8 * mem.TRANSPOSED, order + 8 * mem.INFO
    for i in range(size):
        terms[i] *= of_row[i]
    pivots = index_address(z, mem.LEVEL_PIVOTS)
    invoke(z.i[mem.DGETRS], (transposed, order, one, right + 8 * size, order, pivots, right, order, info))
    for j in range(size):
        terms[j] *= scale[j]
    return finite(terms[:size])


@called
def recover(z: Memory, rows: FloatMatrix, done: BoolArray) -> None:
    """Fill in the multipliers of each row [t, q, v, lam, mu] of ``rows`` and mark it as ``done``.

    Rows that are not finite, singular or do not converge are left as they are.
    """
    n = z.i[mem.N]
    for i in range(rows.shape[0]):
        row = rows[i]
        put(part(z, mem.PLACE), 0, row[: 1 + 2 * n])
        if determined(z, row[1 + 2 * n :]) > 0.0:
            done[i] = True
            indices(z, mem.COUNTED)[mem.RESIDUALS] += 1
            put(row, 1 + 2 * n, unknowns(z)[n:])


@called
def start(z: Memory) -> Any:
    """Build the state before the first step at PLACE, with multipliers near LAM and MU; 1 if it is plainly good.

    0 if Python must check it: a value is not finite or determined, or START_CHECKS exceed START_BOUNDS.
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
    """Largest relative violation of the constraint levels at PLACE; infinite for empty rows."""
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
    """Asymmetry of the mass at PLACE, and a bound on its condition number, with its diagonal scaled to one."""
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
            of_mass, of_its_inverse = mass[i * size + j] / scale, inverse[i * n + j] * scale
            total += of_mass * of_mass
            of_inverse += of_its_inverse * of_its_inverse
    return worst, math.sqrt(total * of_inverse)
