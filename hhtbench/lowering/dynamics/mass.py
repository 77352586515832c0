"""The mass matrix, also as a diagonal or by its entries: symmetry, singularity, inverse."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
import scipy.sparse as sp

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.protocol.arguments import Matrix, Vector

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.band_mass import BandInverse

SYMMETRIC = 1e-12  # asymmetry over the two diagonal entries: more than the roundoff of a product J^T m J
SINGULAR = 1e13  # condition (diagonal scaled to one) from which M^-1 F has no digit to spare
BROAD = 0.1  # of all coordinates: columns in a row, or diagonals of a band, from which the full matrix serves as well

_constant = Cache(64)  # verdicts on masses that are constant


class Diagonal(eqx.Module):
    """Matrix ``diag(values)`` (n, n); multiplies without forming the full matrix."""

    values: Any  #: (n,)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (n, n)."""
        return (self.values.size, self.values.size)

    def __matmul__(self, x: Any) -> Any:
        """The product with a vector (n,) or a matrix (n, k)."""
        return self.values * x if x.ndim == 1 else self.values[:, None] * x

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """The full matrix (n, n)."""
        return np.diag(np.asarray(self.values, dtype=dtype))

    def entries(self) -> sp.csr_array:
        """The matrix (n, n) in SciPy's sparse format."""
        return sp.diags_array(np.asarray(self.values), format="csr")

    def inverse(self) -> Diagonal | None:
        """The inverse, or None where an entry is zero."""
        return None if np.any(np.asarray(self.values) == 0) else Diagonal(1.0 / self.values)


class Sparse(eqx.Module):
    """Matrix (n, n) by the entries of its rows; multiplies without forming the full matrix."""

    values: Any  #: (n, k)
    columns: Any  #: (n, k) whole numbers; rows of less than k entries have the last column again, with zeros

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (n, n)."""
        return (self.columns.shape[0], self.columns.shape[0])

    @property
    def diagonal(self) -> Any:
        """Its main diagonal (n,)."""
        return (self.values * (self.columns == np.arange(len(self.columns))[:, None])).sum(axis=1)

    def __matmul__(self, x: Any) -> Any:
        """The product with a vector (n,)."""
        return (self.values * x[self.columns]).sum(axis=1)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """The full matrix (n, n)."""
        return np.asarray(self.entries().toarray(), dtype=dtype)

    def entries(self) -> sp.csr_array:
        """The matrix (n, n) in SciPy's sparse format."""
        n, k = self.columns.shape
        given = np.array(self.values).ravel(), np.array(self.columns).ravel(), k * np.arange(n + 1, dtype=np.int32)
        matrix = sp.csr_array(given, shape=(n, n))
        matrix.sum_duplicates()
        return matrix

    def inverse(self) -> BandInverse | None:
        """The inverse; None where the matrix is not symmetric, not positive definite, singular or no narrow band."""
        from hhtbench.lowering.dynamics.band_mass import band_inverse  # few masses are sparse

        return band_inverse(self)


def row_by_row(matrix: Any) -> tuple[Any, Any]:
    """(n, k) indices of a matrix's entries, row by row, and a mask that is False where a short row repeats its last."""
    counts = np.diff(matrix.indptr)
    place = np.minimum(np.arange(counts.max()), counts[:, None] - 1)
    return matrix.indptr[:-1, None] + place, place == np.arange(counts.max())


def compact(mass: Any, xp: Any) -> Any:
    """A constant mass (n, n) as Diagonal or Sparse if its inverse is a diagonal or band too, else unchanged."""
    if isinstance(mass, Diagonal | Sparse):
        return mass
    entries = sp.csr_array(np.asarray(mass))
    n, counts = entries.shape[0], np.diff(entries.indptr)
    if entries.nnz == np.count_nonzero(entries.diagonal()):
        return Diagonal(xp.asarray(entries.diagonal()))
    if counts.min() == 0 or counts.max() > BROAD * n or not np.isfinite(entries.data).all():
        return mass
    where, filled = row_by_row(entries)
    sparse = Sparse(xp.asarray(np.where(filled, entries.data[where], 0.0)), entries.indices[where])
    return mass if sparse.inverse() is None else sparse


