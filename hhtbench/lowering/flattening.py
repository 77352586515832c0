"""Flatten a pytree: parameters as one vector, and a key that selects the compiled code of its functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, Concatenate, NamedTuple, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from hhtbench.lowering.caching import Cache, by_id

Tree = TypeVar("Tree")  #: a pytree of parameters and of what is no number: a dynamics
_jitted = Cache(4096)
_flattened = Cache(64)


class _Flattened(NamedTuple):
    flat: Any  #: one argument: forty of them would cost more than the function
    unravel: Callable[[Any], Any]
    rest: Any
    key: Any


class Flat(NamedTuple):
    """A function of a pytree with the pytree's parameters as its first argument, uncompiled."""

    name: str
    function: Callable[..., Any]  #: (parameters, *arrays) -> array
    parameters: Any  #: (k,)
    key: Any  #: equal for functions that differ in parameter values only


def flat_function(function: Callable[Concatenate[Tree, ...], Any], tree: Tree, *static: Hashable) -> Flat:
    """``function(tree, *static, *arrays)`` as a function of the flattened parameters and the arrays."""
    parts: _Flattened = _flattened.find(by_id(tree), lambda: _flatten(tree))

    def of_parameters(flat: Any, *arguments: Any) -> Any:
        return function(eqx.combine(parts.unravel(flat), parts.rest), *static, *arguments)

    name = getattr(function, "__name__", type(function).__name__)
    return Flat(name, of_parameters, parts.flat, (function, static, parts.key))


def jitted(flat: Flat) -> Any:
    """``jax.jit`` of a flat function, shared by equal keys."""
    return _jitted.find(flat.key, lambda: jax.jit(flat.function))


def traced_once(tree: Any, method: str) -> Callable[..., Any]:
    """The ``method`` of a pytree of parameters, traced once, and so differentiated once, for all functions that call it."""
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)

    def of_arrays(arrays: Any, *arguments: Any) -> Any:
        return getattr(eqx.combine(arrays, rest), method)(*arguments)

    return partial(_jitted.find((method, _signature(rest)), lambda: jax.jit(of_arrays)), arrays)


def _flatten(tree: Any) -> _Flattened:
    """All arrays of ``tree`` as one vector, and the inverse of that.

    By NumPy for float64 arrays: ``ravel_pytree`` compiles the concatenation, 30 ms for every system.
    """
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    key = _signature(arrays), _signature(rest)
    leaves, structure = jax.tree.flatten(arrays)
    if any(leaf.dtype != np.float64 for leaf in leaves):
        return _Flattened(*ravel_pytree(arrays), rest, key)
    shapes = [np.shape(leaf) for leaf in leaves]
    bounds = [0, *np.cumsum([math.prod(shape) for shape in shapes]).tolist()]

    def unravel(vector: Any) -> Any:
        parts = [vector[a:b].reshape(shape) for a, b, shape in zip(bounds, bounds[1:], shapes, strict=False)]
        return jax.tree.unflatten(structure, parts)

    return _Flattened(np.concatenate([np.zeros(0), *map(np.ravel, leaves)]), unravel, rest, key)


def _signature(tree: Any) -> Any:
    """A hashable description of a pytree: structure and, per leaf, shape and type or the value itself."""
    leaves, structure = jax.tree.flatten(tree)
    described: list[Any] = []
    for leaf in leaves:
        if eqx.is_inexact_array(leaf):
            described.append((leaf.shape, str(leaf.dtype)))
        elif hasattr(leaf, "tobytes"):
            described.append((leaf.shape, str(leaf.dtype), np.asarray(leaf).tobytes()))
        else:
            described.append(leaf if getattr(leaf, "__hash__", None) else id(leaf))
    return structure, tuple(described)
