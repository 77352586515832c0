"""Rules of the primitives that combine many entries into one: products of matrices, reductions, running sums."""

from __future__ import annotations

import math
from functools import cache, partial, reduce
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.graph import ZERO, Graph, Ids, NotNative
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Value, made, rule
from hhtbench.lowering.scalar_compiler.operations import ELEMENTWISE, LOGIC

REDUCTIONS = {"reduce_sum": "add", "reduce_prod": "mul"} | {
    f"reduce_{name}": name for name in ("max", "min", "and", "or", "xor")
}
EMPTY = {"add": 0.0, "mul": 1.0, "max": -np.inf, "min": np.inf, "and": True, "or": False, "xor": False}
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


@rule("dot_general")
def _dot(ctx: Interpreter, equation: Any, x: Value, y: Value) -> list[Value]:
    sums, batches = equation.params["dimension_numbers"]
    shape = equation.outvars[0].aval.shape
    if isinstance(x, np.ndarray) and isinstance(y, np.ndarray):
        left, right = map(_as_matrices, (x, y), sums, batches)
        return [np.einsum("bik,bjk->bij", left, right).reshape(shape)]
    left, right = map(_as_matrices, (ctx.numbers(x), ctx.numbers(y)), sums, batches)
    product = [_product(ctx.graph, a, b) for a, b in zip(left, right, strict=True)]
    return made(equation, np.array(product, dtype=np.int64).reshape(shape))


def _as_matrices(array: np.ndarray, summed: Any, batch: Any) -> np.ndarray:
    """(batch, rows, k)."""
    free = [axis for axis in range(array.ndim) if axis not in (*summed, *batch)]
    sizes = [math.prod(array.shape[axis] for axis in axes) for axes in (batch, free, summed)]
    return array.transpose([*batch, *free, *summed]).reshape(sizes)


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
    nodes, shape = ctx.lift(x), equation.outvars[0].aval.shape
    if nodes.kind == "bool":
        name = {"max": "or", "min": "and"}.get(name, name)
    elif name in LOGIC:
        raise NotNative(f"{equation.primitive.name} on bits of integers")
    moved = np.moveaxis(nodes.ids, axes, range(-len(axes), 0))
    rows = moved.reshape(math.prod(shape), math.prod(moved.shape[len(shape) :]))
    fold = cache(partial(_fold, ctx.graph, name))  # most rows of derivatives are zero
    return made(equation, np.array([fold(tuple(row)) for row in rows.tolist()], dtype=np.int64).reshape(shape))


def _fold(graph: Graph, name: str, row: tuple[int, ...]) -> int:
    return reduce(partial(graph.apply, name), row) if row else int(graph.constants(np.asarray(EMPTY[name])))


@rule(*RUNNING)
def _running(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    nodes, name, p = ctx.lift(x), RUNNING[equation.primitive.name], equation.params
    if nodes.kind == "bool":
        raise NotNative(f"{equation.primitive.name} of booleans")
    order = slice(None, None, -1 if p["reverse"] else 1)
    lines = np.moveaxis(nodes.ids, p["axis"], 0)[order].copy()
    for i in range(1, len(lines)):
        lines[i] = ctx.graph.elementwise(name, lines[i - 1], lines[i])
    return made(equation, np.moveaxis(lines[order], 0, p["axis"]))


@rule("argmax", "argmin")
def _argmax(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    """The first of the largest; a NaN is larger, and smaller, than any number."""
    graph, (axis,) = ctx.graph, equation.params["axes"]
    lines = np.moveaxis(ctx.as_numbers(ctx.lift(x)), axis, 0)
    best, place = lines[0], np.full(lines.shape[1:], ZERO, dtype=np.int64)
    for i in range(1, len(lines)):
        better = graph.elementwise("gt" if equation.primitive.name == "argmax" else "lt", lines[i], best)
        is_nan, was_not = graph.elementwise("ne", lines[i], lines[i]), graph.elementwise("eq", best, best)
        better = graph.elementwise("or", better, graph.elementwise("and", is_nan, was_not))
        place = graph.elementwise("select", better, np.int64(graph.constant(float(i))), place)
        best = graph.elementwise("select", better, lines[i], best)
    return made(equation, place)
