"""Multipliers of many output rows from the acceleration level, (H16), in one compiled loop."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.lowering import Dynamics, native
from hhtbench.lowering.compile.loops import BoolArray, FloatArray, FloatMatrix
from hhtbench.lowering.dynamics.foreign import Callbacks
from hhtbench.lowering.dynamics.kkt import kkt_terms
from solvers.hht.loops.calls import invoke
from solvers.hht.loops.compiled import called, compiled
from solvers.hht.loops.sections import largest, put

FEW = 20  # rows below which their multipliers are found one by one: no further code is needed for them
FIRST = 512  # rows of the first call, and FEW of a NumPy system
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are looked at between
MAX_ITERATIONS = 25
CONVERGED = 1e-13
WELL_POSED = 1e-8  # smallest over largest pivot of the scaled matrix; below it the general solver looks closer


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
    return largest(increment[:n]) <= CONVERGED * largest(x[:n]) and largest(increment[n:]) <= CONVERGED * largest(x[n:])


@compiled
def scaled_solve(matrix: Any, right: Any, scale: Any) -> Any:
    """Solve in place after scaling rows and columns to size one; False where that is not clearly possible."""
    size = right.size
    for i in range(size):
        size_of_row = largest(matrix[i])
        if not 0.0 < size_of_row < math.inf:
            return False
        for j in range(size):
            matrix[i, j] /= size_of_row
        right[i] /= size_of_row
    for j in range(size):
        scale[j] = largest(matrix[:, j])
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


class Recovery:
    """The loop above for one system."""

    def __init__(self, dynamics: Dynamics, callbacks: Callbacks, work: Work, points: int) -> None:
        self.dynamics, self.callbacks, self.work, self.points = dynamics, callbacks, work, points

    def __call__(self, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
        """Which rows (k,) have their multipliers in ``lam`` and ``mu`` now."""
        s, done = self.dynamics.structure, np.zeros(times.size, dtype=bool)
        if times.size < FEW:
            return done
        size = s.n + s.m + s.p
        kkt = native(kkt_terms, self.dynamics, shapes=((), (s.n,), (s.n,), (size,)))
        place, x, terms = np.zeros(1 + 2 * s.n), np.zeros(size), np.zeros(kkt.size)
        rows = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
        at = tuple(int(array.ctypes.data) for array in (place, x, terms))
        code = kkt.address, int(kkt.parameters.ctypes.data)
        work = np.empty((size, size)), np.empty(size), np.empty(size)
        first, block = 0, FIRST if self.points else FEW
        while first < times.size and self.work.clock.left() >= 0.0:
            part, began = slice(first, first + block), time.perf_counter()
            with self.callbacks:
                recover(code, at, s.linear_reaction, place, x, terms, work, rows[part], done[part])
            if self.callbacks.cause is not None:
                break
            first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
        lam[done], mu[done] = np.split(rows[done, 1 + 2 * s.n :], [s.m], axis=1)
        self.work.add("residual_evaluations", self.points * int(done.sum()))
        return done
