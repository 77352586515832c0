"""Analysis of Newton's matrix: its pattern, the choice of linear algebra, and its layout in the loops' memory."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hhtbench.lowering import Native
from hhtbench.lowering.compile.coloured import Indices, Pattern
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.protocol.arguments import Vector
from solvers.kernel import memory as mem
from solvers.kernel.full import address_of
from solvers.kernel.linear.matrix import MAX_INVERTED
from solvers.kernel.linear.order import Order, find_order
from solvers.kernel.memory import Memory, Sizes, allocate, integer_view, view
from solvers.kernel.numbers import EPS, FULL_RANK

KINDS = ("auto", "dense", "band", "sparse")
CODES = {"inverse": mem.KIND_INVERSE, "band": mem.KIND_BAND, "dense": mem.KIND_DENSE, "sparse": mem.KIND_CALLBACK}
NARROW = 64  # diagonals up to which a band is taken without measuring SuperLU's fill
BAND_GAIN = 5.0  # entries of a band that cost as much as one of SuperLU, which has indices
MAX_FILL = 0.3  # fill relative to the full matrix above which sparse LU is slower than dense
OUTSIDE_COST = 4.0  # cost of a factorisation in Python, in iterations
NO_ORDER = Order(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4), np.int64))


class SuperLU:
    """Factorisations, in two places, of matrices (size, size) with entries at ``rows`` and ``columns`` (entries,).

    Columns are ordered by COLAMD: MMD_AT_PLUS_A, made for symmetric patterns with pivots on the diagonal, meets zeros
    there and fills in without bound when it pivots.
    """

    def __init__(self, rows: Indices, columns: Indices, size: int) -> None:
        self._places, self._size = (rows, columns), size
        self._made: list[Any] = [None, None]

    def codes(self, callbacks: Callbacks) -> dict[str, tuple[int, int]]:
        """Addresses of the callbacks for the loops, by name."""
        weak: Any = weakref.proxy(self)  # callbacks may outlive this object and must not keep its factors
        factor = callbacks.entry(lambda *at: weak.factor(*at), 3, ((1,), self._places[0].shape))
        solve = callbacks.entry(lambda *at: weak.solve(*at), self._size, ((1,), (self._size,)))
        return {"factor": (factor, 0), "solve": (solve, 0)}

    def factor(self, lu: Vector, entries: Vector) -> Vector:
        """Factorise into place ``lu``; (1 on success or 0, least magnitude of a pivot, rank)."""
        matrix: Any = sp.csc_array((entries, self._places), shape=(self._size, self._size))
        matrix.eliminate_zeros()
        try:
            made = splu(matrix, permc_spec="COLAMD")
        except RuntimeError:  # raised by SuperLU for a zero pivot
            return np.array([0.0, 0.0, self._size - 1.0])
        self._made[int(lu[0])] = made
        pivots = np.abs(made.U.diagonal())
        return np.array([1.0, pivots.min(), np.sum(pivots > FULL_RANK * EPS * pivots.max())])

    def solve(self, lu: Vector, right: Vector) -> Vector:
        """Solve with the factors in ``lu`` for ``right`` (size,)."""
        return self._made[int(lu[0])].solve(right)

    @property
    def nbytes(self) -> int:
        """Bytes of the factors, 12 an entry."""
        return sum(12 * made.nnz for made in self._made if made is not None)

    def fill(self) -> int:
        """Number of entries of the factors, measured with random values."""
        made = self.factor(np.zeros(1), 1.0 + np.random.default_rng(0).random(self._places[0].size))
        return int(self._made[0].nnz) if made[0] > 0.0 else self._size * self._size


@dataclass(frozen=True)
class Analysis:
    """Pattern of [matrix; dq1/dx; dv1/dx] and the linear algebra chosen for it."""

    size: int  #: unknowns
    rows: Indices  #: (entries,) ascending, those of the matrix first
    columns: Indices  #: (entries,)
    maps: int  #: number of rows of dq1/dx over dv1/dx, 2n
    targets: Indices  #: (computed,) positions in [residual; entries] of the matrix function's results
    constants: Vector  #: (size + entries,) values of the constant ones
    kind: str = "dense"  #: or "inverse", "band", "sparse"
    reason: str = "asked for"  #: reason for this kind
    order: Order = NO_ORDER  #: order of rows and columns of a band

    @property
    def own(self) -> int:
        """Number of entries of the matrix itself."""
        return int(np.searchsorted(self.rows, self.size))

    @property
    def storage(self) -> int:
        """Length of the stored factors."""
        return {"band": self.order.storage, "dense": self.size**2}.get(self.kind, 0)

    @property
    def inverse(self) -> int:
        """Length of the explicit inverse, 0 if none is used."""
        return self.size**2 if self.kind == "inverse" or (self.storage and self.size <= MAX_INVERTED) else 0

    @property
    def matrix_cost(self) -> float:
        """Cost of evaluating and factorising the matrix, in iterations, estimated from operation counts."""
        if self.kind != "band":
            return OUTSIDE_COST
        _, count, lower, upper = self.order.blocks.T
        made = self.targets.size + self.storage + self.factor_cost
        return made / (self.rows.size + self.size + int((count * (2 * lower + upper)).sum()))

    @property
    def factor_cost(self) -> float:
        """Multiplications of a factorisation in these loops: infinite for SuperLU, which is outside."""
        if self.kind == "sparse":
            return np.inf
        _, count, lower, upper = self.order.blocks.T
        return self.size**3 / 3.0 if self.kind == "dense" else float((count * lower * (lower + upper)).sum())

    def sections(self) -> dict[str, Any]:
        """Integer sections of the loops' memory, by name."""
        own, size = self.own, self.size
        starts = np.searchsorted(self.rows[own:] - size, np.arange(self.maps + 1))
        named = {"targets": self.targets, "map_starts": starts, "map_columns": self.columns[own:]}
        named["row_starts"] = np.searchsorted(self.rows[:own], np.arange(size + 1))
        i, j = self.rows[:own], self.columns[:own]
        if not self.storage:
            return named
        if self.kind == "dense":
            return named | {"inside": np.arange(own), "places": i.astype(np.int64) + j.astype(np.int64) * size}
        return named | self._blocks(np.argsort(self.order.rows)[i], np.argsort(self.order.columns)[j])

    def _blocks(self, i: Indices, j: Indices) -> dict[str, Any]:
        """Positions in band storage of entries at permuted ``i`` and ``j`` (own,), and the entries that couple blocks."""
        order = self.order
        block = np.searchsorted(order.blocks[:, 0], np.arange(self.size), side="right") - 1
        start, count, lower, upper = order.blocks.T
        height = 2 * lower + upper + 1
        offset = np.concatenate([[0], np.cumsum(count * height)])
        inside, b = block[i] == block[j], block[j]
        outside = np.flatnonzero(~inside)
        outside = outside[np.argsort(i[outside], kind="stable")]
        return {
            "inside": np.flatnonzero(inside),
            "places": (offset[b] + (j - start[b]) * height[b] + lower[b] + upper[b] + i - j)[inside],
            "outside": outside,
            "starts": np.searchsorted(i[outside], np.arange(self.size + 1)),
            "coupled": j[outside],
            "rows": order.rows,
            "columns": order.columns,
            "blocks": order.blocks.ravel(),
        }

    def memory(self, *, by_entries: bool = False, **sizes: int) -> Memory:
        """Memory of the loops for this matrix and the other ``sizes``, with constants filled in.

        ``by_entries``: include the positions of the entries, for :mod:`~solvers.kernel.entries`.
        """
        sections = self.sections()
        if by_entries:
            sections |= {"entry_rows": self.rows, "entry_columns": self.columns}
        own = {"matrix": self.own, "maps": self.rows.size - self.own, "couplings": len(sections.get("outside", ()))}
        kept = {"storage": self.storage, "inverse": self.inverse}
        z = allocate(Sizes(**sizes, **own, **kept, size=self.size, sections=sections))
        view(z, mem.VALUES)[:] = self.constants
        z.i[mem.KIND], z.i[mem.OWN] = CODES[self.kind], self.own
        z.i[mem.DGETRF], z.i[mem.DGETRS] = address_of("dgetrf"), address_of("dgetrs")
        integer_view(z, mem.LAPACK)[:] = self.size, 1, ord("N"), 0
        integer_view(z, mem.LEVEL_LAPACK)[:] = view(z, mem.LEVEL_X).size, 1, ord("T"), 0
        return z

    def outside(self) -> SuperLU | None:
        """SuperLU for a sparse matrix, else None."""
        return SuperLU(self.rows[: self.own], self.columns[: self.own], self.size) if self.kind == "sparse" else None


