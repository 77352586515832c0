"""Which linear algebra serves a system: by size, by what its functions allow and by measured fill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from hhtbench.arguments import Vector
from hhtbench.errors import ProblemError
from hhtbench.lowering import Dynamics
from hhtbench.lowering.compile.coloured import Coloured
from hhtbench.lowering.compile.patterns import Pattern
from hhtbench.lowering.dynamics.matrix_free import SMALL, MatrixFree, matrix_free
from solvers.hht.blocks import find_order
from solvers.hht.discretise import step_residual_and_ends
from solvers.hht.layout import Layout
from solvers.hht.linear import KINDS, Analysis, Dense, Factor
from solvers.hht.newton import NewtonOptions
from solvers.hht.sparse import BAND_GAIN, NARROW, Band, Splu, fill, splu_factor

MATRIX_COST = 3.0, 6.0  # iterations that a new matrix costs: chains of 100 links, and of 1,000 and more
MANY = 100_000  # entries computed for it from which it is the latter: they do not fit into the nearer memories
CROWDED = 0.3  # fill, as a part of the full matrix, from which sparse LU is slower than dense


@dataclass(frozen=True)
class Choice:
    """The linear algebra of one engine."""

    linear: Analysis
    products: MatrixFree | None  #: the functions without dense matrices, where entries come from coloured derivatives
    coloured: Coloured | None  #: residual, q1, v1 and entries

    @property
    def newton(self) -> NewtonOptions:
        """What Newton's iteration is told."""
        if self.coloured is None:
            return NewtonOptions()
        computed = self.coloured.pattern.colours * self.coloured.pattern.shape[0]
        return NewtonOptions(matrix_cost=MATRIX_COST[computed > MANY], max_iterations=25)


def choose(dynamics: Dynamics, layout: Layout, linsolver: str) -> Choice:
    """The kind asked for, or with "auto" the cheapest.

    Raises
    ------
    ProblemError
        An unknown kind.
    """
    if linsolver not in KINDS:
        raise ProblemError(f"linsolver must be one of {', '.join(KINDS)}; got {linsolver!r}.")
    if linsolver == "dense" or (linsolver == "auto" and layout.size < SMALL):
        return Choice(Dense(layout.size, "asked for" if linsolver == "dense" else f"below {SMALL} unknowns"), None, None)
    products = matrix_free(dynamics)
    if products is None:
        reason = "its functions give full matrices (not a JAX system, a mass that is no diagonal, or rows left out)"
        linear: Analysis = Dense(layout.size, reason) if linsolver == "auto" else Sifted(layout.size, linsolver)
        return Choice(linear, None, None)
    example = np.zeros(layout.size), np.zeros(layout.packed_size)
    try:
        coloured = Coloured(step_residual_and_ends, products, layout, example=example)
    except NotImplementedError as error:  # a primitive whose sparsity asdex does not know
        reason = f"the pattern of its derivatives cannot be read: {error}"
        return Choice(Dense(layout.size, reason) if linsolver == "auto" else Sifted(layout.size, linsolver), None, None)
    analysis = analyse(coloured.pattern, layout.size, linsolver)
    return Choice(analysis, None, None) if analysis.kind == "dense" else Choice(analysis, products, coloured)


def analyse(pattern: Pattern, size: int, linsolver: str) -> Analysis:
    """Band or SuperLU for the matrix in the first ``size`` rows of ``pattern``; with "auto" dense too, where it fills up."""
    own = int(np.searchsorted(pattern.rows, size))
    order = find_order(pattern.rows[:own], pattern.columns[:own], size)
    shape = f"{own} entries in {pattern.colours} colours; blocks of {order.text} diagonals after reverse Cuthill-McKee"
    if linsolver == "band" or (linsolver == "auto" and order.storage <= NARROW * size):
        return Band(pattern, size, order, shape)
    if linsolver == "sparse":
        return Splu(pattern, size, shape)
    filled = fill(pattern, size)
    if min(filled, order.storage) > CROWDED * size * size:
        return Dense(size, f"{filled} entries of {size} x {size} fill in")
    if order.storage <= BAND_GAIN * filled:
        return Band(pattern, size, order, shape)
    return Splu(pattern, size, f"{shape}; SuperLU fills {filled}")


class Sifted:
    """Analysis for systems whose functions give full matrices: zeros are left out, matrix by matrix."""

    reason = "asked for; the matrix comes full and its zeros are left out"

    def __init__(self, size: int, kind: str) -> None:
        self.size, self.kind = size, kind

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """``entries``: [matrix; dq1/dx; dv1/dx] (size + 2n, size), row by row."""
        blocks = entries.reshape(-1, self.size)
        if self.kind == "sparse":
            return splu_factor(sp.csc_array(blocks[: self.size]), sp.csr_array(blocks[self.size :]), h)
        rows, columns = np.nonzero(blocks)
        pattern = Pattern(blocks.shape, rows, columns, np.zeros(self.size, dtype=np.int32), 1)
        own = int(np.searchsorted(rows, self.size))
        order = find_order(rows[:own], columns[:own], self.size)
        ends = np.zeros(blocks.shape[0] - self.size)
        return Band(pattern, self.size, order, "").factor(np.concatenate([ends, blocks[rows, columns]]), h)
