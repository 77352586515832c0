"""States moved onto both levels of the constraints by the smallest change in the metric of the mass, (H47).

For steps of explicit methods and for rows of output between steps.  The linear systems are those of the acceleration level:
full, solved by LAPACK, or where a system is large by the entries of their matrix.
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

MOST_ITERATIONS = 8  # at each level; a state leaves the constraints by its error, so three are enough
SLOW = 1e-2  # contraction from which the matrix is made anew, of that of the first iterate the square of an error
ROUNDOFF = 1e-15  # scaled violation that cannot be made smaller
CLOSE = 1e3 * ROUNDOFF  # one that counts as none where it no longer shrinks
STALLED = 1e-10  # relative increments that stop shrinking are roundoff, of g beside constants far larger than the motion
VISIBLE = 1e-8  # violations that are not roundoff of such g


@called
def project(z: Memory, mass: FloatArray, sizes: FloatArray, rows: FloatMatrix, done: BoolArray) -> None:
    """Put q and v of every row of ``rows``, [t, q, v], onto both levels and mark it as ``done``.

    What is not finite, singular or does not converge is left as it is.
    """
    for i in range(rows.shape[0]):
        put(part(z, mem.PLACE), 0, rows[i])
        if onto_constraints(z, mass, sizes) == mem.CONVERGED:
            done[i] = True
            put(rows[i], 0, part(z, mem.PLACE))


@compiled
def onto_constraints(z: Any, mass: Any, sizes: Any) -> Any:
    """Move q and then v at PLACE onto their levels, each by Newton's iteration with one matrix as long as that contracts.

    Returns how that ended.  ``mass`` (n*n,) is made here where it varies; ``sizes`` (2n,), typical ones of q and v, measure
    what is violated.
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
        for _ in range(MOST_ITERATIONS):
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
    """M at PLACE, (n*n,): a part of the acceleration level's matrix."""
    n, size, at = z.i[mem.N], part(z, mem.LEVEL_X).size, address(z, mem.PLACE)
    call(z, mem.C_KKT, mem.LEVEL_TERMS, (at, at + 8, at + 8 + 8 * n, address(z, mem.LEVEL_X)))
    for i in range(n):
        put(mass, i * n, part(z, mem.LEVEL_TERMS)[size + i * size : size + i * size + n])


@compiled
def look(z: Any) -> None:
    """The constraint levels at PLACE, into START_LEVELS with their Jacobians, or by entries into LEVELS without."""
    n, at = z.i[mem.N], address(z, mem.PLACE)
    if by_entries(z):
        call(z, mem.C_LEVELS, mem.LEVELS, (at, at + 8, at + 8 + 8 * n))
    else:
        call(z, mem.C_START_LEVELS, mem.START_LEVELS, (at, at + 8, at + 8 + 8 * n))


@compiled
def value(z: Any, i: Any, position: Any) -> Any:
    """Row ``i`` of g, or of [g_t + g_q v; k], as :func:`look` has left them."""
    n, m, p = z.i[mem.N], z.i[mem.M], z.i[mem.P]
    if by_entries(z):
        return part(z, mem.LEVELS)[i if position else m + i]
    return part(z, mem.START_LEVELS)[i if position else (2 + n) * m + (1 + n) * p + i]


@compiled
def violated(z: Any, sizes: Any, position: Any) -> Any:
    """The largest constraint of a level over its row's size; infinite where something is not finite."""
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
    """Where row ``i`` of [g_q; k_v] begins in START_LEVELS: g, g_t, g_q, k, k_v, and the velocity level."""
    n, m, p = z.i[mem.N], z.i[mem.M], z.i[mem.P]
    return 2 * m + i * n if i < m else (2 + n) * m + p + (i - m) * n


@compiled
def factor(z: Any, mass: Any, position: Any) -> Any:
    """Factors of [[M, C^T], [C, 0]] at PLACE, C the rows of a level; False where they are dependent."""
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
    """Change q, or v, at PLACE by the x of least x^T M x that undoes a level, (H47); its largest entry over theirs.

    Infinity where it is not finite.
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
