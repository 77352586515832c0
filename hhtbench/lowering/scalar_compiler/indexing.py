"""Rules of ``gather`` and of the scatters, with known indices, by XLA's definition of both."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from hhtbench.lowering.scalar_compiler.elementwise import choose
from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.movement import corner, known_indices, together
from hhtbench.lowering.scalar_compiler.values import Nodes, Value, folded, lift


@rule("gather")
def _gather(ctx: Interpreter, equation: Any, x: Value, indices: Value) -> list[Value]:
    nodes = lift(ctx.graph, x)
    given = equation.params["fill_value"]
    fill = {"float": np.nan, "bool": True, "int": np.iinfo(np.int64).min}[nodes.kind] if given is None else given
    outside = ctx.graph.constants(np.asarray(fill, dtype=bool if nodes.kind == "bool" else float))
    where = folded(ctx.graph, indices)
    if isinstance(where, np.ndarray):
        return [Nodes(_gathered(equation, nodes.ids, where, outside), nodes.kind)]
    return [Nodes(_searched(ctx.graph, equation, nodes.ids, lift(ctx.graph, where).ids, outside), nodes.kind)]


def _searched(graph: Graph, equation: Any, x: np.ndarray, indices: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Places that depend on the arguments: every place they may mean is read, and one is chosen."""
    p = equation.params
    mapped = [int(axis) for axis in p["dimension_numbers"].start_index_map]
    if len(mapped) != 1:
        raise NotNative("places in more than one axis that depend on the arguments")
    last = x.shape[mapped[0]] - p["slice_sizes"][mapped[0]]
    cases = [_gathered(equation, x, np.full(indices.shape, i), outside) for i in range(last + 1)]
    shape, offset = tuple(equation.outvars[0].aval.shape), p["dimension_numbers"].offset_dims
    at = np.broadcast_to(indices.reshape([1 if axis in offset else size for axis, size in enumerate(shape)]), shape)
    result = choose(graph, Nodes(at, "int"), cases)
    if p["mode"] not in (GatherScatterMode.FILL_OR_DROP, None):
        return result
    low, high = np.int64(graph.constant(0.0)), np.int64(graph.constant(float(last)))
    inside = graph.elementwise("and", graph.elementwise("ge", at, low), graph.elementwise("le", at, high))
    return graph.elementwise("select", inside, result, outside)


def _gathered(equation: Any, x: np.ndarray, indices: np.ndarray, outside: np.ndarray) -> np.ndarray:
    p = equation.params
    numbers, sizes = p["dimension_numbers"], p["slice_sizes"]
    offset = [int(axis) for axis in numbers.offset_dims]
    dropped = {int(axis) for axis in (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)}
    kept = [size for axis, size in enumerate(sizes) if axis not in dropped]
    batch = indices.shape[:-1]
    pieces = np.empty((*batch, *kept), dtype=x.dtype)
    pairs = numbers.operand_batching_dims, numbers.start_indices_batching_dims
    for at, start in _starts(indices, numbers.start_index_map, x.ndim, pairs):
        dropped_outside = p["mode"] in (GatherScatterMode.FILL_OR_DROP, None) and not _inside(start, sizes, x.shape)
        pieces[at] = outside if dropped_outside else x[corner(start, sizes, x.shape)].reshape(kept)
    others = [axis for axis in range(pieces.ndim) if axis not in offset]
    order = np.argsort([*others, *offset])
    return pieces.transpose(order)


def _starts(indices: np.ndarray, mapped: Any, rank: int, pairs: Any) -> Iterator[tuple[tuple[int, ...], list[int]]]:
    """Every place of the batch, and the corner in the operand that belongs to it."""
    operand_axes, index_axes = pairs
    for at in np.ndindex(*indices.shape[:-1]):
        start = [0] * rank
        for axis, value in zip(mapped, indices[at], strict=True):
            start[int(axis)] = int(value)
        for axis, place in zip(operand_axes, index_axes, strict=True):
            start[int(axis)] = at[int(place)]
        yield at, start


def _inside(start: Any, sizes: Any, shape: Any) -> bool:
    return all(0 <= i <= whole - size for i, size, whole in zip(start, sizes, shape, strict=True))


COMBINE = {"scatter-add": "add", "scatter-sub": "sub", "scatter-mul": "mul", "scatter-min": "min", "scatter-max": "max"}


@rule("scatter", *COMBINE)
def _scatter(ctx: Interpreter, equation: Any, x: Value, indices: Value, updates: Value) -> list[Value]:
    (ids, new), kind = together(ctx, (x, updates))
    (where,) = known_indices(ctx, (indices,))
    name = COMBINE.get(equation.primitive.name)
    if name is not None and kind == "bool":
        raise NotNative("a scatter of booleans")
    combine = (lambda a, b: b) if name is None else (lambda a, b: ctx.graph.elementwise(name, a, b))
    return [Nodes(_scattered(equation, ids, where, new, combine), kind)]


def _scattered(equation: Any, x: np.ndarray, indices: np.ndarray, updates: np.ndarray, combine: Any) -> np.ndarray:
    p = equation.params
    numbers = p["dimension_numbers"]
    window = [int(axis) for axis in numbers.update_window_dims]
    others = [axis for axis in range(updates.ndim) if axis not in window]
    pieces = updates.transpose([*others, *window])
    dropped = {int(axis) for axis in (*numbers.inserted_window_dims, *numbers.operand_batching_dims)}
    kept = iter(pieces.shape[len(others) :])
    sizes = [1 if axis in dropped else next(kept) for axis in range(x.ndim)]
    result = x.copy()
    pairs = numbers.operand_batching_dims, numbers.scatter_indices_batching_dims
    for at, start in _starts(indices, numbers.scatter_dims_to_operand_dims, x.ndim, pairs):
        if p["mode"] == GatherScatterMode.CLIP or _inside(start, sizes, x.shape):
            place = corner(start, sizes, x.shape)
            result[place] = combine(result[place], pieces[at].reshape(sizes))
    return result
