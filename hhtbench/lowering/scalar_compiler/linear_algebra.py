"""Rules of linear algebra and of callbacks: a solve with a general matrix is one call of emitted code."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import ONE, ZERO, Graph, Ids
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, rule
from hhtbench.lowering.scalar_compiler.values import Nodes, Value, numbers


@rule("hhtbench_inverse")
def _inverse(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    ids = numbers(ctx.graph, x)
    n = ids.shape[-1]
    parts = [_inverse_by_blocks(ctx.graph, matrix) for matrix in ids.reshape(-1, n, n)]
    return [Nodes(np.array(parts, dtype=np.int64).reshape(ids.shape), "float")]


def _inverse_by_blocks(graph: Graph, matrix: Ids) -> Ids:
    """Unknowns that do not meet do not meet in the inverse: the mass of many bodies is inverted body by body."""
    result = np.full(matrix.shape, ZERO, dtype=np.int64)
    for block in _blocks(matrix):
        unit = np.where(np.eye(block.size, dtype=bool), ONE, ZERO)
        result[np.ix_(block, block)] = solve(graph, matrix[np.ix_(block, block)], unit)
    return result


def solve(graph: Graph, matrix: Ids, right: Ids) -> Ids:
    """X (n, k) of ``matrix`` X = ``right`` with rows exchanged; not finite where singular."""
    n, k = right.shape
    if np.count_nonzero(matrix != np.where(np.eye(n, dtype=bool), matrix, ZERO)) == 0:  # diagonal
        return np.array([[graph.div(right[i, j], matrix[i, i]) for j in range(k)] for i in range(n)], dtype=np.int64)
    call, width = graph.node("solve", n, k, *np.hstack([matrix, right]).ravel().tolist()), n + k
    return np.array([[graph.node("entry", call, i * width + j) for j in range(n, width)] for i in range(n)], dtype=np.int64)


@rule("custom_linear_solve")
def _linear_solve(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    """The matrix from the product function of the solve, column by column; how JAX would solve does not matter."""
    p = equation.params
    lengths, jaxprs = p["const_lengths"], p["jaxprs"]
    constants, right = inputs[: lengths.matvec], inputs[sum(lengths) :]
    if len(right) != 1:
        raise NotNative("a linear solve for several arrays at once")
    ids = numbers(ctx.graph, right[0])
    size = ids.size
    columns = []
    for i in range(size):
        unit = np.zeros(size)
        unit[i] = 1.0
        (column,) = ctx.closed(jaxprs.matvec, [*constants, unit.reshape(ids.shape)])
        columns.append(numbers(ctx.graph, column).ravel())
    return [Nodes(_by_blocks(ctx.graph, np.stack(columns, axis=1), ids.ravel()).reshape(ids.shape), "float")]


def _by_blocks(graph: Graph, matrix: Ids, right: Ids) -> Ids:
    """Unknowns that do not meet are solved apart; blocks with one and the same matrix share its factors."""
    shared: dict[bytes, list[np.ndarray]] = {}
    for block in _blocks(matrix):
        shared.setdefault(matrix[np.ix_(block, block)].tobytes(), []).append(block)
    result = np.empty(right.size, dtype=np.int64)
    for blocks in shared.values():
        places = np.stack(blocks, axis=1)  # (unknowns of a block, blocks)
        result[places] = solve(graph, matrix[np.ix_(blocks[0], blocks[0])], right[places])
    return result


def _blocks(matrix: Ids) -> list[np.ndarray]:
    """Sets of unknowns that do not meet: a solve with many right-hand sides is one block each."""
    _, label = connected_components(matrix != ZERO, directed=False)
    return [np.flatnonzero(label == i) for i in range(label.max() + 1)] if label.size else []


@rule("hhtbench_foreign")
def _foreign(ctx: Interpreter, equation: Any, address: Value, *inputs: Value) -> list[Value]:
    (parameter,) = numbers(ctx.graph, address).ravel().tolist()
    entries = [entry for value in inputs for entry in numbers(ctx.graph, value).ravel().tolist()]
    size = int(np.prod(equation.params["shape"]))
    call = ctx.graph.node("foreign", ctx.graph.operands[parameter][0], size, *entries)
    ids = np.array([ctx.graph.node("entry", call, i) for i in range(size)], dtype=np.int64)
    return [Nodes(ids.reshape(equation.params["shape"]), "float")]


@rule("triangular_solve")
def _triangular(ctx: Interpreter, equation: Any, a: Value, b: Value) -> list[Value]:
    p = equation.params
    matrices, rights = numbers(ctx.graph, a), numbers(ctx.graph, b)
    n, shape = matrices.shape[-1], rights.shape
    if not p["left_side"]:
        rights = rights.swapaxes(-1, -2)
    transposed = p["transpose_a"] == p["left_side"]  # x A = b is A^T x^T = b^T
    if transposed:
        matrices = matrices.swapaxes(-1, -2)
    lower = p["lower"] != transposed
    parts = []
    for matrix, right in zip(matrices.reshape(-1, n, n), rights.reshape(-1, *rights.shape[-2:]), strict=True):
        parts.append(_substitute(ctx.graph, matrix, right, lower, p["unit_diagonal"]))
    result = np.array(parts, dtype=np.int64).reshape(rights.shape)
    return [Nodes((result if p["left_side"] else result.swapaxes(-1, -2)).reshape(shape), "float")]


def _substitute(graph: Graph, matrix: Ids, right: Ids, lower: bool, unit: bool) -> Ids:
    n = len(matrix)
    result = right.copy()
    for step in range(n):
        i = step if lower else n - 1 - step
        for k in range(i) if lower else range(n - 1, i, -1):
            for j in range(result.shape[1]):
                result[i, j] = graph.sub(result[i, j], graph.mul(matrix[i, k], result[k, j]))
        if not unit:
            result[i] = [graph.div(x, matrix[i, i]) for x in result[i]]
    return result


@rule("cholesky")
def _cholesky(ctx: Interpreter, equation: Any, x: Value) -> list[Value]:
    """The lower factor; the square root of a negative pivot makes everything after it NaN."""
    graph, ids = ctx.graph, numbers(ctx.graph, x)
    n, parts = ids.shape[-1], []
    for matrix in ids.reshape(-1, n, n):
        factor = np.full((n, n), ZERO, dtype=np.int64)
        for j in range(n):
            for i in range(j, n):
                rest = matrix[i, j]
                for k in range(j):
                    rest = graph.sub(rest, graph.mul(factor[i, k], factor[j, k]))
                factor[i, j] = graph.apply("sqrt", rest) if i == j else graph.div(rest, factor[j, j])
        parts.append(factor)
    return [Nodes(np.array(parts, dtype=np.int64).reshape(ids.shape), "float")]
