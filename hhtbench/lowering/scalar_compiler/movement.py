"""Rules of the primitives that only move entries: each acts on an array of nodes as on an array of numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.elementwise import choose
from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.values import Nodes, Value, folded, lift

Move = Callable[..., np.ndarray]


def movement(*names: str) -> Callable[[Move], Move]:
    """Registers ``move(equation, array)`` of an array of nodes."""

    def register(move: Move) -> Move:
        @rule(*names)
        def on_nodes(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
            nodes = lift(ctx.graph, x)
            return [Nodes(move(equation, nodes.ids), nodes.kind)]

        return move

    return register


def _shape(equation: Any) -> tuple[int, ...]:
    return tuple(equation.outvars[0].aval.shape)


@movement("broadcast_in_dim")
def _broadcast(equation: Any, x: np.ndarray) -> np.ndarray:
    shape, axes = _shape(equation), equation.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for size, axis in zip(x.shape, axes, strict=True):
        spread[axis] = size
    return np.broadcast_to(x.reshape(spread), shape)


@movement("reshape", "squeeze")
def _reshape(equation: Any, x: np.ndarray) -> np.ndarray:
    order = equation.params.get("dimensions") if equation.primitive.name == "reshape" else None
    return (x if order is None else x.transpose(order)).reshape(_shape(equation))


@movement("transpose")
def _transpose(equation: Any, x: np.ndarray) -> np.ndarray:
    return x.transpose(equation.params["permutation"])


@movement("rev")
def _rev(equation: Any, x: np.ndarray) -> np.ndarray:
    return np.flip(x, equation.params["dimensions"])


@movement("slice")
def _slice(equation: Any, x: np.ndarray) -> np.ndarray:
    p = equation.params
    strides = p["strides"] or (1,) * x.ndim
    return x[tuple(slice(a, b, c) for a, b, c in zip(p["start_indices"], p["limit_indices"], strides, strict=True))]


@movement("tile")
def _tile(equation: Any, x: np.ndarray) -> np.ndarray:
    return np.tile(x, equation.params["reps"])


def together(ctx: Interpreter, inputs: Any) -> tuple[list[np.ndarray], str]:
    """Several values as nodes of one kind."""
    lifted = [lift(ctx.graph, value) for value in inputs]
    if len({value.kind for value in lifted}) != 1:
        raise NotNative("values of two kinds in one array")
    return [value.ids for value in lifted], lifted[0].kind


@rule("concatenate", "stack")
def _join(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    ids, kind = together(ctx, inputs)
    if equation.primitive.name == "stack":
        return [Nodes(np.stack(ids, equation.params["axis"]), kind)]
    return [Nodes(np.concatenate(ids, equation.params["dimension"]), kind)]


@rule("split")
def _split(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    p, nodes = equation.params, lift(ctx.graph, x)
    return [Nodes(part, nodes.kind) for part in np.split(nodes.ids, np.cumsum(p["sizes"])[:-1], p["axis"])]


@rule("pad")
def _pad(ctx: Interpreter, equation: Any, padded: Value, fill: Value) -> list[Value]:
    """Low and high edges, which may be negative, and gaps between entries."""
    (x, value), kind = together(ctx, (padded, fill))
    config = equation.params["padding_config"]
    spread = np.full([size + max(size - 1, 0) * gap for size, (_, _, gap) in zip(x.shape, config, strict=True)], value)
    spread[tuple(slice(None, None, gap + 1) for _, _, gap in config)] = x
    result = np.full([s + max(a, 0) + max(b, 0) for s, (a, b, _) in zip(spread.shape, config, strict=True)], value)
    result[tuple(slice(max(a, 0), max(a, 0) + s) for s, (a, _, _) in zip(spread.shape, config, strict=True))] = spread
    kept = tuple(slice(max(-a, 0), s - max(-b, 0)) for s, (a, b, _) in zip(result.shape, config, strict=True))
    return [Nodes(result[kept], kind)]


@rule("dynamic_slice")
def _dynamic_slice(ctx: Interpreter, equation: Any, x: Value, *start: Value) -> list[Value]:
    nodes, sizes = lift(ctx.graph, x), equation.params["slice_sizes"]
    ids = nodes.ids
    for axis, (value, size) in enumerate(zip(start, sizes, strict=True)):  # one axis after the other
        at = folded(ctx.graph, value)
        places = [np.take(ids, range(i, i + size), axis) for i in range(ids.shape[axis] - size + 1)]
        if isinstance(at, np.ndarray):
            ids = places[min(max(int(at), 0), len(places) - 1)]
        else:
            ids = choose(ctx.graph, lift(ctx.graph, at), places)
    return [Nodes(ids, nodes.kind)]


def known_indices(ctx: Interpreter, values: Any) -> list[np.ndarray]:
    """Indices, which must not depend on the arguments."""
    known = [folded(ctx.graph, lift(ctx.graph, value)) for value in values]
    if not all(isinstance(value, np.ndarray) for value in known):
        raise NotNative("a place that depends on the arguments")
    return known  # type: ignore[return-value]


def corner(start: Any, sizes: Any, shape: Any) -> tuple[slice, ...]:
    """Where a piece of ``sizes`` lies that begins at ``start``, or as near to it as ``shape`` lets it."""
    first = [min(max(int(i), 0), whole - size) for i, size, whole in zip(start, sizes, shape, strict=True)]
    return tuple(slice(i, i + size) for i, size in zip(first, sizes, strict=True))


@rule("dynamic_update_slice")
def _update_slice(ctx: Interpreter, equation: Any, x: Value, update: Value, *start: Value) -> list[Value]:
    (ids, new), kind = together(ctx, (x, update))
    result = ids.copy()
    result[corner(known_indices(ctx, start), new.shape, ids.shape)] = new
    return [Nodes(result, kind)]


@rule("iota")
def _iota(ctx: Interpreter, equation: Any) -> list[Value]:
    p = equation.params
    line = np.arange(p["shape"][p["dimension"]])
    spread = [-1 if axis == p["dimension"] else 1 for axis in range(len(p["shape"]))]
    return [np.broadcast_to(line.reshape(spread), p["shape"])]
