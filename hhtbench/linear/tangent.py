r"""Linearised equations of motion on the tangent spaces of the constraints.

About a state that satisfies ``M v' = F + Q + Q_k``, ``g = 0``, ``g_q v = 0``, ``k = 0``, small motions (x, u) of (q, v) obey

    M u' + R_q x + R_v u = Q_lam dlam + Q_mu dmu,   g_q x = 0,   C u + D x = 0,   R = M v' - F - Q - Q_k,

with v', lam and mu held in the derivatives of R, ``C = [g_q; k_v]`` and ``D = [(g_q v)_q; k_q]``.  R_q holds the geometric
stiffness ``(g_q^T lam)_q`` of the multipliers.  Let the columns of Y span the null space of g_q, those of Z the null space
of C, and the rows of W^T the left null space of [Q_lam, Q_mu].  Then ``x = Y y``, ``u = S y + Z z``, ``S = -C^+ D Y``:
where constraints are not holonomic, there are more y than z (J. P. Meijaard, J. M. Papadopoulos, A. Ruina, A. L. Schwab,
Proc. R. Soc. A 463, 2007, appendix B; D. L. Peterson, G. Gede, M. Hubbard, Multibody System Dynamics 33, 2015).

In a steady motion the state moves along a symmetry of the equations, ``q' = along(q)``, affine in q with the matrix X.
Seen by an observer who moves along, all matrices are constant, and x' = X x + Y y', u' = X u + S y' + Z z':

    y' = Y^T ((S - X Y) y + Z z),   W^T M (S y' + Z z' + X u) + W^T (R_q x + R_v u) = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eig, matrix_balance

from hhtbench.lowering import Dynamics, compile_function
from hhtbench.lowering.dynamics.rank import RANK_TOLERANCE
from hhtbench.protocol.arguments import Matrix, Vector

SAFETY = 100.0  # bound of an eigenvalue's error over its estimate: entries of A are sums of many products
TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Terms:
    """Imbalance of forces, constraint values and their derivatives at one state."""

    balance: Vector  #: (n,) R = M vdot - F - Q - Q_k [N, N m]
    position: Vector  #: (m,) g [m, rad]
    mass: Matrix  #: (n, n) M
    by_q: Matrix  #: (n, n) R_q [N/m]
    by_v: Matrix  #: (n, n) R_v [N s/m]
    columns: Matrix  #: (n, m + p) [Q_lam, Q_mu]
    rows: Matrix  #: (m + p, n) C = [g_q; k_v]
    drift: Matrix  #: (m + p, n) D = [(g_q v)_q; k_q] [1/s]
    rank: int | None = None  #: of C where it is known: rows that depend on others only where g = 0 look independent nearby

    @property
    def of_position(self) -> Matrix:
        """g_q (m, n)."""
        return self.rows[: self.position.size]

    @cached_property
    def free(self) -> Matrix:
        """Z (n, k): orthonormal velocities that the constraints leave free."""
        return null_space(self.rows, self.rank)

    @cached_property
    def virtual(self) -> Matrix:
        """W (n, k): orthonormal directions in which no reaction acts; Z where reactions are not declared."""
        return null_space(self.columns.T, self.rank)


def terms_of(dynamics: Dynamics) -> Callable[..., Terms]:
    """Function of (t, q, v, vdot, lam, mu) that returns the :class:`Terms` of ``dynamics``, compiled."""
    n, m, p = dynamics.structure.n, dynamics.structure.m, dynamics.structure.p
    shapes = ((n,), (m,), (n, n), (n, n), (n, n), (n, m + p), (m + p, n), (m + p, n))
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    packed = compile_function(packed_terms, dynamics)

    def evaluate(*at: Any, rank: int | None = None) -> Terms:
        parts = np.split(np.asarray(packed(*at)), ends[:-1])
        made = {field.name: part.reshape(shape) for field, part, shape in zip(fields(Terms), parts, shapes, strict=False)}
        return Terms(**made, rank=rank)

    return evaluate


def packed_terms(dynamics: Dynamics, t: Any, q: Any, v: Any, vdot: Any, lam: Any, mu: Any) -> Any:
    """The fields of :class:`Terms`, packed into one vector."""
    s, xp = dynamics.structure, dynamics.xp
    by_q, by_v = (0.0 if x is None else -x for x in dynamics.force_jacobians(t, q, v))
    if s.mass == "variable":
        by_q = by_q + dynamics.mass_product_jacobian(t, q, vdot)
    g, columns, rows, drift = [xp.zeros(0)], [xp.zeros((s.n, 0))], [xp.zeros((0, s.n))], [xp.zeros((0, s.n))]
    if s.m:
        q_q, q_v, q_lam = dynamics.reaction_jacobians(t, q, v, lam)
        by_q, by_v = by_q - q_q, by_v if q_v is None else by_v - q_v
        g.append(dynamics.constraint(t, q))
        columns.append(q_lam)
        rows.append(dynamics.constraint_jacobian(t, q))
        drift.append(dynamics.constraint_velocity_jacobian(t, q, v))
    if s.p:
        k_v, k_mu = dynamics.velocity_reaction_jacobians(t, q, v, mu)
        by_q = by_q - dynamics.jacobian(lambda x: dynamics.velocity_reaction(t, x, v, mu), q)
        by_v = by_v if k_v is None else by_v - k_v
        columns.append(k_mu)
        rows.append(dynamics.velocity_constraint_jacobian(t, q, v))
        drift.append(dynamics.velocity_constraint_position_jacobian(t, q, v))
    balance = dynamics.residual(t, q, v, dynamics.mass_product(t, q, vdot), lam, mu)
    square = xp.zeros((s.n, s.n))
    matrices = [dynamics.mass(t, q), square + by_q, square + by_v, xp.concatenate(columns, axis=1)]
    matrices += [xp.concatenate(rows), xp.concatenate(drift)]
    return xp.concatenate([balance, *g, *(matrix.ravel() for matrix in matrices)])


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues; a real part or a value that roundoff could have made is zero."""

    values: Any  #: (r,) complex [1/s]
    vectors: Any  #: (r, r) complex, one a column

    @property
    def grows(self) -> bool:
        """True if a small motion grows."""
        return bool(np.any(self.values.real > 0.0))


