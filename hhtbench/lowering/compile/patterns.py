"""Which entries of a derivative can be nonzero, and columns that share an evaluation: by ``asdex``.

``asdex`` reads the dependencies off the computation itself (its jaxpr), for all arguments at once; nothing is probed, so no
entry is missed because it happens to vanish at the start, and no dense matrix is made.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from hhtbench.arguments import Vector

Indices = npt.NDArray[np.integer[Any]]


@dataclass(frozen=True)
class Pattern:
    """Places of the entries of one derivative, row by row, and the colours of its columns."""

    shape: tuple[int, int]
    rows: Indices  #: (entries,) int32, ascending
    columns: Indices  #: (entries,) int32, ascending within a row
    colour: Indices  #: (columns,) int32: columns of one colour have no row in common
    colours: int  #: directional derivatives that one evaluation costs

    @property
    def entries(self) -> int:
        """Number of entries."""
        return int(self.rows.size)

    @property
    def places(self) -> Indices:
        """(entries,) where each entry stands in the compressed derivative (colours, rows), flattened."""
        return self.colour[self.columns].astype(np.int64) * self.shape[0] + self.rows

    def matrix(self, values: Vector) -> sp.csr_array:
        """The derivative (rows, columns) from its entries ``values`` (entries,)."""
        starts = np.searchsorted(self.rows, np.arange(self.shape[0] + 1)).astype(np.int32)
        return sp.csr_array((values, self.columns, starts), shape=self.shape)


def detect(function: Callable[..., Any], x: Any, *rest: Any) -> Pattern:
    """The pattern of the derivative by x (size,) of the JAX function ``function(x, *rest)`` (rows,), for all arguments."""
    import asdex  # it loads Numba, a tenth of a second that few need

    found = asdex.jacobian_sparsity(function, x, *rest, argnums=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", asdex.DenseColoringWarning)  # who asks decides by ``colours``
        coloured = asdex.jacobian_coloring_from_sparsity(found, mode="fwd")
    order = np.lexsort((found.cols, found.rows))
    rows, columns = np.asarray(found.rows)[order], np.asarray(found.cols)[order]
    colour = np.maximum(np.asarray(coloured.colors), 0)  # a column without entries needs none
    return Pattern(found.shape, rows.astype(np.int32), columns.astype(np.int32), colour, max(int(coloured.num_colors), 1))
