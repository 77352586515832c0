"""Rules for calls, loops and branches: short loops are unrolled, both branches are computed and one is selected."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.elementwise import choose
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Nodes, Unknown, Value, nodes, rule
from hhtbench.lowering.scalar_compiler.store import NotNative

LONGEST = 2000  # turns of a scan that are written out; the number of operations usually ends it before


@rule("closed_call", "custom_jvp_call", "custom_vjp_call", "jit", "remat2")
def _call(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    p = equation.params
    return ctx.closed(p["jaxpr"] if "jaxpr" in p else p["call_jaxpr"], inputs)


@rule("scan")
def _scan(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    p = equation.params
    length, constants, carried = p["length"], p["num_consts"], p["num_carry"]
    if length > LONGEST:
        raise NotNative(f"a loop of {length} turns")
    fixed, rows = inputs[:constants], inputs[constants + carried :]
    carry = list(inputs[constants : constants + carried])
    kept: list[list[Value]] = []
    for i in range(length - 1, -1, -1) if p["reverse"] else range(length):
        results = ctx.closed(p["jaxpr"], [*fixed, *carry, *(_row(value, i) for value in rows)])
        carry = results[:carried]
        kept.append(results[carried:])
    turns = kept[::-1] if p["reverse"] else kept
    variables = enumerate(equation.outvars[carried:])
    return [*carry, *(_stacked(ctx, [turn[i] for turn in turns], variable.aval) for i, variable in variables)]


def _row(value: Value, i: int) -> Value:
    if isinstance(value, Nodes):
        return Nodes(value.ids[i], value.kind)
    return value if isinstance(value, Unknown) else np.asarray(value[i])


def _unknown(values: list[Value]) -> Unknown | None:
    return next((value for value in values if isinstance(value, Unknown)), None)


def _stacked(ctx: Interpreter, values: list[Value], aval: Any) -> Value:
    if missing := _unknown(values):
        return missing
    return nodes(np.stack(ctx.together(values)), aval)


@rule("cond")
def _cond(ctx: Interpreter, equation: Any, index: Value, *inputs: Value) -> list[Value]:
    branches = equation.params["branches"]
    which = ctx.lift(index)
    known = ctx.folded(which)
    if isinstance(known, np.ndarray):
        return ctx.closed(branches[min(max(int(known), 0), len(branches) - 1)], inputs)
    results = zip(*(ctx.closed(branch, inputs) for branch in branches), strict=True)
    return [
        _unknown(list(values)) or nodes(choose(ctx.graph, which, ctx.together(values)), variable.aval)
        for values, variable in zip(results, equation.outvars, strict=True)
    ]
