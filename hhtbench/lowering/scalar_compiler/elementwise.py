"""Rules of the primitives that act entry by entry."""

from __future__ import annotations

from typing import Any

import numpy as np
from jax import lax

from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import ONE, ZERO, Graph, Ids
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.operations import ARITHMETIC, COMPARISONS, INTRINSICS, LIBM
from hhtbench.lowering.scalar_compiler.values import Nodes, Value, as_numbers, folded, lift, numbers

OTHERS = "add_any", "atan2", "clamp", "erf", "erfc", "logistic", "max", "min", "neg", "pow", "rsqrt", "sign", "square"
INTEGER = "abs", "add", "add_any", "clamp", "max", "min", "mul", "neg", "rem", "sign", "square", "sub"  # the same for them


@rule(*LIBM, *ARITHMETIC, *INTRINSICS, *OTHERS)
def _on_numbers(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    name, graph = equation.primitive.name, ctx.graph
    lifted = [lift(graph, value) for value in inputs]
    kinds, ids = {value.kind for value in lifted}, [value.ids for value in lifted]
    if kinds == {"bool"} and name in ("max", "min"):
        return [Nodes(graph.elementwise("or" if name == "max" else "and", *ids), "bool")]
    if kinds == {"int"} and name == "div":
        return [Nodes(graph.elementwise("trunc", graph.elementwise("div", *ids)), "int")]
    if kinds == {"float"} or (kinds == {"int"} and name in INTEGER):
        return [Nodes(graph.elementwise(name, *ids), lifted[0].kind)]
    raise NotNative(f"{name} of {' and '.join(sorted(kinds))} values that depend on the arguments")


@rule("integer_pow")
def _integer_pow(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    nodes, exponent = lift(ctx.graph, x), int(equation.params["y"])
    flat = [power(ctx.graph, node, exponent) for node in nodes.ids.ravel().tolist()]
    return [Nodes(np.array(flat, dtype=np.int64).reshape(nodes.shape), nodes.kind)]


def power(graph: Graph, x: int, exponent: int) -> int:
    """x to an integer power by squaring, in XLA's order."""
    if exponent < 0:
        return graph.div(ONE, power(graph, x, -exponent))
    result = ONE
    while exponent:
        if exponent & 1:
            result = graph.mul(result, x)
        exponent >>= 1
        if exponent:
            x = graph.mul(x, x)
    return result


@rule("round")
def _round(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    away = equation.params["rounding_method"] == lax.RoundingMethod.AWAY_FROM_ZERO
    return [Nodes(ctx.graph.elementwise("round_away" if away else "round_even", numbers(ctx.graph, x)), "float")]


@rule("is_finite")
def _is_finite(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    return [Nodes(ctx.graph.elementwise("is_finite", numbers(ctx.graph, x)), "bool")]


@rule(*COMPARISONS)
def _compare(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    name, graph = equation.primitive.name, ctx.graph
    x, y = (lift(graph, value) for value in inputs)
    if x.kind != "bool":
        return [Nodes(graph.elementwise(name, x.ids, y.ids), "bool")]
    if name not in ("eq", "ne"):
        raise NotNative(f"{name} of booleans")
    differs = graph.elementwise("xor", x.ids, y.ids)
    return [Nodes(differs if name == "ne" else graph.elementwise("not", differs), "bool")]


@rule("lt_to", "le_to")
def _compare_in_total_order(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    """NaN comes last; the two zeros, which the order tells apart, are equal here: their makers treat them so."""
    graph = ctx.graph
    x, y = (numbers(graph, value) for value in inputs)
    below = graph.elementwise("lt" if equation.primitive.name == "lt_to" else "le", x, y)
    x_is_nan, y_is_nan = graph.elementwise("ne", x, x), graph.elementwise("ne", y, y)
    first = graph.elementwise("not", x_is_nan) if equation.primitive.name == "lt_to" else y_is_nan
    return [Nodes(graph.elementwise("or", below, graph.elementwise("and", y_is_nan, first)), "bool")]


@rule("and", "or", "xor", "not")
def _logic(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    lifted = [lift(ctx.graph, value) for value in inputs]
    if any(value.kind != "bool" for value in lifted):
        raise NotNative(f"{equation.primitive.name} on bits of integers")
    return [Nodes(ctx.graph.elementwise(equation.primitive.name, *(value.ids for value in lifted)), "bool")]


@rule("select_n")
def _select(ctx: Interpreter, equation: Any, which: Value, *cases: Value) -> list[Value]:
    graph, shape = ctx.graph, equation.outvars[0].aval.shape
    lifted = [lift(graph, case) for case in cases]
    ids = [np.broadcast_to(case.ids, shape) for case in lifted]
    which = folded(graph, which)
    if isinstance(which, np.ndarray):
        chosen = np.choose(np.broadcast_to(which, shape).astype(np.int64), ids)
    else:
        chosen = choose(graph, lift(graph, which), ids)
    return [Nodes(chosen, lifted[0].kind)]


def choose(graph: Graph, which: Nodes, cases: list[Ids]) -> Ids:
    """Entry by entry the case of that number; a boolean chooses between two."""
    if which.kind == "bool":
        return graph.elementwise("select", which.ids, cases[1], cases[0])
    result = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        here = graph.elementwise("le", which.ids, np.int64(graph.constant(float(i))))
        result = graph.elementwise("select", here, cases[i], result)
    return result


@rule("convert_element_type", "reduce_precision")
def _convert(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    graph, wanted = ctx.graph, np.dtype(equation.outvars[0].aval.dtype)
    x = lift(graph, x)
    if equation.primitive.name == "reduce_precision":
        if (equation.params["exponent_bits"], equation.params["mantissa_bits"]) != (11, 52):
            raise NotNative("a precision below float64")
        return [x]
    if wanted.kind == "b":
        return [x if x.kind == "bool" else Nodes(graph.elementwise("ne", x.ids, np.int64(ZERO)), "bool")]
    if wanted.kind in "iu":
        return [Nodes(_truncated(graph, x.ids) if x.kind == "float" else as_numbers(graph, x), "int")]
    if wanted == np.float64:
        return [Nodes(as_numbers(graph, x), "float")]
    raise NotNative(f"{wanted} values")


def _truncated(graph: Graph, ids: Ids) -> Ids:
    """Numbers without their fractions; NaN is 0, as XLA has it."""
    return graph.elementwise("select", graph.elementwise("eq", ids, ids), graph.elementwise("trunc", ids), np.int64(ZERO))


@rule("copy", "stop_gradient", "device_put", "optimization_barrier")
def _same(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    return list(inputs)
