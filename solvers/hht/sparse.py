"""Newton's matrix of large systems: a band after reverse Cuthill-McKee, or SuperLU.

A chain's matrix is a narrow band once its unknowns are sorted along the chain, and LAPACK's band LU beats general sparse
LU there by a factor of five at 5,000 unknowns.  SuperLU orders columns by COLAMD: MMD_AT_PLUS_A, made for symmetric
patterns with pivots on the diagonal, meets zeros there and fills in without bound when it pivots.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hhtbench.arguments import Vector
from hhtbench.lowering.compile.patterns import Indices, Pattern
from solvers.hht.blocks import Order
from solvers.hht.kernels import factor_blocks, largest_change, solve_blocks
from solvers.hht.linear import Factor

NARROW = 64  # diagonals up to which a band is taken without a look at what SuperLU would fill
BAND_GAIN = 5.0  # entries of a band that cost no more than one of SuperLU's: consecutive memory, no indices


@dataclass(frozen=True)
class Couplings:
    """What blocks take from earlier ones: sparse rows in the order of places."""

    starts: Indices  #: (size + 1,)
    places: Indices  #: (entries,)
    values: Vector  #: (entries,)


@dataclass(frozen=True, kw_only=True)
class BandFactor(Factor):
    """LU factors of bands in LAPACK's storage, one for each block of a block triangular matrix; arrays only."""

    storage: Vector  #: (order.storage,)
    pivots: Indices  #: (size,) rows down to the pivot
    order: Order
    couplings: Couplings

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        order, c = self.order, self.couplings
        y, x, blocks = np.empty_like(right), np.empty_like(right), order.blocks.ravel()
        solve_blocks(right, order.rows, order.columns, self.storage, self.pivots, blocks, c.starts, c.places, c.values, y, x)
        return x

    def largest(self, increment: Vector, n: int) -> tuple[float, float]:
        """Largest changes of q1 and of v1, in one pass."""
        found = np.empty(2)
        largest_change(self.maps.indptr, self.maps.indices, self.maps.data, increment, n, found)
        return float(found[0]), float(found[1])


@dataclass(frozen=True, kw_only=True)
class SpluFactor(Factor):
    """SuperLU's factors; a copy from a pickle factorises again, to the same bits."""

    matrix: sp.csc_array  #: (size, size)
    lu: Any = field(default=None, compare=False)  #: SuperLU's object, made from ``matrix``

    def __post_init__(self) -> None:
        if self.lu is None:
            object.__setattr__(self, "lu", splu(self.matrix, permc_spec="COLAMD"))

    def solve(self, right: Vector) -> Vector:
        """The matrix' inverse times ``right`` (size,)."""
        return self.lu.solve(right)

    def __getstate__(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "lu"}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        for name, value in {**saved, "lu": None}.items():
            object.__setattr__(self, name, value)
        self.__post_init__()


class Band:
    """Analysis for :class:`BandFactor`: where every entry goes."""

    kind = "band"

    def __init__(self, pattern: Pattern, size: int, order: Order, reason: str) -> None:
        own = int(np.searchsorted(pattern.rows, size))
        self.order, self.reason, self._size = order, reason, size
        i = _inverse(order.rows)[pattern.rows[:own]]
        j = _inverse(order.columns)[pattern.columns[:own]]
        block = np.searchsorted(order.blocks[:, 0], np.arange(size), side="right") - 1
        start, count, lower, upper = order.blocks.T
        height = 2 * lower + upper + 1
        offset = np.concatenate([[0], np.cumsum(count * height)])
        inside, b = block[i] == block[j], block[j]
        self.inside = np.flatnonzero(inside)
        self.places = (offset[b] + (j - start[b]) * height[b] + lower[b] + upper[b] + i - j)[inside]
        outside = np.flatnonzero(~inside)
        self.outside = outside[np.argsort(i[outside], kind="stable")]
        self.starts = np.searchsorted(i[self.outside], np.arange(size + 1))
        self.coupled = j[self.outside]
        self.maps = MapsPattern(pattern, size, own)

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """``entries``: q1, v1 (2n,), then the entries of the pattern."""
        values = entries[self.maps.rows :]
        storage, pivots = np.zeros(self.order.storage), np.empty(self._size, dtype=np.int64)
        if factor_blocks(values[self.inside], self.places, storage, pivots, self.order.blocks.ravel()):
            return None
        couplings = Couplings(self.starts, self.coupled, values[self.outside])
        return BandFactor(
            storage=storage, pivots=pivots, order=self.order, couplings=couplings, maps=self.maps.matrix(values), h=h
        )


def _inverse(order: Indices) -> Indices:
    places = np.empty_like(order)
    places[order] = np.arange(order.size)
    return places


class Splu:
    """Analysis for :class:`SpluFactor`."""

    kind = "sparse"

    def __init__(self, pattern: Pattern, size: int, reason: str) -> None:
        self.reason, self._own = reason, int(np.searchsorted(pattern.rows, size))
        rows, columns = pattern.rows[: self._own], pattern.columns[: self._own]
        self._sorted = np.lexsort((rows, columns))
        self._rows = rows[self._sorted]
        self._starts = np.searchsorted(columns[self._sorted], np.arange(size + 1)).astype(np.int32)
        self._size = size
        self.maps = MapsPattern(pattern, size, self._own)

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """``entries``: q1, v1 (2n,), then the entries of the pattern."""
        values = entries[self.maps.rows :]
        matrix: Any = sp.csc_array(
            (values[: self._own][self._sorted], self._rows, self._starts), shape=(self._size, self._size)
        )
        return splu_factor(matrix, self.maps.matrix(values), h)


class MapsPattern:
    """The part of a pattern below Newton's matrix: dq1/dx over dv1/dx."""

    def __init__(self, pattern: Pattern, size: int, own: int) -> None:
        self.rows = pattern.shape[0] - size  #: 2n
        self._own, self.columns, self._shape = own, pattern.columns[own:].astype(np.int32), (self.rows, size)
        self.starts = np.searchsorted(pattern.rows[own:] - size, np.arange(self.rows + 1)).astype(np.int32)

    def matrix(self, values: Vector) -> sp.csr_array:
        """(2n, size) from the entries of the whole pattern."""
        return sp.csr_array((np.array(values[self._own :]), self.columns, self.starts), shape=self._shape)


def splu_factor(matrix: sp.csc_array, maps: sp.csr_array, h: float) -> Factor | None:
    """SuperLU's factors, or None where a pivot is exactly zero."""
    try:
        return SpluFactor(matrix=matrix, maps=maps, h=h)
    except RuntimeError:  # SuperLU's word for it
        return None


def fill(pattern: Pattern, size: int) -> int:
    """Entries of SuperLU's factors, measured on a matrix of the pattern with arbitrary values."""
    own = int(np.searchsorted(pattern.rows, size))
    values = 1.0 + np.random.default_rng(0).random(own)
    matrix: Any = sp.csc_array((values, (pattern.rows[:own], pattern.columns[:own])), shape=(size, size))
    try:
        lu = splu(matrix, permc_spec="COLAMD")
    except RuntimeError:
        return size * size
    return int(lu.nnz)
