"""Accelerations and multipliers from the acceleration level, (H16) of THEORY.md: the KKT system, solved for any Q.

    M vdot - F - Q(lam) - Q_k(mu) = 0,    g_q vdot + c = 0,    k_v vdot + d = 0.

A singular M is fine where the KKT matrix is regular.  Where the reaction is nonlinear in lam, Newton's iteration
starts at the guess and so picks the root.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.dynamics.dynamics import Dynamics
from hhtbench.lowering.dynamics.kkt_rows import Acceleration, kkt_residual, kkt_terms
from hhtbench.lowering.dynamics.products import large
from hhtbench.protocol.arguments import Matrix, Vector

MAX_ITERATIONS = 25  # quadratic convergence needs 6; the rest is for a poor guess
CONVERGED = 1e-13  # last increment relative to the unknowns
STAGNATION = 1e-9  # increments that no longer shrink below this are roundoff
NARROW = 64  # diagonals up to which a band takes less time: that of a chain a third of SuperLU's


class AccelerationLevel:
    """Solver of (H16) at any point, by one compiled function for residual and matrix; sparse for large systems."""

    def __init__(self, dynamics: Dynamics, *, full: bool = False) -> None:
        """``full``: use full matrices also for large systems."""
        s = self.structure = dynamics.structure
        self._last: tuple[float, Vector, Vector, Acceleration] | None = None
        products = None if full else large(dynamics)
        if products is None:
            self._sparse, self._terms = None, compile_function(kkt_terms, dynamics)
        else:
            example = np.zeros(s.n + s.m + s.p), 0.0, np.zeros(s.n), np.zeros(s.n)
            self._sparse = products.coloured(kkt_residual, example)

    def terms(self, t: float, q: Vector, v: Vector, x: Vector) -> tuple[Vector, Any]:
        """Residual (N,) and matrix (N, N) at ``x = [vdot, lam, mu]``, N = n + m + p."""
        if self._sparse is not None:
            return self._sparse(x, t, q, v)
        packed = self._terms(t, q, v, x)
        size = x.size
        return packed[:size], packed[size:].reshape(size, size)

    def solve(self, t: float, q: Vector, v: Vector, lam: Vector | None = None, mu: Vector | None = None) -> Acceleration:
        """Accelerations and multipliers at (t, q, v); ``lam`` (m,) and ``mu`` (p,) pick the root of a nonlinear reaction."""
        s, last = self.structure, self._last
        x = np.zeros(s.n + s.m + s.p)
        if not s.linear_reaction:  # with one root a guess adds nothing but its own roundoff
            x[s.n : s.n + s.m] = 0.0 if lam is None else lam
            x[s.n + s.m :] = 0.0 if mu is None else mu
        elif last is not None and last[0] == t and last[1] is q and last[2] is v:
            return last[3]
        found = self._solved(t, q, v, x)
        frozen = all(x.base is None and not x.flags.writeable for x in (q, v))  # a view follows what it shows
        if self._sparse is not None and frozen:  # a start is looked at twice
            self._last = t, q, v, found
        return found

    def _solved(self, t: float, q: Vector, v: Vector, x: Vector) -> Acceleration:
        """Newton's iteration from ``x`` (N,)."""
        s, last, converged, singular, weakest = self.structure, np.inf, False, False, 1.0
        for _ in range(MAX_ITERATIONS):
            residual, matrix = self.terms(t, q, v, x)
            if self._sparse is None:
                increment = _solve_scaled(matrix, residual, s.n)
            else:
                increment, weakest = solve_scaled_sparse(matrix, residual)
            if increment is None:
                singular = True
                break
            x = x - increment
            if s.linear_reaction:
                converged = True
                break
            size = float(np.maximum(_relative(increment[: s.n], x[: s.n]), _relative(increment[s.n :], x[s.n :])))  # or NaN
            if size <= CONVERGED or (size <= STAGNATION and size >= last):
                converged = True
                break
            last = size
        else:
            converged = self._in_balance(t, q, v, x)
        return Acceleration(x[: s.n], x[s.n : s.n + s.m], x[s.n + s.m :], converged, singular, weakest)

    def left_free(self, t: float, q: Vector, v: Vector, x: Vector, rows: int) -> tuple[Vector, Any] | None:
        """Part of accelerations x (n,) by applied forces that constraints at (t, q, v) leave, (n,), and M (n, n).

        Only the first ``rows`` of [g_q; k_v] are used.  None where the matrix is singular.
        """
        n, m, p = x.size, self.structure.m, self.structure.p
        _, matrix = self.terms(t, q, v, np.zeros(n + m + p))
        mass, right, size = matrix[:n, :n], np.zeros(n + rows), n + rows
        right[:n] = mass @ x
        if self._sparse is None:
            found = _solve_scaled(matrix[:size, :size], right, n)
        else:
            found, _ = solve_scaled_sparse(matrix[:size, :size], right)
        return None if found is None else (found[:n], mass)

    def _in_balance(self, t: float, q: Vector, v: Vector, x: Vector) -> bool:
        """True if the residual of the equations at ``x`` is roundoff.

        Multipliers near zero beside large forces are roundoff, and so are accelerations near zero, as in equilibrium:
        constraint rows may be off by the accelerations that each force alone would cause.
        """
        residual, matrix = self.terms(t, q, v, x)
        sizes = abs(matrix) @ np.abs(x) + np.abs(self.terms(t, q, v, 0.0 * x)[0])
        n, mass = self.structure.n, np.abs(matrix.diagonal())[: self.structure.n]
        alone = np.divide(sizes[:n], mass, out=np.zeros(n), where=mass > 0.0)  # what each force would do to its coordinate
        sizes[n:] += abs(matrix)[n:, :n] @ alone
        left, allowed = np.abs(residual), CONVERGED * sizes
        return bool(np.max(left[:n]) <= np.max(allowed[:n]) and np.all(left[n:] <= allowed[n:]))


