"""Sparse derivatives of a large system's functions: one compiled call gives the values and the entries of the derivative."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from hhtbench.arguments import Vector
from hhtbench.counting import preparing
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.compile.patterns import Pattern, detect
from hhtbench.lowering.compile.routes import Compilable
from hhtbench.lowering.flattening import flat_function

_patterns = Cache(16)  # that of a chain of ten thousand links takes seconds to find


def pattern_of(
    function: Callable[..., Any], dynamics: Compilable, static: tuple[Any, ...], example: tuple[Any, ...]
) -> Pattern:
    """The pattern of the derivative of ``function(dynamics, *static, x, *rest)`` by x, whatever the parameter values.

    ``example`` holds arrays of the shapes of x and of the rest.
    """
    flat = flat_function(function, dynamics, *static)
    arrays = [jnp.asarray(array, dtype=float) for array in example]

    def find() -> Pattern:
        with preparing(f"finding the sparsity of {getattr(function, '__name__', 'a function')}"):
            return detect(lambda x, *rest: flat.function(rest[0], x, *rest[1:]), arrays[0], flat.parameters, *arrays[1:])

    return _patterns.find(flat.key, find)


def value_and_entries(
    dynamics: Compilable, function: Callable[..., Any], static: tuple[Any, ...], colours: int, *arguments: Any
) -> Any:
    """Values (rows,) and derivative entries (entries,) of ``function(dynamics, *static, x, *rest)`` by x, one vector.

    ``arguments`` are the colour of every column (size,), the place of every entry (entries,), x and the rest.  One
    directional derivative per colour, all of them together: cost and memory are those of ``colours`` evaluations.
    """
    colour, places, x, *rest = arguments
    value, along = jax.linearize(lambda y: function(dynamics, *static, y, *rest), x)
    seeds = (colour[None, :] == jnp.arange(colours)[:, None]).astype(x.dtype)
    compressed = jax.vmap(along)(seeds)
    return jnp.concatenate([value, compressed.ravel()[places]])


class Coloured:
    """A function of a JAX dynamics with its sparse derivative by the first array; the pattern is found once."""

    def __init__(self, function: Callable[..., Any], dynamics: Compilable, *static: Any, example: tuple[Any, ...]) -> None:
        self.pattern: Pattern = pattern_of(function, dynamics, static, example)
        compiled = compile_function(value_and_entries, dynamics, function, static, self.pattern.colours, route="xla")
        where = jnp.asarray(self.pattern.colour), jnp.asarray(self.pattern.places)
        self.packed = partial(compiled, *where)  #: arrays -> values (rows,), then entries (entries,)

    def __call__(self, *arrays: Any) -> tuple[Vector, sp.csr_array]:
        """Values (rows,) and derivative (rows, size)."""
        values = np.asarray(self.packed(*arrays))
        rows = self.pattern.shape[0]
        return values[:rows], self.pattern.matrix(values[rows:])
