"""Rules for products, linear solves and callbacks; a solve with a general matrix is a call of generated code."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.interpreter import Interpreter, Value, made, rule, rule_of_nodes
from hhtbench.lowering.scalar_compiler.store import ONE, ZERO, Ids, NotNative


@rule("dot_general")
def _dot(ctx: Interpreter, equation: Any, x: Value, y: Value) -> list[Value]:
    sums, batches = equation.params["dimension_numbers"]
    shape = equation.outvars[0].aval.shape
    if isinstance(x, np.ndarray) and isinstance(y, np.ndarray):
        left, right = map(_as_matrices, (x, y), sums, batches)
        return [np.einsum("bik,bjk->bij", left, right).reshape(shape)]
    left, right = map(_as_matrices, (ctx.numbers(x), ctx.numbers(y)), sums, batches)
    return made(equation, _products(ctx.graph, left, right).reshape(shape))


def _as_matrices(array: np.ndarray, summed: Any, batch: Any) -> np.ndarray:
    """Array with its axes grouped as (batch, rows, k)."""
    free = [axis for axis in range(array.ndim) if axis not in (*summed, *batch)]
    sizes = [math.prod(array.shape[axis] for axis in axes) for axes in (batch, free, summed)]
    return array.transpose([*batch, *free, *summed]).reshape(sizes)


def _products(graph: Graph, x: Ids, y: Ids) -> Ids:
    """Products (b, i, j) of rows of x (b, i, k) with rows of y (b, j, k), summed in order; structural zeros cost nothing.

    All first terms of the sums are added together, then all second ones, and so on.
    """
    (batches, rows, terms), columns = x.shape, y.shape[1]
    row, term = np.nonzero(x.reshape(-1, terms) != ZERO)
    term += row // rows * terms if rows else 0
    summed, column = np.nonzero(y.swapaxes(1, 2).reshape(-1, columns) != ZERO)
    first, count = np.searchsorted(summed, term), np.bincount(summed, minlength=batches * terms)[term]
    left = np.repeat(np.arange(term.size), count)  # of the pairs of factors, by row and term
    right = np.arange(left.size) + (first - np.cumsum(count) + count)[left]
    place = row[left] * columns + column[right]
    order = np.argsort(place, kind="stable")
    left, right, place = left[order], right[order], place[order]
    factors = x[x != ZERO][left], y.swapaxes(1, 2)[y.swapaxes(1, 2) != ZERO][right]
    products, turn = graph.elementwise("mul", *factors), np.arange(place.size) - np.searchsorted(place, place)
    result = np.full(batches * rows * columns, ZERO, dtype=np.int64)
    for k in range(turn.max(initial=-1) + 1):
        now = np.flatnonzero(turn == k)
        result[place[now]] = graph.elementwise("add", result[place[now]], products[now])
    return result.reshape(batches, rows, columns)


@rule_of_nodes("hhtbench_inverse", numbers=True)
def _inverse(graph: Graph, equation: Any, matrices: Ids) -> Ids:
    return np.vectorize(partial(_inverse_by_blocks, graph), otypes=[np.int64], signature="(n,n)->(n,n)")(matrices)


def _inverse_by_blocks(graph: Graph, matrix: Ids) -> Ids:
    """Inverse by uncoupled diagonal blocks: the mass of many bodies is inverted body by body."""
    result = np.full(matrix.shape, ZERO, dtype=np.int64)
    for block in _blocks(matrix):
        unit = np.where(np.eye(block.size, dtype=bool), ONE, ZERO)
        result[np.ix_(block, block)] = solve(graph, matrix[np.ix_(block, block)], unit)
    return result


def solve(graph: Graph, matrix: Ids, right: Ids) -> Ids:
    """X (n, k) of ``matrix`` X = ``right`` with row pivoting; not finite where singular."""
    n, k = right.shape
    if np.all(matrix[~np.eye(n, dtype=bool)] == ZERO):  # diagonal
        return graph.elementwise("div", right, np.diagonal(matrix)[:, None])
    call = graph.call("solve", (n, k), np.hstack([matrix, right]).ravel())
    return graph.entries(call, np.arange(n * (n + k)).reshape(n, n + k)[:, n:])


@rule("custom_linear_solve")
def _linear_solve(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
    """The matrix from the product function of the solve, column by column; how JAX would solve does not matter."""
    p = equation.params
    lengths, jaxprs = p["const_lengths"], p["jaxprs"]
    constants, right = inputs[: lengths.matvec], inputs[sum(lengths) :]
    if len(right) != 1:
        raise NotNative("a linear solve for several arrays at once")
    ids, columns = ctx.numbers(right[0]), []
    for unit in np.eye(ids.size):
        (column,) = ctx.closed(jaxprs.matvec, [*constants, unit.reshape(ids.shape)])
        columns.append(ctx.numbers(column).ravel())
    return made(equation, _by_blocks(ctx.graph, np.stack(columns, axis=1), ids.ravel()).reshape(ids.shape))


def _by_blocks(graph: Graph, matrix: Ids, right: Ids) -> Ids:
    """Solve uncoupled diagonal blocks separately; blocks with equal matrices share factors."""
    shared: dict[bytes, list[np.ndarray]] = {}
    for block in _blocks(matrix):
        shared.setdefault(matrix[np.ix_(block, block)].tobytes(), []).append(block)
    result = np.empty(right.size, dtype=np.int64)
    for blocks in shared.values():
        places = np.stack(blocks, axis=1)  # (unknowns of a block, blocks)
        result[places] = solve(graph, matrix[np.ix_(blocks[0], blocks[0])], right[places])
    return result


def _blocks(matrix: Ids) -> list[np.ndarray]:
    """Index sets of uncoupled unknowns (connected components of the matrix)."""
    _, label = connected_components(matrix != ZERO, directed=False)
    return [np.flatnonzero(label == i) for i in range(label.max() + 1)] if label.size else []


@rule("hhtbench_foreign")
def _foreign(ctx: Interpreter, equation: Any, address: Value, *inputs: Value) -> list[Value]:
    graph, shape = ctx.graph, equation.params["shape"]
    (parameter,) = ctx.numbers(address).ravel().tolist()
    entries = np.concatenate([np.zeros(0, dtype=np.int64), *(ctx.numbers(value).ravel() for value in inputs)])
    size = int(np.prod(shape))
    call = graph.call("foreign", (graph.x[parameter], size), entries)
    return made(equation, graph.entries(call, np.arange(size).reshape(shape)))


@rule_of_nodes("hhtbench_banded", numbers=True)
def _banded(graph: Graph, equation: Any, factors: Ids, right: Ids) -> Ids:
    n, width = factors.shape
    call = graph.call("banded", (n, width - 1), np.concatenate([factors.ravel(), right]))
    return graph.entries(call, factors.size + np.arange(n))


@rule_of_nodes("hhtbench_factor", numbers=True)
def _band_factor(graph: Graph, equation: Any, band: Ids) -> Ids:
    """Written out: bodies that do not meet are the turns of a loop then."""
    width, factor = band.shape[1] - 1, band.copy()
    for i in range(len(band)):
        row: list[int] = factor[i].tolist()
        for j in range(max(width - i, 0), width):
            before: list[int] = factor[i - width + j].tolist()  # row j's own entries end where this row's column j is
            for k in range(j):
                row[j] = graph.sub(row[j], graph.mul(row[k], before[k - j + width]))
            row[j] = graph.mul(row[j], before[width])
        for k in range(width):
            row[width] = graph.sub(row[width], graph.mul(row[k], row[k]))
        row[width] = graph.div(ONE, graph.apply("sqrt", row[width]))
        factor[i] = row
    return factor
