"""Mass matrices of large systems that are narrow bands: inverses, and patterns of varying ones."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
import scipy.sparse as sp
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import LinearOperator, norm, onenormest

from hhtbench.lowering.compile.banded import factor_banded, solve_banded
from hhtbench.lowering.dynamics.mass import BROAD, SINGULAR, SYMMETRIC, Sparse, row_by_row


class BandInverse(eqx.Module):
    """Inverse of a band matrix; multiplies by a solve."""

    factors: Any  #: as :func:`~hhtbench.lowering.compile.banded.solve_banded` takes them
    order: Any  #: (n,) the coordinate in each place of the band

    def __matmul__(self, x: Any) -> Any:
        """Product with a vector (n,)."""
        return solve_banded(self.factors, x[self.order])[np.argsort(self.order)]


class Entries(eqx.Module):
    """Pattern of a symmetric matrix (n, n), and the positions of its entries in a band."""

    columns: Any  #: (n, k) columns of each row's entries, as in :class:`Sparse`
    filled: Any  #: (n, k) False for the entries that repeat the last
    order: Any  #: (n,) the coordinate in each place of the band
    #: (n, w + 1) indices into the flattened values, n k for none, in the layout of :func:`.compile.banded.factor_banded`
    places: Any

    @property
    def pattern(self) -> Any:
        """Rows and columns of the entries, (2, entries), row by row."""
        rows = np.broadcast_to(np.arange(len(self.columns))[:, None], self.columns.shape)
        return np.stack([rows[self.filled], self.columns[self.filled]]).astype(np.int32)

    def of(self, matrix: Any, xp: Any) -> Sparse:
        """The entries of ``matrix`` (n, n) as :class:`Sparse`."""
        rows = np.arange(len(self.columns))[:, None]
        return Sparse(xp.where(self.filled, matrix[rows, self.columns], 0.0), self.columns)

    def inverse(self, matrix: Sparse, xp: Any) -> BandInverse:
        """Inverse of a ``matrix`` with these entries, NaN if it is not positive definite; pure array code."""
        band = xp.append(matrix.values.ravel(), 0.0)[self.places]
        return BandInverse(factor_banded(band), self.order)


def entries_at(n: int, flat: Any) -> Entries | None:
    """Entries at the flat indices ``flat`` in (n, n); None if they are no narrow band, or the diagonal has gaps."""
    pattern: Any = sp.coo_array((np.ones(flat.size), (flat // n, flat % n)), shape=(n, n)).tocsr()
    pattern = (pattern + pattern.T).tocsr()
    counts = np.diff(pattern.indptr)
    if not (pattern.diagonal() > 0.0).all() or counts.max() > BROAD * n:
        return None
    where, filled = row_by_row(pattern)
    columns = pattern.indices[where]
    order = reverse_cuthill_mckee(pattern, symmetric_mode=True)
    at = np.argsort(order)
    row, column = np.broadcast_to(at[:, None], columns.shape)[filled], at[columns][filled]
    width = int((row - column).max())
    if width > BROAD * n:
        return None
    places, below = np.full((n, width + 1), columns.size), row >= column
    places[row[below], (column - row + width)[below]] = np.flatnonzero(filled)[below]
    return Entries(columns, filled, order, places)


def band_inverse(mass: Sparse) -> BandInverse | None:
    """Inverse of ``mass``; None if it is not symmetric, not positive definite, singular or no narrow band."""
    matrix, n = mass.entries(), mass.shape[0]
    size = np.sqrt(np.maximum(matrix.diagonal(), 0.0))
    if not (size > 0.0).all():
        return None
    scale = sp.diags_array(1.0 / size)
    unit = (scale @ matrix @ scale).tocsr()
    order = reverse_cuthill_mckee(unit, symmetric_mode=True)
    ordered = unit[order][:, order].tocoo()
    width = int(np.abs(ordered.row - ordered.col).max())
    if width > BROAD * n or abs(unit - unit.T).max() > SYMMETRIC:
        return None
    band, below = np.zeros((width + 1, n)), ordered.row >= ordered.col
    band[(ordered.row - ordered.col)[below], ordered.col[below]] = ordered.data[below]
    try:
        lower = cholesky_banded(band, lower=True)
    except LinAlgError:
        return None
    solve = lambda x: cho_solve_banded((lower, True), np.ravel(x))  # noqa: E731
    if norm(unit, 1) * onenormest(LinearOperator((n, n), matvec=solve, rmatvec=solve)) > SINGULAR:
        return None
    factors = np.zeros((n, width + 1))  # row by row, of the matrix before it was scaled
    for k in range(width + 1):
        factors[k:, width - k] = lower[k, : n - k] * size[order][k:]
    factors[:, width] = 1.0 / factors[:, width]
    return BandInverse(factors, np.asarray(order, dtype=np.int32))
