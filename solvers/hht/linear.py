"""Linear algebra of a step: one protocol ``analyse / factor / solve``, and its dense kind.

``analyse`` looks at the structure once per engine, ``factor`` takes the entries of one Newton matrix, ``solve`` and
``change`` serve the iterations.  A factor is part of the state between steps, so that a state can be saved and compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import lapack

from hhtbench.arguments import Matrix, Vector

KINDS = ("auto", "dense", "band", "sparse")


@dataclass(frozen=True, kw_only=True)
class Factor:
    """LU factors of one Newton matrix with the linear maps that turn its increments into those of q1 and v1."""

    maps: Any  #: (2n, size): dq1/dx over dv1/dx, an array or sparse rows
    h: float  #: signed step [s] it was made for
    rate: float = 0.0  #: worst contraction per iteration seen with it
    uses: int = 0  #: solves by the native engine, which inverts what it uses often
    noise: tuple[float, float] = (0.0, 0.0)  #: what one roundoff of the known values changes in q1 and v1; 0: not measured

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        raise NotImplementedError

    def change(self, increment: Vector) -> Vector:
        """What an ``increment`` (size,) of the unknowns changes in q1 and v1, one vector (2n,)."""
        return self.maps @ increment

    def largest(self, increment: Vector, n: int) -> tuple[float, float]:
        """The largest magnitudes of :meth:`change` in q1 (the first ``n``) and in v1."""
        change = np.abs(self.change(increment))
        return float(change[:n].max()), float(change[n:].max())


@dataclass(frozen=True, kw_only=True)
class DenseFactor(Factor):
    """LAPACK's factors of the full matrix."""

    lu: Matrix  #: (size, size)
    pivots: Vector  #: (size,)

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        return lapack.dgetrs(self.lu, self.pivots, right)[0]


@dataclass(frozen=True, kw_only=True)
class InverseFactor(Factor):
    """The inverse of a small matrix, as the compiled loops keep it."""

    inverse: Matrix  #: (size, size)

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        return self.inverse @ right


class Analysis(Protocol):
    """What is known of the structure of Newton's matrix before its entries."""

    @property
    def kind(self) -> str:
        """Of ``KINDS``, without "auto"."""

    @property
    def reason(self) -> str:
        """Why this kind, in words."""

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """LU factors from what :attr:`~solvers.hht.newton.Functions.matrix` returns after the residual.

        None for a matrix that is singular to the last bit.
        """


@dataclass(frozen=True)
class Dense:
    """LAPACK's LU of the full matrix: the fastest for some hundred unknowns, whatever the structure."""

    size: int  #: unknowns of a step
    reason: str = ""
    kind: str = "dense"

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """``entries``: [matrix; dq1/dx; dv1/dx] (size + 2n, size), row by row."""
        blocks = entries.reshape(-1, self.size)
        return factorise(blocks[: self.size], blocks[self.size :], h)


def factorise(matrix: Matrix, maps: Matrix, h: float) -> Factor | None:
    """LU with partial pivoting; None when a pivot is exactly zero or not a number."""
    lu, pivots, info = lapack.dgetrf(matrix)
    if info != 0 or not np.isfinite(lu[-1, -1]):
        return None
    return DenseFactor(lu=lu, pivots=pivots, maps=maps, h=h)
