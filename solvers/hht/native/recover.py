"""Multipliers of many output rows from the acceleration level, (H16), in one compiled loop."""

from __future__ import annotations

import math
from typing import Any

from hhtbench.lowering.compile.loops import BoolArray, FloatArray, FloatMatrix
from solvers.hht.kernels import called
from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import compiled
from solvers.hht.native.step import put, top

MAX_ITERATIONS = 25
CONVERGED = 1e-13
WELL_POSED = 1e-8  # smallest over largest pivot of the scaled matrix; below it the host engine looks closer


@called
def recover(
    code: tuple[int, int],
    at: tuple[int, int, int],
    linear: bool,
    place: FloatArray,
    x: FloatArray,
    terms: FloatArray,
    work: tuple[FloatMatrix, FloatArray, FloatArray],
    rows: FloatMatrix,
    done: BoolArray,
) -> None:
    """Put the multipliers of every row of ``rows``, [t, q, v, lam, mu], in their places and mark it as ``done``.

    What is not finite, nearly singular or does not converge is left as it is.  ``at`` are the addresses of ``place``
    [t, q, v], ``x`` and ``terms``; ``work`` is room for a matrix of their size and for two vectors.
    """
    matrix, increment, scale = work
    n, size = place.size // 2, x.size
    for i in range(rows.shape[0]):
        row = rows[i]
        put(place, 0, row[: 1 + 2 * n])
        for j in range(size):
            x[j] = 0.0 if linear or j < n else row[1 + n + j]
        for _ in range(MAX_ITERATIONS):
            invoke(code[0], (at[2], code[1], at[0], at[0] + 8, at[0] + 8 + 8 * n, at[1]))
            for j in range(size):
                increment[j] = terms[j]
                for k in range(size):
                    matrix[j, k] = terms[size + j * size + k]
            if not scaled_solve(matrix, increment, scale):
                break
            for j in range(size):
                x[j] -= increment[j]
            if linear or small(increment, x, n):
                done[i] = True
                put(row, 1 + 2 * n, x[n:])
                break


@compiled
def small(increment: Any, x: Any, n: Any) -> Any:
    """Whether the increment has converged, accelerations and multipliers each against their largest."""
    return top(increment[:n]) <= CONVERGED * top(x[:n]) and top(increment[n:]) <= CONVERGED * top(x[n:])


@compiled
def scaled_solve(matrix: Any, right: Any, scale: Any) -> Any:
    """Solve in place after scaling rows and columns to size one; False where that is not clearly possible."""
    size = right.size
    for i in range(size):
        largest = top(matrix[i])
        if not 0.0 < largest < math.inf:
            return False
        for j in range(size):
            matrix[i, j] /= largest
        right[i] /= largest
    for j in range(size):
        scale[j] = top(matrix[:, j])
        if not scale[j] > 0.0:
            return False
        for i in range(size):
            matrix[i, j] /= scale[j]
    least, most = math.inf, 0.0
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        head = matrix[k, k]
        least, most = min(least, abs(head)), max(most, abs(head))
        if not abs(head) > 0.0:
            return False
        for i in range(k + 1, size):
            factor = matrix[i, k] / head
            if factor != 0.0:
                right[i] -= factor * right[k]
                for j in range(k + 1, size):
                    matrix[i, j] -= factor * matrix[k, j]
    for k in range(size - 1, -1, -1):
        value = right[k]
        for j in range(k + 1, size):
            value -= matrix[k, j] * right[j]
        right[k] = value / matrix[k, k]
    total = 0.0
    for j in range(size):
        right[j] /= scale[j]
        total += right[j] * 0.0  # NaN where it is not finite
    return least > WELL_POSED * most and total == 0.0
