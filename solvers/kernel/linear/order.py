"""Ordering of a sparse matrix into a sequence of blocks, each a narrow band.

A step's matrix is often block triangular: with forces that depend neither on q nor on v the accelerations come first,
then ``lam0`` from the position level, then ``lam1`` from the velocity level.  Each block is sorted by reverse Cuthill-McKee.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching, reverse_cuthill_mckee

from hhtbench.lowering.compile.coloured import Indices

MAX_LEVELS = 8  # of blocks: a longer sequence costs more calls than its narrower bands save


@dataclass(frozen=True)
class Order:
    """Permutations of rows and columns, and the diagonal blocks."""

    rows: Indices  #: (size,) position -> row
    columns: Indices  #: (size,) position -> column
    blocks: Indices  #: (k, 4) int64: first position, number of columns, lower and upper diagonals

    @property
    def storage(self) -> int:
        """Length of the storage of all bands, including room for pivoting."""
        return int(np.sum(self.blocks[:, 1] * (2 * self.blocks[:, 2] + self.blocks[:, 3] + 1)))

    @property
    def text(self) -> str:
        """The blocks as text: columns (lower + upper diagonals) of each."""
        return ", ".join(f"{count} ({lower} + {upper})" for _, count, lower, upper in self.blocks)


def find_order(rows: Indices, columns: Indices, size: int) -> Order:
    """Find the order of a matrix with entries at ``rows`` and ``columns`` (entries,)."""
    pattern: Any = sp.csr_array((np.ones(rows.size, dtype=np.int8), (rows, columns)), shape=(size, size))
    row_of = _matched(pattern)  # column -> the row that stands on its diagonal
    back = np.argsort(row_of)
    graph: Any = sp.coo_array((np.ones(rows.size, dtype=np.int8), (back[rows], columns)), shape=(size, size)).tocsr()
    level = _levels(graph)
    forth, blocks, start = [], [], 0
    for value in range(int(level.max()) + 1):
        members = np.flatnonzero(level == value)
        inside: Any = graph[members][:, members]
        order = np.asarray(reverse_cuthill_mckee(sp.csr_matrix(inside + inside.T), symmetric_mode=True))
        sorted_ = inside[order][:, order].tocoo()
        below = sorted_.row - sorted_.col
        blocks.append((start, members.size, max(int(below.max(initial=0)), 0), max(int(-below.min(initial=0)), 0)))
        forth.append(members[order])
        start += members.size
    places = np.concatenate(forth)
    return Order(row_of[places], places, np.array(blocks, dtype=np.int64))


def _matched(pattern: Any) -> Indices:
    """A distinct row with an entry for every column, by maximum matching; the diagonal if it is full or none exists."""
    size = pattern.shape[0]
    if np.all(pattern.diagonal() != 0):
        return np.arange(size)
    rows = np.asarray(maximum_bipartite_matching(sp.csr_matrix(pattern), perm_type="row"))
    return rows.astype(np.int64) if np.all(rows >= 0) else np.arange(size)


def _levels(graph: Any) -> Indices:
    """(size,) number of blocks before that of each row; all zero if there are too many."""
    count, component = connected_components(graph, directed=True, connection="strong")
    entries = graph.tocoo()
    own, other = component[entries.row], component[entries.col]
    own, other = own[own != other], other[own != other]
    level = np.zeros(count, dtype=np.int64)
    for _ in range(MAX_LEVELS):
        deeper = level.copy()
        np.maximum.at(deeper, own, level[other] + 1)
        if np.array_equal(deeper, level):
            return level[component]
        level = deeper
    return np.zeros(graph.shape[0], dtype=np.int64)
