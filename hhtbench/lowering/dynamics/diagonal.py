"""A diagonal matrix that is kept as its diagonal: what large systems have for a constant mass."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np


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
