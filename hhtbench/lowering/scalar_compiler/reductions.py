"""Rules of the primitives that combine many entries into one: products of matrices, reductions, running sums."""

from __future__ import annotations

from functools import partial, reduce
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import ZERO, Graph, Ids
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.operations import ELEMENTWISE
from hhtbench.lowering.scalar_compiler.values import Nodes, Value, as_numbers, lift, numbers

REDUCTIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
    "reduce_xor": "xor",
}
EMPTY = {"add": 0.0, "mul": 1.0, "max": -np.inf, "min": np.inf, "and": True, "or": False, "xor": False}
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


@rule("dot_general")
def _dot(ctx: Interpreter, equation: Any, x: Value, y: Value) -> list[Value]:
    if isinstance(x, np.ndarray) and isinstance(y, np.ndarray):
        left, right, shape = _as_matrices(equation, x, y)
        return [np.einsum("bik,bjk->bij", left, right).reshape(shape)]
    left, right, shape = _as_matrices(equation, numbers(ctx.graph, x), numbers(ctx.graph, y))
    product = [_product(ctx.graph, a, b) for a, b in zip(left, right, strict=True)]
    return [Nodes(np.array(product, dtype=np.int64).reshape(shape), "float")]


def _as_matrices(equation: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """(batch, rows, k) and (batch, columns, k), and the shape of the result."""
    (x_sum, y_sum), (x_batch, y_batch) = equation.params["dimension_numbers"]
    parts = []
    for array, summed, batch in ((x, x_sum, x_batch), (y, y_sum, y_batch)):
        free = [axis for axis in range(array.ndim) if axis not in (*summed, *batch)]
        moved = array.transpose([*batch, *free, *summed])
        sizes = [int(np.prod([array.shape[axis] for axis in axes])) for axes in (batch, free, summed)]
        parts.append(moved.reshape(sizes))
    return parts[0], parts[1], tuple(equation.outvars[0].aval.shape)


def _product(graph: Graph, x: Ids, y: Ids) -> list[list[int]]:
    """Rows of x times rows of y, summed in order; structural zeros cost nothing."""
    add, mul = graph.add, graph.mul
    result = [[ZERO] * len(y) for _ in range(len(x))]
    for left, right in zip(x.T, y.T, strict=True):
        columns = np.flatnonzero(right != ZERO).tolist()
        factors = right.tolist()
        for i in np.flatnonzero(left != ZERO).tolist():
            row, factor = result[i], int(left[i])
            for j in columns:
                row[j] = add(row[j], mul(factor, factors[j]))
    return result


@rule(*REDUCTIONS)
def _reduce(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    name, axes = REDUCTIONS[equation.primitive.name], equation.params["axes"]
    if isinstance(x, np.ndarray) and x.size and name in ELEMENTWISE:
        return [np.asarray(ELEMENTWISE[name].reduce(x, axis=tuple(axes)))]  # type: ignore[attr-defined]
    nodes = lift(ctx.graph, x)
    if nodes.kind == "bool":
        name = {"max": "or", "min": "and"}.get(name, name)
    elif name in ("and", "or", "xor"):
        raise NotNative(f"{equation.primitive.name} on bits of integers")
    ids = nodes.ids
    shape = tuple(size for axis, size in enumerate(ids.shape) if axis not in axes)
    length = int(np.prod([ids.shape[axis] for axis in axes]))
    rows = np.moveaxis(ids, axes, range(-len(axes), 0)).reshape(int(np.prod(shape)), length)
    keys = [tuple(row) for row in rows.tolist()]
    folded = {row: _fold(ctx.graph, name, row) for row in dict.fromkeys(keys)}  # most rows of derivatives are zero
    return [Nodes(np.array([folded[row] for row in keys], dtype=np.int64).reshape(shape), nodes.kind)]


def _fold(graph: Graph, name: str, row: tuple[int, ...]) -> int:
    return reduce(partial(graph.apply, name), row) if row else int(graph.constants(np.asarray(EMPTY[name])))


@rule(*RUNNING)
def _running(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    nodes, name, p = lift(ctx.graph, x), RUNNING[equation.primitive.name], equation.params
    if nodes.kind == "bool":
        raise NotNative(f"{equation.primitive.name} of booleans")
    ids = nodes.ids
    lines = np.moveaxis(np.flip(ids, p["axis"]) if p["reverse"] else ids, p["axis"], 0).copy()
    for i in range(1, len(lines)):
        lines[i] = ctx.graph.elementwise(name, lines[i - 1], lines[i])
    result = np.moveaxis(lines, 0, p["axis"])
    return [Nodes(np.flip(result, p["axis"]) if p["reverse"] else result, nodes.kind)]


@rule("argmax", "argmin")
def _argmax(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    """The first of the largest; a NaN is larger, and smaller, than any number."""
    graph, (axis,) = ctx.graph, equation.params["axes"]
    ids = as_numbers(graph, lift(graph, x))
    lines = np.moveaxis(ids, axis, 0)
    best, place = lines[0], np.full(lines.shape[1:], ZERO, dtype=np.int64)
    for i in range(1, len(lines)):
        better = graph.elementwise("gt" if equation.primitive.name == "argmax" else "lt", lines[i], best)
        is_nan, was_not = graph.elementwise("ne", lines[i], lines[i]), graph.elementwise("eq", best, best)
        better = graph.elementwise("or", better, graph.elementwise("and", is_nan, was_not))
        place = graph.elementwise("select", better, np.int64(graph.constant(float(i))), place)
        best = graph.elementwise("select", better, lines[i], best)
    return [Nodes(place, "int")]