def _solve_scaled(matrix: Matrix, right: Vector, n: int) -> Vector | None:
    """Solve, with rows and columns scaled where their sizes differ; None when the matrix is singular to working precision.

    By LAPACK's expert driver, in one call: each one more takes as long as it does for a small matrix.  It scales rows by
    their largest entries, beside which the mass vanishes where rows of constraints are 1e16 times larger: what seems
    singular is scaled again, the first ``n`` rows by their mass.
    """
    *_, solution, _, _, _, info = lapack.dgesvx(matrix, right, fact="E")
    if info == 0:
        return solution[:, 0]
    with np.errstate(all="ignore"):
        rows = _sizes(matrix[:, :n], axis=1)
        columns = _sizes(matrix / rows[:, None], axis=0)
        *_, solution, _, _, _, info = lapack.dgesvx(matrix / rows[:, None] / columns, right / rows, fact="N")
        return solution[:, 0] / columns if info == 0 else None


def _sizes(matrix: Matrix, axis: int) -> Vector:
    """Largest magnitudes along ``axis``; one where all are zero."""
    largest = np.abs(matrix).max(axis=axis)
    return np.where(largest == 0.0, 1.0, largest)


def solve_scaled_sparse(matrix: sp.csr_array, right: Vector) -> tuple[Vector | None, float]:
    """Solve with rows and columns scaled to size one; (solution, least over largest pivot).

    The solution is None when the matrix is singular to working precision.
    """
    entries: Any = matrix.tocoo()
    i, j, values = entries.row, entries.col, entries.data
    row = _largest(values, i, right.size)
    if not np.all(row > 0):
        return (np.full_like(right, np.nan) if np.isnan(row).any() else None), 0.0
    values = values / row[i]
    column = _largest(values, j, right.size)
    if not np.all(column > 0):
        return None, 0.0
    solution, pivots = _solve_sparse(sp.coo_array((values / column[j], (i, j)), shape=matrix.shape), right / row)
    weakest = float(pivots.min() / pivots.max())
    return (solution / column if weakest > np.finfo(float).eps else None), weakest


def _largest(values: Vector, places: Any, size: int) -> Vector:
    """Largest magnitude among the ``values`` at each index, (size,)."""
    found = np.zeros(size)
    np.maximum.at(found, places, np.abs(values))
    return found


def _solve_sparse(matrix: Any, right: Vector) -> tuple[Vector, Vector]:
    """Solution and magnitudes of the pivots: by LAPACK for a narrow band, else by SuperLU."""
    order = np.asarray(reverse_cuthill_mckee(matrix.tocsr()))
    place = np.argsort(order)
    i, j = place[matrix.row], place[matrix.col]
    lower, upper = int((i - j).max()), int((j - i).max())
    main = lower + upper
    if main + lower >= NARROW:
        try:
            factor = splu(matrix.tocsc())
        except RuntimeError:  # SuperLU's word for a pivot that is exactly zero
            return right, np.array([0.0, 1.0])
        return factor.solve(right), np.abs(factor.U.diagonal())
    band = np.zeros((main + lower + 1, right.size), order="F")
    band[main + i - j, j] = matrix.data
    factors, pivots, _ = lapack.dgbtrf(band, lower, upper, overwrite_ab=True)
    ordered, _ = lapack.dgbtrs(factors, lower, upper, right[order], pivots)
    return ordered[place], np.abs(factors[main])


def _relative(increment: Vector, block: Vector) -> Any:
    """Largest increment relative to the largest entry of its block (accelerations, or all multipliers)."""
    return np.max(np.abs(increment), initial=0.0) / np.maximum(np.max(np.abs(block), initial=0.0), np.finfo(float).tiny)
