"""The acceleration level (H16) of a large system: sparse matrix, sparse LU."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hhtbench.arguments import Vector
from hhtbench.lowering.compile.coloured import Coloured
from hhtbench.lowering.dynamics.matrix_free import MatrixFree


def kkt_residual(dynamics: MatrixFree, x: Any, t: Any, q: Any, v: Any) -> Any:
    """Residual (N,) of the KKT system at ``x = [vdot, lam, mu]``, N = n + m + p."""
    s = dynamics.structure
    vdot, lam, mu = x[: s.n], x[s.n : s.n + s.m], x[s.n + s.m :]
    rows = [dynamics.residual(t, q, v, dynamics.mass_product(t, q, vdot), lam, mu)]
    if s.m:
        along = lambda y: dynamics.constraint_velocity(t, q, y)  # noqa: E731 - g_q vdot is linear in vdot, up to g_t
        rows.append(along(vdot) - along(0.0 * vdot) + dynamics.constraint_acceleration(t, q, v))
    if s.p:
        rows.append(dynamics.velocity_row(t, q, v, vdot) + dynamics.velocity_constraint_acceleration(t, q, v))
    return dynamics.xp.concatenate(rows)


def sparse_kkt(dynamics: MatrixFree) -> Coloured:
    """Residual (N,) and sparse matrix (N, N) of (H16) as a function of (x, t, q, v)."""
    n, unknowns = dynamics.structure.n, dynamics.structure.n + dynamics.structure.m + dynamics.structure.p
    return Coloured(kkt_residual, dynamics, example=(np.zeros(unknowns), 0.0, np.zeros(n), np.zeros(n)))


def solve_scaled_sparse(matrix: sp.csr_array, right: Vector) -> Vector | None:
    """Solve after scaling rows and columns to size one; None when the matrix is singular to working precision."""
    row = abs(matrix).max(axis=1).toarray().ravel()
    if not np.all(row > 0):
        return np.full_like(right, np.nan) if np.isnan(row).any() else None
    scaled = sp.diags_array(1.0 / row) @ matrix
    column = abs(scaled).max(axis=0).toarray().ravel()
    if not np.all(column > 0):
        return None
    try:
        lu = splu((scaled @ sp.diags_array(1.0 / column)).tocsc())
    except RuntimeError:  # SuperLU's word for a pivot that is exactly zero
        return None
    pivots = np.abs(lu.U.diagonal())
    if not pivots.min() > np.finfo(float).eps * pivots.max():
        return None
    return lu.solve(right / row) / column