def of_code(matrix: Native, size: int, n: int, linsolver: str, small: int) -> Analysis:
    """Analysis of a matrix computed by machine code; up to ``small`` unknowns use an explicit inverse."""
    flat = np.union1d(matrix.varying, np.flatnonzero(matrix.constants))
    flat = flat[flat >= size]  # entries of matrix and maps, row by row
    places = np.concatenate([np.arange(size), flat])
    targets = np.searchsorted(places, matrix.varying)
    entries = Analysis(size, flat // size - 1, flat % size, 2 * n, targets, matrix.constants[places])
    if linsolver == "auto" and size <= small:
        return replace(entries, kind="inverse", reason=f"up to {small} unknowns")
    return chosen(entries, linsolver, measured=False)


def of_pattern(pattern: Pattern, size: int, linsolver: str, matrix: Native | None = None) -> Analysis:
    """Analysis of a sparse derivative, whose entries follow the residual; ``matrix``: machine code of varying entries."""
    rows, columns = (np.asarray(indices, dtype=np.int64) for indices in (pattern.rows, pattern.columns))
    total = size + rows.size
    targets, constants = (np.arange(total), np.zeros(total)) if matrix is None else (matrix.varying, matrix.constants)
    entries = Analysis(size, rows, columns, pattern.shape[0] - size, targets, constants)
    return chosen(entries, linsolver, measured=True)


def full(size: int, n: int, linsolver: str, reason: str) -> Analysis:
    """Analysis of a full matrix."""
    rows, columns = (x.ravel() for x in np.indices((size + 2 * n, size)))
    entries = Analysis(size, rows, columns, 2 * n, np.arange(size + rows.size), np.zeros(size + rows.size), reason=reason)
    return entries if linsolver in ("auto", "dense") else chosen(entries, linsolver, measured=False)


def chosen(entries: Analysis, linsolver: str, *, measured: bool) -> Analysis:
    """``entries`` with the linear solver asked for, or with "auto" the cheapest, by band and ``measured`` fill."""
    if linsolver == "dense":
        return entries
    size, rows, columns = entries.size, entries.rows[: entries.own], entries.columns[: entries.own]
    order = find_order(rows, columns, size)
    shape = f"{rows.size} entries; blocks of {order.text} diagonals after reverse Cuthill-McKee"
    band, sparse = (replace(entries, kind="band", reason=shape, order=order), replace(entries, kind="sparse", reason=shape))
    if linsolver == "sparse":
        return sparse
    if linsolver == "band" or (measured and order.storage <= NARROW * size):
        return band
    if not measured and order.storage > size * size:
        return replace(entries, reason=f"{shape}, more than the full matrix")
    filled = SuperLU(rows, columns, size).fill() if measured else order.storage
    if measured and min(filled, order.storage) > MAX_FILL * size * size:
        return replace(entries, reason=f"{filled} entries of {size} x {size} fill in")
    return band if order.storage <= BAND_GAIN * filled else replace(sparse, reason=f"{shape}; SuperLU fills {filled}")
