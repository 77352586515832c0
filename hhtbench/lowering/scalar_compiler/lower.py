"""From a JAX function to the scalar graph of its result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from hhtbench.counting import preparing
from hhtbench.lowering.scalar_compiler import control, elementwise, indexing, linear_algebra, movement, reductions
from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter
from hhtbench.lowering.scalar_compiler.values import Nodes, Unknown, Value, as_numbers, lift

RULE_BOOKS = (control, elementwise, indexing, linear_algebra, movement, reductions)  # importing them registers their rules
GROWTH = 10  # nodes made for each that is kept, at most: derivatives make many that turn out not to be needed
FOLDED = (0.0, 1.0, -1.0)  # parameter values that make operations vanish

Shapes = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Lowered:
    """The scalar graph of one function."""

    graph: Graph
    outputs: list[int]  #: one node for every entry of the result, row by row
    shape: tuple[int, ...]  #: of the result
    arguments: int  #: how many arrays it takes


def pattern_of(parameters: np.ndarray) -> np.ndarray:
    """(k,) int8: 0 for a free parameter, else one plus its place among the folded values; -0.0 stays free."""
    pattern = np.zeros(parameters.size, dtype=np.int8)
    for code, value in enumerate(FOLDED, start=1):
        pattern[(parameters == value) & (np.signbit(parameters) == np.signbit(value))] = code
    return pattern


def lower(name: str, function: Any, pattern: np.ndarray, shapes: Shapes, limit: int) -> Lowered:
    """The graph of ``function(parameters, *arrays)``, known as ``name``.

    It went through ``jax.jit``: XLA, if it must, uses the same trace.

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
    with preparing(f"lowering {name}"):
        (value,) = Interpreter(graph).closed(computation.jaxpr, _inputs(graph, pattern, shapes))
        outputs = _outputs(graph, value)
    return Lowered(graph, outputs, tuple(leaves[0].shape), len(shapes))


def _inputs(graph: Graph, pattern: np.ndarray, shapes: Shapes) -> list[Value]:
    nodes = [
        graph.constant(FOLDED[code - 1]) if code else graph.node("parameter", i) for i, code in enumerate(pattern.tolist())
    ]
    inputs: list[Value] = [Nodes(np.array(nodes, dtype=np.int64), "float")]
    for which, shape in enumerate(shapes):
        size = int(np.prod(shape))
        ids = np.array([graph.node("argument", which, i) for i in range(size)], dtype=np.int64)
        inputs.append(Nodes(ids.reshape(shape), "float"))
    return inputs


def _outputs(graph: Graph, value: Value) -> list[int]:
    if isinstance(value, Unknown):
        raise NotNative(value.reason)
    return list(as_numbers(graph, lift(graph, value)).ravel().tolist())
