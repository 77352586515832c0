"""Rules of the primitives that act entry by entry, or combine the entries along an axis: reductions and running ones."""

from __future__ import annotations

import math
from functools import cache, partial, reduce
from typing import Any, cast

import numpy as np
from jax import lax

from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Nodes, Value, made, rule, rule_of_nodes
from hhtbench.lowering.scalar_compiler.operations import ARITHMETIC, COMPARISONS, ELEMENTWISE, INTRINSICS, LIBM, LOGIC
from hhtbench.lowering.scalar_compiler.store import ZERO, Ids, NotNative

OTHERS = "add_any", "atan2", "clamp", "erf", "erfc", "logistic", "max", "min", "neg", "pow", "rsqrt", "sign", "square"
NUMERIC = *LIBM, *ARITHMETIC, *INTRINSICS, *OTHERS, *COMPARISONS, "is_finite", "lt_to", "le_to"
INTEGER = "abs", "add", "add_any", "clamp", "max", "min", "mul", "neg", "rem", "sign", "square", "sub"  # the same for them
OPERATIONS: dict[tuple[str, ...], dict[str, str]] = {  # by the kind of all inputs: primitive -> operation of the graph
    ("float",): {name: name for name in NUMERIC},
    ("int",): {name: name for name in (*INTEGER, *COMPARISONS)} | {"div": "quotient"},
    ("bool",): {name: name for name in LOGIC} | {"max": "or", "min": "and", "eq": "same", "ne": "xor"},
}

REDUCTIONS = {"reduce_sum": "add", "reduce_prod": "mul"} | {
    f"reduce_{name}": name for name in ("max", "min", "and", "or", "xor")
}
EMPTY = {"add": 0.0, "mul": 1.0, "max": -np.inf, "min": np.inf, "and": True, "or": False, "xor": False}
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


@rule(*NUMERIC, *LOGIC)
def _elementwise(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    name, lifted = equation.primitive.name, [ctx.lift(value) for value in inputs]
    kinds = tuple(sorted({value.kind for value in lifted}))
    operation = OPERATIONS.get(kinds, {}).get(name)
    if operation is not None:
        return made(equation, ctx.graph.elementwise(operation, *(value.ids for value in lifted)))
    raise NotNative(f"{name} of {' and '.join(kinds)} values that depend on the arguments")


@rule_of_nodes("integer_pow")
def _integer_pow(graph: Graph, equation: Any, x: Ids) -> Ids:
    return graph.power(x, int(equation.params["y"]))


@rule_of_nodes("round", numbers=True)
def _round(graph: Graph, equation: Any, x: Ids) -> Ids:
    away = equation.params["rounding_method"] == lax.RoundingMethod.AWAY_FROM_ZERO
    return graph.elementwise("round_away" if away else "round_even", x)


@rule("select_n")
def _select(ctx: Interpreter, equation: Any, which: Value, *cases: Value) -> list[Value]:
    shape = equation.outvars[0].aval.shape
    which = ctx.folded(which)
    if isinstance(which, np.ndarray) and all(isinstance(case, np.ndarray) for case in cases):
        return [np.choose(np.broadcast_to(which, shape).astype(np.int64), cast("Any", cases))]
    ids = [np.broadcast_to(ctx.lift(case).ids, shape) for case in cases]
    if isinstance(which, np.ndarray):
        return made(equation, np.choose(np.broadcast_to(which, shape).astype(np.int64), ids))
    return made(equation, choose(ctx.graph, ctx.lift(which), ids))


def choose(graph: Graph, which: Nodes, cases: list[Ids]) -> Ids:
    """Entry by entry the case of that number; a boolean chooses between two."""
    if which.kind == "bool":
        return graph.elementwise("select", which.ids, cases[1], cases[0])
    result = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        here = graph.elementwise("le", which.ids, np.int64(graph.constant(float(i))))
        result = graph.elementwise("select", here, cases[i], result)
    return result


@rule("convert_element_type")
def _convert(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    graph, wanted = ctx.graph, np.dtype(equation.outvars[0].aval.dtype)
    if isinstance(x, np.ndarray) and x.dtype.kind in "biu":
        return [x.astype(wanted)]
    x = ctx.lift(x)
    if wanted.kind == "b":
        return [x if x.kind == "bool" else Nodes(graph.elementwise("ne", x.ids, np.int64(ZERO)), "bool")]
    if wanted.kind in "iu":
        if x.kind != "float":
            return [Nodes(ctx.as_numbers(x), "int")]
        is_number = graph.elementwise("eq", x.ids, x.ids)  # NaN is 0, as XLA has it
        return [Nodes(graph.elementwise("select", is_number, graph.elementwise("trunc", x.ids), np.int64(ZERO)), "int")]
    if wanted == np.float64:
        return [Nodes(ctx.as_numbers(x), "float")]
    raise NotNative(f"{wanted} values")


@rule("copy", "stop_gradient", "device_put", "optimization_barrier")
def _same(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    return list(inputs)


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
    if 0 < rows.shape[1] < rows.shape[0]:
        return made(equation, reduce(partial(ctx.graph.elementwise, name), rows.T).reshape(shape))
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
