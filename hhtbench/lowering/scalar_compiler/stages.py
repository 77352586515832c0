"""A function in two stages: what depends on its last argument only is computed once, for many values of the others.

Newton's iteration evaluates a residual at several iterates of one step, whose known values stay: half of a small system's
operations, sines and divisions among them, belong to those.
"""

from __future__ import annotations

from dataclasses import replace

from hhtbench.lowering.scalar_compiler.emit import needs, ordered
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.lower import Lowered
from hhtbench.lowering.scalar_compiler.operations import COMPARISONS, LOGIC

LEAVES = ("constant", "parameter", "argument", "true", "false")


def staged(lowered: Lowered, stage: str, rows: tuple[int, int] | None = None) -> Lowered:
    """The part of a function that is its ``stage``.

    "early" gives the numbers (k,) that no argument but the last has a part in; "late" takes them as one more argument,
    and may give only its ``rows`` from the first to before the second.
    """
    if stage == "whole":
        return lowered
    kept = _kept(lowered, lowered.arguments - 1)
    if stage == "early":
        return replace(lowered, outputs=kept, shape=(len(kept),))
    graph = _with_arguments(lowered.graph, kept, lowered.arguments)
    late = replace(lowered, graph=graph, arguments=lowered.arguments + 1)
    if rows is not None:
        late = replace(late, outputs=lowered.outputs[slice(*rows)], shape=(rows[1] - rows[0],))
    return late


def _kept(lowered: Lowered, last: int) -> list[int]:
    """Numbers that the late stage needs of the early one."""
    graph, late, kept = lowered.graph, set[int](), list[int]()
    for node in ordered(graph, lowered.outputs):
        operation = graph.operation[node]
        varies = operation == "argument" and graph.operands[node][0] != last
        if varies or any(operand in late for operand in needs(graph, node)):
            late.add(node)
    wanted = dict.fromkeys(operand for node in sorted(late) for operand in needs(graph, node))
    for node in (*wanted, *lowered.outputs):
        if node not in late and _is_worth_keeping(graph, node) and node not in kept:
            kept.append(node)
    return kept


def _is_worth_keeping(graph: Graph, node: int) -> bool:
    """A number that costs an operation: booleans have no place in an array of numbers."""
    operation = graph.operation[node]
    return operation not in (*LEAVES, *LOGIC, "select_bool", "solve", "foreign") and operation not in COMPARISONS


def _with_arguments(graph: Graph, kept: list[int], argument: int) -> Graph:
    """``graph`` with the nodes ``kept`` as entries of one more argument."""
    changed = Graph.__new__(Graph)
    changed.__dict__.update(graph.__dict__)
    changed.operation, changed.operands = list(graph.operation), list(graph.operands)
    for place, node in enumerate(kept):
        changed.operation[node], changed.operands[node] = "argument", (argument, place)
    return changed
