"""Rules of the primitives that only move entries: each acts on an array of nodes as on an array of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from hhtbench.lowering.scalar_compiler.elementwise import choose
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Nodes, Value, made, rule
from hhtbench.lowering.scalar_compiler.store import Ids, NotNative


def _broadcast(shape: Any, p: Any, x: Ids) -> Ids:
    spread = [1] * len(shape)
    for size, axis in zip(x.shape, p["broadcast_dimensions"], strict=True):
        spread[axis] = size
    return np.broadcast_to(x.reshape(spread), shape)


def _slice(shape: Any, p: Any, x: Ids) -> Ids:
    return x[tuple(map(slice, p["start_indices"], p["limit_indices"], p["strides"] or (1,) * x.ndim))]


def _pad(shape: Any, p: Any, x: Ids, fill: Ids) -> Ids:
    """Low and high edges, which may be negative, and gaps between entries."""
    result, to, of = np.full(shape, fill), [], []
    for size, whole, (low, _, gap) in zip(x.shape, shape, p["padding_config"], strict=True):
        place = low + (gap + 1) * np.arange(size)
        inside = (place >= 0) & (place < whole)
        to.append(place[inside])
        of.append(np.flatnonzero(inside))
    result[np.ix_(*to)] = x[np.ix_(*of)]
    return result


MOVES: dict[str, Callable[..., Ids]] = {  # of the result's shape, the parameters and arrays of nodes
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda shape, p, *parts: np.concatenate(parts, p["dimension"]),
    "pad": _pad,
    "reshape": lambda shape, p, x: (x if p["dimensions"] is None else x.transpose(p["dimensions"])).reshape(shape),
    "rev": lambda shape, p, x: np.flip(x, p["dimensions"]),
    "slice": _slice,
    "squeeze": lambda shape, p, x: x.reshape(shape),
    "stack": lambda shape, p, *parts: np.stack(parts, p["axis"]),
    "tile": lambda shape, p, x: np.tile(x, p["reps"]),
    "transpose": lambda shape, p, x: x.transpose(p["permutation"]),
}


@rule(*MOVES)
def _moved(ctx: Interpreter, equation: Any, *parts: Value) -> list[Value]:
    move, how = MOVES[equation.primitive.name], (equation.outvars[0].aval.shape, equation.params)
    if all(isinstance(part, np.ndarray) for part in parts):  # a table of places has a million numbers
        return [move(*how, *parts)]
    return made(equation, move(*how, *ctx.together(parts)))


@rule("split")
def _split(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    p = equation.params
    return made(equation, *np.split(ctx.lift(x).ids, np.cumsum(p["sizes"])[:-1], p["axis"]))


@rule("unstack")
def _unstack(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    return made(equation, *np.moveaxis(ctx.lift(x).ids, equation.params["axis"], 0))


@rule("iota")
def _iota(ctx: Interpreter, equation: Any) -> list[Value]:
    return [np.indices(equation.params["shape"])[equation.params["dimension"]]]


@rule("dynamic_slice")
def _dynamic_slice(ctx: Interpreter, equation: Any, x: Value, *start: Value) -> list[Value]:
    ids = ctx.lift(x).ids
    for axis, (value, size) in enumerate(zip(start, equation.params["slice_sizes"], strict=True)):  # one after the other
        at, last = ctx.folded(value), ids.shape[axis] - size
        firsts = [min(max(int(at), 0), last)] if isinstance(at, np.ndarray) else range(last + 1)
        cases = [np.take(ids, range(first, first + size), axis) for first in firsts]
        ids = cases[0] if isinstance(at, np.ndarray) else choose(ctx.graph, ctx.lift(at), cases)
    return made(equation, ids)


@rule("dynamic_update_slice")
def _update_slice(ctx: Interpreter, equation: Any, x: Value, update: Value, *start: Value) -> list[Value]:
    ids, new = ctx.together((x, update))
    at = [int(ctx.known(value)) for value in start]
    first = np.clip(at, 0, np.subtract(ids.shape, new.shape))
    result = ids.copy()
    result[tuple(map(slice, first, first + new.shape))] = new
    return made(equation, result)


def _windows(indices: np.ndarray, mapped: Any, batched: Any, sizes: Any, shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of ``sizes`` of an array of ``shape`` by XLA's definition of gather and scatter, moved inside if need be.

    (*batch, entries) the places of their entries in the flattened array, and (*batch,) whether a piece lay inside.
    """
    batch, rank = indices.shape[:-1], len(shape)
    starts = np.zeros((*batch, rank), dtype=np.int64)
    starts[..., list(mapped)] = indices
    for axis, place in zip(*batched, strict=True):
        starts[..., axis] = np.indices(batch)[place]
    first = np.clip(starts, 0, np.subtract(shape, sizes))
    strides = np.array([math.prod(shape[axis + 1 :]) for axis in range(rank)], dtype=np.int64)
    offsets = strides @ np.indices(sizes).reshape(rank, -1)
    return (first @ strides)[..., None] + offsets, np.all(first == starts, axis=-1)


