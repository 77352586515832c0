"""Compiled projection of states onto both constraint levels, minimal in the norm of the mass, (H47).

For steps of explicit methods and for output rows between steps.  The linear systems are those of the acceleration level:
full, solved by LAPACK, or for large systems given by entries.
"""

from __future__ import annotations

import math
from typing import Any

from hhtbench.lowering.compile.loops import BoolArray, FloatArray, FloatMatrix
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import scaled_factor, scaled_solve
from solvers.kernel.compiled import called, compiled
from solvers.kernel.entries import add_row_sizes, by_entries, compute_entries, factor_entries, solve_entries
from solvers.kernel.memory import Memory
from solvers.kernel.numbers import TINY
from solvers.kernel.sections import address, call, finite, largest, part, put

MAX_ITERATIONS = 8  # at each level; three suffice for a state that is off by its error
SLOW = 1e-2  # contraction above which a new matrix is computed
ROUNDOFF = 1e-15  # scaled violation that cannot be made smaller
CLOSE = 1e3 * ROUNDOFF  # violation that is accepted if it no longer shrinks
STALLED = 1e-10  # relative increments below which VISIBLE replaces CLOSE, as g may have large constants
VISIBLE = 1e-8  # violation above which it is no roundoff of such g


@called
def project(z: Memory, mass: FloatArray, sizes: FloatArray, rows: FloatMatrix, done: BoolArray) -> None:
    """Project q and v of each row [t, q, v] of ``rows`` onto both levels and mark it as ``done``.

    Rows that are not finite, singular or do not converge are left as they are.
    """
    for i in range(rows.shape[0]):
        put(part(z, mem.PLACE), 0, rows[i])
        if onto_constraints(z, mass, sizes) == mem.CONVERGED:
            done[i] = True
            put(rows[i], 0, part(z, mem.PLACE))


@compiled
def onto_constraints(z: Any, mass: Any, sizes: Any) -> Any:
    """Project q and then v at PLACE, each by simplified Newton iteration; returns the ending code.

    ``mass`` (n*n,) is computed here where it varies; ``sizes`` (2n,): typical sizes of q and v, by which violations are
    measured.
    """
    if z.i[mem.M] + z.i[mem.P] == 0:
        return mem.CONVERGED
    if by_entries(z):
        compute_entries(z)
    elif z.i[mem.VARIABLE]:
        make_mass(z, mass)
    look(z)
    factored = False
    for level in range(2):
        position, last, moved, ended = level == 0, math.inf, math.inf, mem.DIVERGED
        for _ in range(MAX_ITERATIONS):
            violation = violated(z, sizes, position)
            if not violation < math.inf:
                return mem.NONFINITE
            room = VISIBLE if moved <= STALLED else CLOSE
            if violation <= ROUNDOFF or last / 2 <= violation <= room:
                ended = mem.CONVERGED
                break
            if not factored or violation > SLOW * last:
                if factored and by_entries(z):
                    compute_entries(z)
                if not factor(z, mass, position):
                    return mem.SINGULAR
                factored = True
            moved = move(z, position)
            if not moved < math.inf:
                return mem.SINGULAR
            look(z)
            last = violation
        if ended != mem.CONVERGED and not violated(z, sizes, position) <= CLOSE:
            return mem.DIVERGED
        factored = factored and z.i[mem.P] == 0  # velocity constraints bind v only
    return mem.CONVERGED


@compiled
def make_mass(z: Any, mass: Any) -> None:
    """Put M at PLACE into ``mass`` (n*n,), as a block of the acceleration level's matrix."""
    n, size, at = z.i[mem.N], part(z, mem.LEVEL_X).size, address(z, mem.PLACE)
    call(z, mem.C_KKT, mem.LEVEL_TERMS, (at, at + 8, at + 8 + 8 * n, address(z, mem.LEVEL_X)))
    for i in range(n):
        put(mass, i * n, part(z, mem.LEVEL_TERMS)[size + i * size : size + i * size + n])