def full(matrix: Any, xp: Any) -> Any:
    """``matrix`` (n, n) as an array of the namespace ``xp``."""
    if isinstance(matrix, Sparse):
        rows = np.broadcast_to(np.arange(matrix.shape[0])[:, None], matrix.columns.shape)
        return xp.zeros(matrix.shape).at[rows, matrix.columns].add(matrix.values)
    return xp.diag(matrix.values) if isinstance(matrix, Diagonal) else matrix


def mass_at(dynamics: Any, t: Any, q: Any) -> Any:
    """Mass matrix M (n, n)."""
    return dynamics.mass(t, q)


def infinite_entry(mass: Any) -> tuple[tuple[int, ...], float] | None:
    """Index and value of an entry of a constant mass that is not finite; None if all are."""
    if mass is None or np.isfinite(np.asarray(mass.values if isinstance(mass, Diagonal | Sparse) else mass)).all():
        return None
    entries = np.asarray(mass)
    row, column = np.argwhere(~np.isfinite(entries))[0].tolist()
    return (row, column), float(entries[row, column])


def singular_at(dynamics: Any, t: float, q: Vector) -> bool:
    """True if the mass is singular at (t, q), False if it is not finite; warns if it is not symmetric."""
    if dynamics.structure.mass == "identity":
        return False
    if isinstance(dynamics.constant_mass, Diagonal | Sparse):
        return dynamics.inverse_mass is None
    mass = dynamics.constant_mass
    if mass is None:
        singular, entries = _judged(np.asarray(compile_function(mass_at, dynamics)(t, q)))
    else:
        singular, entries = _constant.find(by_id(mass), lambda: _judged(np.asarray(mass)))
    if entries:  # the equations are solved as they stand
        text = f"mass_matrix is not symmetric: {entries}. It is used as it is; a kinetic energy has a symmetric one."
        warnings.warn(text, UserWarning, stacklevel=1)
    return singular


def _judged(mass: Matrix) -> tuple[bool, str]:
    """(singular, text on its asymmetry) of ``mass``; (False, "") if it is not finite."""
    return (mass_is_singular(mass), asymmetry(mass)[1]) if np.isfinite(mass).all() else (False, "")


def plain_mass(dynamics: Any) -> bool:
    """True if the mass needs no check at a start, or only where it varies: a JAX system's own, symmetric and regular."""
    mass = dynamics.constant_mass
    if dynamics.xp is np or dynamics.wraps or mass is None:
        return dynamics.xp is not np and not dynamics.wraps
    entries = np.asarray(mass)
    return bool(np.isfinite(entries).all()) and dynamics.inverse_mass is not None and not asymmetry(entries)[1]


def inverse_of(mass: Any, xp: Any) -> Any:
    """Inverse of a constant mass; None if there is none or it is singular (solvers then augment it).

    NaN for a mass that is not finite: the start then names the entry.
    """
    if mass is None or isinstance(mass, Diagonal | Sparse):
        return None if mass is None else mass.inverse()
    if not np.isfinite(np.asarray(mass)).all():
        return xp.full(mass.shape, np.nan)
    return None if mass_is_singular(np.asarray(mass)) else xp.asarray(np.linalg.inv(np.asarray(mass)))


def asymmetry(mass: Matrix) -> tuple[float, str]:
    """Relative asymmetry of the mass matrix (n, n), and the worst pair of entries as text, "" within roundoff.

    Relative to the root of the product of the two diagonal entries, the bound for a positive definite matrix.
    """
    diagonal = np.sqrt(np.abs(np.diag(mass)))
    size = np.outer(diagonal, diagonal)
    apart = np.abs(mass - mass.T) / np.where(size > 0, size, np.max(np.abs(mass), initial=0.0) or 1.0)
    i, j = sorted(np.unravel_index(np.argmax(apart), apart.shape))
    if not apart[i, j] > SYMMETRIC:
        return float(apart[i, j]), ""
    return float(apart[i, j]), f"M[{i}, {j}] = {mass[i, j]:.6g} and M[{j}, {i}] = {mass[j, i]:.6g}"


def mass_is_singular(mass: Matrix) -> bool:
    """True if the mass matrix (n, n), its diagonal scaled to one, is singular to working precision."""
    scale = np.sqrt(np.abs(np.diag(mass)))
    if np.any(scale == 0):
        return True
    return bool(np.linalg.cond(mass / np.outer(scale, scale)) > SINGULAR)
