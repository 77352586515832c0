"""Rules of loops and branches: short loops are written out, both branches are computed and one is chosen."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.elementwise import choose
from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.movement import together
from hhtbench.lowering.scalar_compiler.values import Nodes, Unknown, Value, folded, is_known, lift

LONGEST = 2000  # turns of a scan that are written out; the number of operations usually ends it before


@rule("scan")
def _scan(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    p = equation.params
    length, constants, carried = p["length"], p["num_consts"], p["num_carry"]
    if length > LONGEST:
        raise NotNative(f"a loop of {length} turns")
    fixed, rows = inputs[:constants], inputs[constants + carried :]
    carry = list(inputs[constants : constants + carried])
    variables = equation.outvars[carried:]
    kept: list[list[Value]] = [[] for _ in variables]
    order = range(length - 1, -1, -1) if p["reverse"] else range(length)
    for i in order:
        results = ctx.closed(p["jaxpr"], [*fixed, *carry, *(_row(value, i) for value in rows)])
        carry = results[:carried]
        for place, value in zip(kept, results[carried:], strict=True):
            place.append(value)
    columns = [values[::-1] if p["reverse"] else values for values in kept]
    stacked = [_stacked(ctx, values, variable) for values, variable in zip(columns, variables, strict=True)]
    return [*carry, *stacked]


def _row(value: Value, i: int) -> Value:
    if isinstance(value, Nodes):
        return Nodes(value.ids[i], value.kind)
    return value if isinstance(value, Unknown) else np.asarray(value[i])


def _unknown(values: list[Value]) -> Unknown | None:
    return next((value for value in values if isinstance(value, Unknown)), None)


def _stacked(ctx: Interpreter, values: list[Value], variable: Any) -> Value:
    if missing := _unknown(values):
        return missing
    if all(is_known(value) for value in values):
        return np.array(values, dtype=variable.aval.dtype).reshape(variable.aval.shape)
    ids, kind = together(ctx, values)
    return Nodes(np.stack(ids), kind)


@rule("cond")
def _cond(ctx: Interpreter, equation: Any, index: Value, *inputs: Value) -> list[Value]:
    branches = equation.params["branches"]
    which = lift(ctx.graph, index)
    known = folded(ctx.graph, which)
    if isinstance(known, np.ndarray):
        return ctx.closed(branches[min(max(int(known), 0), len(branches) - 1)], inputs)
    results = [ctx.closed(branch, inputs) for branch in branches]
    return [_chosen(ctx, which, list(values)) for values in zip(*results, strict=True)]


def _chosen(ctx: Interpreter, which: Nodes, values: list[Value]) -> Value:
    if missing := _unknown(values):
        return missing
    ids, kind = together(ctx, values)
    return Nodes(choose(ctx.graph, which, ids), kind)