@rule("gather")
def _gather(ctx: Interpreter, equation: Any, x: Value, indices: Value) -> list[Value]:
    nodes, given = ctx.lift(x), equation.params["fill_value"]
    fill = {"float": np.nan, "bool": True, "int": np.iinfo(np.int64).min}[nodes.kind] if given is None else given
    outside = ctx.graph.constants(np.asarray(fill, dtype=bool if nodes.kind == "bool" else float))
    where = ctx.folded(indices)
    if isinstance(where, np.ndarray):
        return made(equation, _gathered(equation, nodes.ids, where, outside))
    return made(equation, _searched(ctx.graph, equation, nodes.ids, ctx.lift(where).ids, outside))


def _gathered(equation: Any, x: Ids, indices: np.ndarray, outside: Ids) -> Ids:
    p = equation.params
    numbers, sizes, batch = p["dimension_numbers"], p["slice_sizes"], indices.shape[:-1]
    batched = numbers.operand_batching_dims, numbers.start_indices_batching_dims
    places, inside = _windows(indices, numbers.start_index_map, batched, sizes, x.shape)
    found = x.ravel()[places]
    if p["mode"] in (GatherScatterMode.FILL_OR_DROP, None):
        found = np.where(inside[..., None], found, outside)
    dropped = *numbers.collapsed_slice_dims, *numbers.operand_batching_dims
    pieces = found.reshape((*batch, *(size for axis, size in enumerate(sizes) if axis not in dropped)))
    return np.moveaxis(pieces, range(len(batch), pieces.ndim), numbers.offset_dims)


def _searched(graph: Graph, equation: Any, x: Ids, indices: Ids, outside: Ids) -> Ids:
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


def _turns(places: np.ndarray) -> list[np.ndarray]:
    """The entries of ``places`` (k,) as turns in which none comes twice: the first of each, the second, and so on."""
    order = np.argsort(places, kind="stable")
    count = np.arange(places.size)
    starts = np.diff(places[order], prepend=-1) != 0
    turn = count - np.maximum.accumulate(np.where(starts, count, 0))
    return np.split(order[np.argsort(turn, kind="stable")], np.cumsum(np.bincount(turn))[:-1])


COMBINE = {"scatter-add": "add", "scatter-sub": "sub", "scatter-mul": "mul", "scatter-min": "min", "scatter-max": "max"}


@rule("scatter", *COMBINE)
def _scatter(ctx: Interpreter, equation: Any, x: Value, indices: Value, updates: Value) -> list[Value]:
    ids, new = ctx.together((x, updates))
    where, combine = ctx.known(indices), COMBINE.get(equation.primitive.name)
    if combine is not None and equation.outvars[0].aval.dtype == bool:
        raise NotNative("a scatter of booleans")
    numbers, mode = equation.params["dimension_numbers"], equation.params["mode"]
    window = numbers.update_window_dims
    pieces = np.moveaxis(new, window, range(-len(window), 0))
    dropped = *numbers.inserted_window_dims, *numbers.operand_batching_dims
    kept = iter(pieces.shape[pieces.ndim - len(window) :])
    sizes = [1 if axis in dropped else next(kept) for axis in range(ids.ndim)]
    batched = numbers.operand_batching_dims, numbers.scatter_indices_batching_dims
    places, inside = _windows(where, numbers.scatter_dims_to_operand_dims, batched, sizes, ids.shape)
    used = inside | (mode == GatherScatterMode.CLIP)
    result, at, piece = ids.flatten(), places[used].ravel(), pieces.reshape(places.shape)[used].ravel()
    for turn in _turns(at):
        result[at[turn]] = piece[turn] if combine is None else ctx.graph.elementwise(combine, result[at[turn]], piece[turn])
    return made(equation, result.reshape(ids.shape))
