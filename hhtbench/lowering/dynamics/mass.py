"""The mass matrix, kept as its diagonal in a large system: is it symmetric, is it singular, what is its inverse."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.compile.compiling import compile_function

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.dynamics import Dynamics

SYMMETRIC = 1e-12  # of the two diagonal entries: more than the roundoff of a product J^T m J
SINGULAR = 1e13  # condition (diagonal scaled to one) from which M^-1 F has no digit to spare

_constant = Cache(64)  # verdicts on masses that are constant


class Diagonal(eqx.Module):
    """``diag(values)``; multiplies like the matrix (n, n) it stands for and becomes it only where somebody asks."""

    values: Any  #: (n,)

    @property
    def shape(self) -> tuple[int, int]:
        """(n, n)."""
        return (self.values.size, self.values.size)

    def __matmul__(self, x: Any) -> Any:
        """The product with a vector (n,) or a matrix (n, k)."""
        return self.values * x if x.ndim == 1 else self.values[:, None] * x

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """The full matrix (n, n)."""
        return np.diag(np.asarray(self.values, dtype=dtype))

    def inverse(self) -> Diagonal | None:
        """The inverse, or None where an entry is zero."""
        return None if np.any(np.asarray(self.values) == 0) else Diagonal(1.0 / self.values)


def full(matrix: Any, xp: Any) -> Any:
    """``matrix`` (n, n) as an array of the namespace ``xp``."""
    return xp.diag(matrix.values) if isinstance(matrix, Diagonal) else matrix


def mass_at(dynamics: Dynamics, t: Any, q: Any) -> Any:
    """M (n, n)."""
    return dynamics.mass(t, q)


def singular_at(dynamics: Dynamics, t: float, q: Vector) -> bool:
    """Whether the mass is singular at (t, q); one that is not finite is not.  Warns where it is not symmetric."""
    if dynamics.structure.mass == "identity":
        return False
    if isinstance(dynamics.constant_mass, Diagonal):
        return dynamics.inverse_mass is None
    mass = dynamics.constant_mass
    if mass is None:
        singular, entries = _judged(np.asarray(compile_function(mass_at, dynamics)(t, q)))
    else:
        singular, entries = _constant.find(ById(mass), lambda: _judged(np.asarray(mass)))
    if entries:  # the equations are solved as they stand
        text = f"mass_matrix is not symmetric: {entries}. It is used as it is; a kinetic energy has a symmetric one."
        warnings.warn(text, UserWarning, stacklevel=1)
    return singular


def _judged(mass: Matrix) -> tuple[bool, str]:
    """Whether ``mass`` is singular, and where it is not symmetric; nothing is said of what is not finite."""
    return (mass_is_singular(mass), asymmetry(mass)[1]) if np.isfinite(mass).all() else (False, "")


def inverse_of(mass: Any, xp: Any) -> Any:
    """The inverse of a constant mass, or None where there is none or it is singular (solvers then augment it)."""
    if mass is None or isinstance(mass, Diagonal):
        return None if mass is None else mass.inverse()
    return None if mass_is_singular(np.asarray(mass)) else xp.asarray(np.linalg.inv(np.asarray(mass)))


def asymmetry(mass: Matrix) -> tuple[float, str]:
    """How far the mass matrix (n, n) is from symmetric, and the worst pair of entries in words, "" within roundoff.

    Measured by the root of the product of the two diagonal entries, which no entry of a positive definite matrix exceeds.
    """
    diagonal = np.sqrt(np.abs(np.diag(mass)))
    size = np.outer(diagonal, diagonal)
    apart = np.abs(mass - mass.T) / np.where(size > 0, size, np.max(np.abs(mass), initial=0.0) or 1.0)
    i, j = sorted(np.unravel_index(np.argmax(apart), apart.shape))
    if not apart[i, j] > SYMMETRIC:
        return float(apart[i, j]), ""
    return float(apart[i, j]), f"M[{i}, {j}] = {mass[i, j]:.6g} and M[{j}, {i}] = {mass[j, i]:.6g}"


def mass_is_singular(mass: Matrix) -> bool:
    """Whether the mass matrix (n, n) is singular to working precision, its diagonal scaled to one."""
    scale = np.sqrt(np.abs(np.diag(mass)))
    if np.any(scale == 0):
        return True
    return bool(np.linalg.cond(mass / np.outer(scale, scale)) > SINGULAR)
