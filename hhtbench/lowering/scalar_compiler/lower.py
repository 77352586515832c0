"""From a JAX function to the scalar graph of its result, whole or in two stages.

In stages, whatever depends on the last argument only is computed once for many values of the others: Newton's iteration
evaluates a residual at several iterates of one step, and half of a small system's operations, sines and divisions among
them, depend only on the step's known values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from hhtbench.lowering.jax_internals import without_dead_code
from hhtbench.lowering.scalar_compiler import control, elementwise, linear_algebra, movement
from hhtbench.lowering.scalar_compiler.dependencies import depending, needed, operands
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Nodes, Unknown, Value
from hhtbench.lowering.scalar_compiler.store import BOOLEAN, CALLS, CODES, NAMES, Ids, NotNative
from hhtbench.solution.counting import preparing

RULE_BOOKS = (control, elementwise, linear_algebra, movement)  # importing them registers their rules
GROWTH = 10  # nodes made for each that is kept, at most: derivatives make many that turn out not to be needed
FOLDED = (0.0, 1.0, -1.0)  # parameter values that make operations vanish
CHEAP = "constant", "parameter", "argument", *CALLS  # cost no operation, or are no numbers themselves

Shapes = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Lowered:
    """The scalar graph of one function."""

    graph: Graph
    outputs: Ids  #: one node for every entry of the result, row by row
    shape: tuple[int, ...]  #: shape of the result
    arguments: int  #: how many arrays it takes

    @cached_property
    def kept(self) -> Ids:
        """Nodes computed in the early stage that the late stage needs."""
        graph, live = self.graph, np.flatnonzero(needed(self.graph, self.outputs))
        code = graph.column("code")
        others = live[(code[live] == CODES["argument"]) & (graph.column("x")[live] != self.arguments - 1)]
        late = depending(graph, live, others)
        wanted = np.zeros(code.size, dtype=bool)
        wanted[operands(graph, live[late[live]])[0]] = wanted[self.outputs] = True
        free = np.isin(NAMES, CHEAP) | BOOLEAN  # truths have no place in an array of numbers
        return np.flatnonzero(wanted & ~late & ~free[code])


def pattern_of(parameters: np.ndarray) -> np.ndarray:
    """(k,) int8: 0 for a free parameter, else one plus its place among the folded values; -0.0 stays free."""
    pattern = np.zeros(parameters.size, dtype=np.int8)
    for code, value in enumerate(FOLDED, start=1):
        pattern[(parameters == value) & (np.signbit(parameters) == np.signbit(value))] = code
    return pattern


def lower(name: str, function: Any, pattern: np.ndarray, shapes: Shapes, limit: int) -> Lowered:
    """Scalar graph of ``function(parameters, *arrays)``, reported as ``name``.

    The function is traced through ``jax.jit``, so that XLA can use the same trace.

    Raises
    ------
    NotNative
        A primitive has no rule, an integer depends on an argument, or there are more than ``limit`` operations.
    """
    structs = [jax.ShapeDtypeStruct(shape, np.float64) for shape in ((pattern.size,), *shapes)]
    with preparing(f"tracing {name}"):
        computation = function.trace(*structs)
    leaves = jax.tree.leaves(computation.out_info)
    if len(leaves) != 1:
        raise NotNative(f"the function returns {len(leaves)} arrays instead of one")
    graph = Graph(limit * GROWTH)
    interpreter = Interpreter(graph)
    with preparing(f"lowering {name}"):
        (value,) = interpreter.closed(without_dead_code(computation.jaxpr), _inputs(graph, pattern, shapes))
        if isinstance(value, Unknown):
            raise NotNative(value.reason)
        outputs = interpreter.as_numbers(interpreter.lift(value)).ravel()
        graph.close()
    return Lowered(graph, outputs, tuple(leaves[0].shape), len(shapes))


def _inputs(graph: Graph, pattern: np.ndarray, shapes: Shapes) -> list[Value]:
    arrays = [graph.constants(np.array([0.0, *FOLDED])[pattern])]
    free = np.flatnonzero(pattern == 0)
    arrays[0][free] = graph.each("parameter", free)
    for which, shape in enumerate(shapes):
        places = np.arange(math.prod(shape)).reshape(shape)
        arrays.append(graph.each("argument", np.full(places.shape, which), places))
    return [Nodes(ids, "float") for ids in arrays]


def staged(lowered: Lowered, stage: str, rows: tuple[int, int] | None = None) -> Lowered:
    """The "early" or "late" stage of a function, or the "whole" of it.

    "early" returns numbers (k,) that depend on no argument but the last; "late" takes them as one more argument,
    and returns only its ``rows`` from the first to before the second if given.
    """
    if stage == "whole":
        return lowered
    kept = lowered.kept
    if stage == "early":
        return replace(lowered, outputs=kept, shape=kept.shape)
    graph = lowered.graph.changed(kept, "argument", lowered.arguments, np.arange(kept.size))
    late = replace(lowered, graph=graph, arguments=lowered.arguments + 1)
    return late if rows is None else replace(late, outputs=late.outputs[slice(*rows)], shape=(rows[1] - rows[0],))
