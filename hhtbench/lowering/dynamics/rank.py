"""Rows of [g_q; k_v] that depend on others: pivoted QR for full rows, null space of C^T for sparse ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack, qr
from scipy.sparse.linalg import splu

from hhtbench.protocol.arguments import Matrix, Vector

RANK_TOLERANCE = 1e-10  # what a dependent unit row has left, at most: roundoff
NO_SHARE = 1e-12  # share of another unit row that a dependent one has by roundoff
SHIFT = 1e-14  # shift of C C^T, which is singular for dependent rows: far below the square of any other singular value
TRUSTED = 1e-4  # singular values from which iteration with the shifted matrix has told apart what is smaller
SWEEPS = 3  # of that iteration: each makes parts of the null space 1e6 times larger than any other below TRUSTED
FEW = 8  # vectors of the null space that are looked for first
LAST = 1e-6  # by so much the last of equal rows counts for more: the one that repeats an earlier row is named


@dataclass(frozen=True)
class ConstraintRank:
    """Rank of the stacked constraint Jacobian [g_q; k_v] at one point."""

    rows: int
    rank: int
    redundant: tuple[int, ...]  #: rows that depend on the others (position rows first, then velocity rows)

    @property
    def text(self) -> str:
        """Description of the dependent rows."""
        return f"rank {self.rank} of {self.rows} rows; dependent on the others: rows {list(self.redundant)} of [g; k]"


def constraint_rank(rows: Any, tolerance: float = RANK_TOLERANCE) -> ConstraintRank:
    """Rank of ``rows`` (m + p, n) = [g_q; k_v], full or sparse, after scaling each to length one.

    Raises
    ------
    ValueError
        They hold NaN or infinity.
    """
    count = rows.shape[0]
    if count == 0:
        return ConstraintRank(0, 0, ())
    if not isinstance(rows, np.ndarray):
        redundant = _dependent(_unit_rows(rows), tolerance * count**0.5)
        return ConstraintRank(count, count - len(redundant), redundant)
    unit = rows / _or_one(np.abs(rows).max(axis=1, keepdims=True))  # first, so that no square overflows
    unit = unit / _or_one(np.sqrt((unit * unit).sum(axis=1, keepdims=True)))
    _expect_finite(unit)
    triangle, pivots, *_ = lapack.dgeqp3(unit.T)
    diagonal = np.abs(triangle.diagonal())
    rank = int((diagonal > tolerance * count**0.5).sum())
    return ConstraintRank(count, rank, tuple(sorted(int(i) - 1 for i in pivots[rank:])))


def minimum_norm(rows: Any, multipliers: Vector, redundant: tuple[int, ...]) -> Vector:
    """Multipliers of least norm with the same reaction ``rows^T multipliers``; ``rows`` (m + p, n) is [g_q; k_v].

    ``redundant``: dependent rows of the consistent start.  A state off the constraints by an error has independent rows by
    as little, and a null space found by a tolerance would jump there.
    """
    dependent = list(redundant)
    kept = np.setdiff1d(np.arange(multipliers.size), dependent)
    null = np.zeros((multipliers.size, len(dependent)))
    null[dependent] = np.eye(len(dependent))
    null[kept] = -_combinations(rows[kept], rows[dependent])
    basis = np.linalg.qr(null)[0]
    shares = basis[dependent] @ (basis.T @ multipliers)  # not by the basis: its roundoff would reach rows beside those
    return np.asarray(multipliers - null @ shares, dtype=np.float64)


def _combinations(independent: Any, dependent: Any) -> Matrix:
    """X (rows, k) of least |independent^T X - dependent^T|, the dependent rows as combinations of the others.

    Rows are scaled first, and coefficients of roundoff set to zero: otherwise large multipliers would visibly change
    those of unrelated rows.
    """
    if isinstance(independent, np.ndarray):
        size, of_dependent = (_or_one(np.abs(x).max(axis=1)) for x in (independent, dependent))
        shares = np.linalg.lstsq((independent / size[:, None]).T, (dependent / of_dependent[:, None]).T)[0]
    else:
        size, of_dependent = (_or_one(abs(x).max(axis=1).toarray().ravel()) for x in (independent, dependent))
        kept, n = independent.shape
        unit = sp.diags_array(1.0 / size) @ independent
        augmented: Any = sp.block_array([[sp.eye_array(n), unit.T], [unit, None]], format="csc")
        right = (sp.diags_array(1.0 / of_dependent) @ dependent).toarray().T
        shares = splu(augmented).solve(np.concatenate([right, np.zeros((kept, of_dependent.size))]))[n:]
    shares[np.abs(shares) < NO_SHARE] = 0.0
    return np.asarray(shares * (of_dependent / size[:, None]), dtype=np.float64)


def _unit_rows(rows: Any) -> Any:
    """Sparse ``rows`` scaled to length one, except rows of zeros."""
    _expect_finite(rows.data)
    largest = abs(rows).max(axis=1).toarray().ravel()
    unit = sp.diags_array(1.0 / _or_one(largest)) @ rows  # first, so that no square overflows
    return sp.diags_array(1.0 / _or_one(np.sqrt((unit * unit).sum(axis=1)))) @ unit


def _or_one(sizes: Vector) -> Vector:
    """``sizes`` with zeros replaced by one, for division."""
    return np.where(sizes > 0.0, sizes, 1.0)


def _expect_finite(values: Any) -> None:
    if not np.isfinite(values).all():
        raise ValueError("the constraint Jacobian holds NaN or infinity")


def _dependent(unit: Any, tolerance: float) -> tuple[int, ...]:
    """Indices of rows of sparse ``unit`` (rows, n) whose removal leaves independent rows."""
    null = _left_null_space(unit, tolerance)
    if not null.shape[1]:
        return ()
    weighted = null * (1.0 + LAST * np.arange(1, len(null) + 1) / len(null))[:, None]
    pivots = qr(weighted.T, mode="r", pivoting=True)[1]
    return tuple(sorted(int(i) for i in pivots[: null.shape[1]]))


def _left_null_space(unit: Any, tolerance: float) -> Matrix:
    """Orthonormal x (rows, d) with |unit^T x| below ``tolerance``, by shifted inverse iteration with unit unit^T."""
    rows, n = unit.shape
    shift = -SHIFT * sp.eye_array(rows)
    factor = splu(sp.block_array([[sp.eye_array(n), unit.T], [unit, shift]], format="csc"))
    draw, count = np.random.default_rng(0), min(FEW, rows)
    while True:
        vectors = draw.normal(size=(rows, count))
        for _ in range(SWEEPS):
            vectors = factor.solve(np.concatenate([np.zeros((n, count)), vectors]))[n:]
            vectors = np.linalg.qr(vectors)[0]
        _, size, right = np.linalg.svd(unit.T @ vectors, full_matrices=False)
        size = np.concatenate([size, np.zeros(count - size.size)])
        if count == rows or size[0] > TRUSTED:
            return np.asarray(vectors @ right[size[: len(right)] <= tolerance].T)
        count = min(2 * count, rows)
