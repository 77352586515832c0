"""Sparse derivatives of large systems: one compiled call gives values and the entries of the derivative.

The sparsity is read from the scalar graph of the computation, or by ``asdex`` from its jaxpr where a primitive has no rule,
for all arguments at once.  Nothing is probed, so no entry is missed because it vanishes at the start, and no dense matrix
is made.  ``asdex`` also colours the columns that share an evaluation.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from hhtbench.lowering.caching import Cache
from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.flattening import Flat, flat_function
from hhtbench.lowering.scalar_compiler import NotNative, native, native_call, pattern_along
from hhtbench.protocol.arguments import Vector
from hhtbench.solution.counting import preparing

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.dynamics import Dynamics

Indices = npt.NDArray[np.integer[Any]]

MAX_COMPUTED = 3_000_000  # colours times rows compiled to machine code: ten thousand links take ten seconds

_patterns = Cache(16)  # finding that of a chain of ten thousand links takes seconds


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of a derivative, row by row, with colours of its columns; compared by identity."""

    shape: tuple[int, int]
    rows: Indices  #: (entries,) int32, ascending
    columns: Indices  #: (entries,) int32, ascending within a row
    colour: Indices  #: (columns,) int32: columns of one colour have no row in common
    colours: int  #: directional derivatives that one evaluation costs

    @property
    def computed(self) -> int:
        """Number of values that one evaluation of the compressed derivative computes: colours times rows."""
        return self.colours * self.shape[0]

    @property
    def places(self) -> Indices:
        """(entries,) position of each entry in the compressed derivative (colours, rows), flattened."""
        return self.colour[self.columns].astype(np.int64) * self.shape[0] + self.rows

    def matrix(self, values: Vector) -> sp.csr_array:
        """The derivative (rows, columns) from its entries ``values`` (entries,)."""
        starts = np.searchsorted(self.rows, np.arange(self.shape[0] + 1)).astype(np.int32)
        return sp.csr_array((values, self.columns, starts), shape=self.shape)


def _detected(flat: Flat, example: tuple[Any, ...]) -> Pattern:
    import asdex  # it loads Numba, a tenth of a second that few need

    x, *rest = (jnp.asarray(array, dtype=float) for array in example)

    def of_unknowns(x: Any, parameters: Any, *rest: Any) -> Any:
        return flat.function(parameters, x, *rest)

    with preparing(f"finding the sparsity of {flat.name}"), warnings.catch_warnings():
        warnings.simplefilter("ignore", asdex.DenseColoringWarning)  # who asks decides by ``colours``
        try:
            shape, rows, columns = pattern_along(flat, tuple(map(np.shape, example)))
            found = asdex.SparsityPattern.from_coo(rows, columns, shape)
        except NotNative:
            found = asdex.jacobian_sparsity(of_unknowns, x, flat.parameters, *rest, argnums=0)
        coloured = asdex.jacobian_coloring_from_sparsity(found, mode="fwd")
    order = np.lexsort((found.cols, found.rows))
    rows, columns = np.asarray(found.rows)[order], np.asarray(found.cols)[order]
    colour = np.maximum(np.asarray(coloured.colors), 0)  # a column without entries needs none
    return Pattern(found.shape, rows.astype(np.int32), columns.astype(np.int32), colour, max(int(coloured.num_colors), 1))


def find_pattern(function: Callable[..., Any], dynamics: Dynamics, *static: Any, example: tuple[Any, ...]) -> Pattern:
    """Pattern of the derivative of ``function(dynamics, *static, x, *rest)`` by x, for any parameter values; cached.

    ``example``: arrays of the shapes of x and of the rest.

    Raises
    ------
    NotImplementedError
        A primitive has no rule in the scalar graph and asdex does not know its sparsity.
    """
    flat = flat_function(function, dynamics.dependencies, *static)
    found: Pattern = _patterns.find(flat.key, lambda: _detected(flat, example))
    return found


def value_and_entries(
    dynamics: Dynamics, function: Callable[..., Any], static: tuple[Any, ...], each: Any, colours: int, *arguments: Any
) -> Any:
    """Values (rows,) and derivative entries (entries,) of ``function(dynamics, *static, x, *rest)`` by x, one vector.

    ``arguments`` are the colour of every column (size,), the position of every entry (entries,), x and the rest.  One
    directional derivative per colour: ``each`` (function, colours) computes them together, or one after the other.
    """
    colour, places, x, *rest = arguments
    value, along = jax.linearize(lambda y: function(dynamics, *static, y, *rest), x)
    compressed = each(lambda k: along((colour == k).astype(x.dtype)), jnp.arange(colours))
    return jnp.concatenate([value, jnp.take(compressed, places, mode="clip")])  # they are inside: no other mode is cheaper


def by_pattern(
    dynamics: Dynamics, pattern: Pattern, function: Callable[..., Any], static: tuple[Any, ...], *arguments: Any
) -> Any:
    """:func:`value_and_entries` with the pattern as constants in the code; ``arguments`` are x and the rest."""
    where = jnp.asarray(pattern.colour), jnp.asarray(pattern.places)
    all_at_once = lambda product, colours: jax.vmap(product)(colours)  # noqa: E731
    return value_and_entries(dynamics, function, static, all_at_once, pattern.colours, *where, *arguments)


class Coloured:
    """``function(dynamics, *static, x, *rest)`` with its sparse derivative by x, compiled by XLA.

    ``example``: arrays of the shapes of x and of the rest.
    """

    pattern: Pattern
    packed: Callable[..., Vector]  #: arrays -> values (rows,), then entries (entries,)

    def __init__(self, function: Callable[..., Any], dynamics: Dynamics, *static: Any, example: tuple[Any, ...]) -> None:
        self.pattern = find_pattern(function, dynamics, *static, example=example)
        how = jax.lax.map, self.pattern.colours  # all colours of a large system at once exceed the CPU cache
        compiled = compile_function(value_and_entries, dynamics, function, static, *how, route="xla")
        where = jnp.asarray(self.pattern.colour), jnp.asarray(self.pattern.places)
        self.packed = partial(compiled, *where)

    def __call__(self, *arrays: Any) -> tuple[Vector, sp.csr_array]:
        """Values (rows,) and derivative (rows, size)."""
        values = np.asarray(self.packed(*arrays))
        rows = self.pattern.shape[0]
        return values[:rows], self.pattern.matrix(values[rows:])


class OftenCalled(Coloured):
    """:class:`Coloured` as machine code where possible: slower to compile, faster to call, for arrays and floats only."""

    native = True  #: True if no code of XLA is called

    def __init__(self, function: Callable[..., Any], dynamics: Dynamics, *static: Any, example: tuple[Any, ...]) -> None:
        self.pattern = pattern = find_pattern(function, dynamics, *static, example=example)
        shapes = tuple(map(np.shape, example))
        try:
            if pattern.computed > MAX_COMPUTED:
                raise NotNative(f"{pattern.colours} derivatives of {pattern.shape[0]} rows")
            made: Any = native_call(native(by_pattern, dynamics, pattern, function, static, shapes=shapes), shapes)
        except NotNative:
            super().__init__(function, dynamics, *static, example=example)
            self.native = False
        else:
            self.packed = made
