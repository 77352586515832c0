"""Dense factorisation of the step matrix, kept as arrays so that a state with it can be saved and compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from hhtbench.arguments import Matrix, Vector


@dataclass(frozen=True)
class Factor:
    """LU factors of one Newton matrix with the linear maps that turn its increments into those of q1 and v1."""

    lu: Matrix  #: (size, size)
    pivots: Vector  #: (size,)
    maps: Matrix  #: (2n, size): dq1/dx over dv1/dx
    h: float  #: signed step [s] it was made for
    rate: float = 0.0  #: worst contraction per iteration seen with it

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        return lapack.dgetrs(self.lu, self.pivots, right)[0]

    def change(self, increment: Vector) -> Vector:
        """What an ``increment`` (size,) of the unknowns changes in q1 and v1, one vector (2n,)."""
        return self.maps @ increment


def factorise(matrix: Matrix, maps: Matrix, h: float) -> Factor | None:
    """LU with partial pivoting; None when a pivot is exactly zero or not a number."""
    lu, pivots, info = lapack.dgetrf(matrix)
    if info != 0 or not np.isfinite(lu[-1, -1]):
        return None
    return Factor(lu, pivots, maps, h)


def smallest_pivot_ratio(factor: Factor) -> float:
    """Smallest over largest pivot, a cheap sign of a matrix singular to working precision."""
    diagonal = np.abs(np.diag(factor.lu))
    return float(diagonal.min() / diagonal.max()) if diagonal.size else 1.0