@dataclass(frozen=True)
class Linear:
    """Small motions ``x' = A x`` about one state, in coordinates (y, z) of the tangent spaces."""

    matrix: Matrix  #: (r, r) A [1/s]
    positions: Matrix  #: (n, r): x of (y, z); zero for z
    velocities: Matrix  #: (n, r): u of (y, z)

    def spectrum(self, error: float) -> Spectrum:
        """Eigenvalues and eigenvectors of A, whose entries have the relative ``error``.

        A simple eigenvalue moves by at most its condition number times the change of A (G. H. Golub, C. F. Van Loan, Matrix
        Computations, 2013, section 7.2.2); the halves of a double one that has split are within it, too.
        """
        if not self.matrix.size:
            return Spectrum(np.zeros(0, complex), np.zeros((0, 0), complex))
        balanced, scales = matrix_balance(self.matrix, permute=False)
        found: Any = eig(balanced, left=True, right=True)
        values, left, right = found
        noise = SAFETY * error * np.linalg.norm(balanced) / np.maximum(np.abs(np.sum(left.conj() * right, axis=0)), TINY)
        values = np.where(np.abs(values) <= noise, 0.0, values)
        return Spectrum(np.where(np.abs(values.real) <= noise, 1j * values.imag, values), scales @ right)

    def leaves(self, x: Vector, u: Vector) -> float:
        """Relative size of ``A (y, z)`` for (x, u) along the motion itself: zero if it is steady."""
        state = np.linalg.lstsq(np.concatenate([self.positions, self.velocities]), np.concatenate([x, u]))[0]
        size = np.linalg.norm(np.abs(self.matrix) @ np.abs(state))
        return float(np.linalg.norm(self.matrix @ state) / size) if size else 0.0


def linearise(terms: Terms, along: Matrix) -> Linear:
    """Linearised motion seen by an observer who moves with ``q' = X q``; ``along`` is X (n, n), zero at rest.

    Raises
    ------
    LinAlgError
        The equations determine no accelerations.
    """
    Y, Z, W = null_space(terms.of_position), terms.free, terms.virtual
    S = -np.linalg.pinv(terms.rows, rcond=RANK_TOLERANCE) @ terms.drift @ Y
    M, last = terms.mass, Z.shape[1]
    top = np.hstack([Y.T @ (S - along @ Y), Y.T @ Z])
    positions = np.hstack([Y, np.zeros((Y.shape[0], last))])
    velocities = np.hstack([S, Z])
    forces = M @ (S @ top + along @ velocities) + terms.by_q @ positions + terms.by_v @ velocities
    return Linear(np.vstack([top, -np.linalg.solve(W.T @ M @ Z, W.T @ forces)]), positions, velocities)


def null_space(rows: Matrix, rank: int | None = None) -> Matrix:
    """Orthonormal basis (n, k) of the vectors x with ``rows x = 0``; rows (m, n) may depend on one another."""
    return decomposed(rows, rank).null


class Decomposed(NamedTuple):
    """Rows (m, n) of some rank r, split by their singular vectors."""

    shares: Matrix  #: (m, r): combinations ``shares^T rows`` are independent
    null: Matrix  #: (n, n - r): orthonormal, ``rows null = 0``


def decomposed(rows: Matrix, rank: int | None = None) -> Decomposed:
    """Split ``rows`` (m, n), scaled to length one; their rank by a tolerance if it is not given."""
    count, n = rows.shape
    if count == 0:
        return Decomposed(np.zeros((0, 0)), np.eye(n))
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    unit = np.where(size > 0.0, size, 1.0)
    left, values, right = np.linalg.svd(rows / unit)
    if rank is None:
        rank = int((values > RANK_TOLERANCE * count**0.5).sum())
    return Decomposed(left[:, :rank] / unit, right[rank:].T)
