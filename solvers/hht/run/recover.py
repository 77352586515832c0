"""Multipliers of many output rows from the acceleration level, (H16), in one compiled loop."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.lowering import Dynamics, native
from hhtbench.lowering.compile.loops import BoolArray, FloatMatrix
from hhtbench.lowering.dynamics.foreign import Callbacks
from hhtbench.lowering.dynamics.kkt import kkt_terms
from solvers.hht.linear.analysis import full
from solvers.hht.linear.matrix import factor_dense, solve, step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import called, compiled
from solvers.hht.loops.memory import Memory
from solvers.hht.loops.sections import address, call, finite, largest, part, put

FEW = 20  # rows below which their multipliers are found one by one: no further code is needed for them
FIRST = 512  # rows of the first call, and FEW of a NumPy system
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are looked at between
MAX_ITERATIONS = 25
CONVERGED = 1e-13


@called
def recover(z: Memory, linear: bool, rows: FloatMatrix, done: BoolArray) -> None:
    """Put the multipliers of every row of ``rows``, [t, q, v, lam, mu], in their places and mark it as ``done``.

    What is not finite, singular or does not converge is left as it is.
    """
    n, x, increment, at = z.i[mem.N], part(z, mem.X), part(z, mem.INCREMENT), address(z, mem.PLACE)
    for i in range(rows.shape[0]):
        row = rows[i]
        put(part(z, mem.PLACE), 0, row[: 1 + 2 * n])
        for j in range(x.size):
            x[j] = 0.0 if linear or j < n else row[1 + n + j]
        for _ in range(MAX_ITERATIONS):
            call(z, mem.C_MATRIX, mem.COMPUTED, (at, at + 8, at + 8 + 8 * n, address(z, mem.X)))
            if not scaled_solve(z):
                break
            step_back(z)
            if linear or (small(increment[:n], x[:n]) and small(increment[n : x.size], x[n:])):
                done[i] = True
                put(row, 1 + 2 * n, x[n:])
                break


@compiled
def small(increment: Any, x: Any) -> Any:
    """Whether the increment has converged, against the largest entry: of accelerations, or of multipliers."""
    return largest(increment) <= CONVERGED * largest(x)


@compiled
def scaled_solve(z: Any) -> Any:
    """The increment after scaling rows and columns to size one; False where the matrix is singular."""
    terms, right, increment, size = part(z, mem.COMPUTED), part(z, mem.RESIDUAL), part(z, mem.INCREMENT), z.i[mem.SIZE]
    matrix, scale = terms[size:], part(z, mem.RIGHT)
    for i in range(size):
        row = matrix[i * size : (i + 1) * size]
        size_of_row = largest(row)
        if not 0.0 < size_of_row < math.inf:
            return False
        for j in range(size):
            row[j] /= size_of_row
        right[i] = terms[i] / size_of_row
    for j in range(size):
        scale[j] = 0.0
        for i in range(size):
            scale[j] = max(scale[j], abs(matrix[i * size + j]))
        if not scale[j] > 0.0:
            return False
        for i in range(size):
            matrix[i * size + j] /= scale[j]
    if factor_dense(z, 0, matrix) != mem.CONVERGED or part(z, mem.RECORD)[mem.RANK] < size:
        return False
    solve(z, 0, right, increment)
    for j in range(size):
        increment[j] /= scale[j]
    return finite(increment[:size])


def recovered(
    dynamics: Dynamics, callbacks: Callbacks, work: Work, points: int, rows: tuple[Vector, Matrix, Matrix, Matrix, Matrix]
) -> Any:
    """Which of ``rows`` (t, q, v, lam, mu), (k,), have their multipliers in ``lam`` and ``mu`` now."""
    s, (times, _, _, lam, mu) = dynamics.structure, rows
    done = np.zeros(times.size, dtype=bool)
    if times.size < FEW:
        return done
    size = s.n + s.m + s.p
    kkt = native(kkt_terms, dynamics, shapes=((), (s.n,), (s.n,), (size,)))
    z = full(size, 0, "dense", "multipliers").memory(n=s.n, m=s.m, p=s.p, inverse_mass=0, computed=kkt.size)
    z.i[mem.CALLS_PYTHON], z.i[mem.C_MATRIX : mem.C_MATRIX + 2] = not points, kkt.pair
    packed = np.concatenate([times[:, None], *rows[1:]], axis=1)
    first, block = 0, FIRST if points else FEW
    while first < times.size and work.clock.left() >= 0.0:
        block_of, began = slice(first, first + block), time.perf_counter()
        with callbacks:
            recover(z, s.linear_reaction, packed[block_of], done[block_of])
        if callbacks.cause is not None:
            break
        first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
    lam[done], mu[done] = np.split(packed[done, 1 + 2 * s.n :], [s.m], axis=1)
    work.add("residual_evaluations", points * int(done.sum()))
    return done