@compiled
def look(z: Any) -> None:
    """Evaluate the constraint levels at PLACE: into START_LEVELS with Jacobians, or by entries into LEVELS without."""
    n, at = z.i[mem.N], address(z, mem.PLACE)
    if by_entries(z):
        call(z, mem.C_LEVELS, mem.LEVELS, (at, at + 8, at + 8 + 8 * n))
    else:
        call(z, mem.C_START_LEVELS, mem.START_LEVELS, (at, at + 8, at + 8 + 8 * n))


@compiled
def value(z: Any, i: Any, position: Any) -> Any:
    """Row ``i`` of g, or of [g_t + g_q v; k], from the last :func:`look`."""
    n, m, p = z.i[mem.N], z.i[mem.M], z.i[mem.P]
    if by_entries(z):
        return part(z, mem.LEVELS)[i if position else m + i]
    return part(z, mem.START_LEVELS)[i if position else (2 + n) * m + (1 + n) * p + i]


@compiled
def violated(z: Any, sizes: Any, position: Any) -> Any:
    """Largest relative violation of a level; infinite if a value is not finite."""
    n, m, p, rows, worst = z.i[mem.N], z.i[mem.M], z.i[mem.P], part(z, mem.ROW_SIZES), 0.0
    typical = sizes[:n] if position else sizes[n:]
    for i in range(m + p):
        rows[i] = 0.0
    if by_entries(z):
        add_row_sizes(z, typical)
    else:
        terms = part(z, mem.START_LEVELS)
        if not finite(terms):
            return math.inf
        for i in range(m if position else m + p):
            first = jacobian_row(z, i)
            rows[i] = abs(terms[m + i]) if i < m and not position else 0.0
            for j in range(n):
                rows[i] += abs(terms[first + j]) * typical[j]
    for i in range(m if position else m + p):
        off = abs(value(z, i, position)) / (rows[i] if rows[i] > 0.0 else 1.0)
        if not off < math.inf:
            return math.inf
        worst = max(worst, off)
    return worst


@compiled
def jacobian_row(z: Any, i: Any) -> Any:
    """Start of row ``i`` of [g_q; k_v] in START_LEVELS, whose layout is g, g_t, g_q, k, k_v, velocity level."""
    n, m, p = z.i[mem.N], z.i[mem.M], z.i[mem.P]
    return 2 * m + i * n if i < m else (2 + n) * m + p + (i - m) * n


@compiled
def factor(z: Any, mass: Any, position: Any) -> Any:
    """Factorise [[M, C^T], [C, 0]] at PLACE with the rows C of one level; False if they are dependent."""
    n, m, p, terms, levels = z.i[mem.N], z.i[mem.M], z.i[mem.P], part(z, mem.LEVEL_TERMS), part(z, mem.START_LEVELS)
    size = n + m + p
    if by_entries(z):
        return factor_entries(z, n + m if position else size)
    for i in range(size, size * (1 + size)):
        terms[i] = 0.0
    for i in range(n):
        put(terms, size + i * size, mass[i * n : (i + 1) * n])
    for i in range(m + p):
        row, column = size + (n + i) * size, size + n + i
        if position and i >= m:
            terms[row + n + i] = 1.0  # velocity constraints do not bind q
            continue
        first = jacobian_row(z, i)
        put(terms, row, levels[first : first + n])
        for j in range(n):
            terms[column + j * size] = levels[first + j]
    return scaled_factor(z) > 0.0


@compiled
def move(z: Any, position: Any) -> Any:
    """Subtract from q, or v, at PLACE the smallest change that corrects a level, (H47); returns its relative size.

    Infinity if it is not finite.
    """
    n, m, p, place, entries = z.i[mem.N], z.i[mem.M], z.i[mem.P], part(z, mem.PLACE), by_entries(z)
    change = part(z, mem.COMPUTED) if entries else part(z, mem.LEVEL_TERMS)
    for i in range(n + m + p):
        change[i] = value(z, i - n, position) if n <= i < n + (m if position else m + p) else 0.0
    if not (solve_entries(z) if entries else scaled_solve(z)):
        return math.inf
    found, first = part(z, mem.INCREMENT) if entries else change, 1 if position else 1 + n
    for i in range(n):
        place[first + i] -= found[i]
    return largest(found[:n]) / max(largest(place[first : first + n]), TINY)
