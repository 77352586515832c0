"""SuperLU for matrices that no narrow band holds: two slots of factorisations, kept in Python.

It orders columns by COLAMD: MMD_AT_PLUS_A, made for symmetric patterns with pivots on the diagonal, meets zeros there and
fills in without bound when it pivots.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hhtbench.arguments import Vector
from hhtbench.lowering.compile.coloured import Indices
from hhtbench.lowering.dynamics.foreign import Callbacks
from solvers.hht.equations.formulas import EPS, FULL_RANK


class SuperLU:
    """Factorisations of matrices (size, size) with entries at ``rows`` and ``columns`` (entries,)."""

    def __init__(self, rows: Indices, columns: Indices, size: int) -> None:
        self._sorted = np.lexsort((rows, columns))
        self._rows = rows[self._sorted].astype(np.int32)
        self._starts = np.searchsorted(columns[self._sorted], np.arange(size + 1)).astype(np.int32)
        self._size = size
        self._slots: list[Any] = [None, None]

    def codes(self, callbacks: Callbacks, entries: int) -> dict[str, tuple[int, int]]:
        """Addresses by name of what the loops call; ``entries``: of matrix and maps."""
        factor = callbacks.entry(self.factor, 3, ((1,), (entries,)))
        return {"factor": (factor, 0), "solve": (callbacks.entry(self.solve, self._size, ((1,), (self._size,))), 0)}

    def factor(self, slot: Vector, entries: Vector) -> Vector:
        """1 where it succeeds, else 0; the least magnitude of a pivot; the rank."""
        values = entries[self._sorted]  # those of the maps follow
        matrix: Any = sp.csc_array((values, self._rows, self._starts), shape=(self._size, self._size), copy=True)
        matrix.eliminate_zeros()
        try:
            made = splu(matrix, permc_spec="COLAMD")
        except RuntimeError:  # SuperLU's word for a pivot of exactly zero
            return np.array([0.0, 0.0, self._size - 1.0])
        self._slots[int(slot[0])] = made
        pivots = np.abs(made.U.diagonal())
        return np.array([1.0, pivots.min(), np.sum(pivots > FULL_RANK * EPS * pivots.max())])

    def solve(self, slot: Vector, right: Vector) -> Vector:
        """The inverse of the matrix in ``slot`` times ``right`` (size,)."""
        return self._slots[int(slot[0])].solve(right)

    def fill(self) -> int:
        """Entries of the factors, measured on a matrix of the pattern with arbitrary values."""
        made = self.factor(np.zeros(1), 1.0 + np.random.default_rng(0).random(self._rows.size))
        return int(self._slots[0].nnz) if made[0] > 0.0 else self._size * self._size
