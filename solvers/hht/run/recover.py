"""Multipliers of many rows from the acceleration level, (H16), by the entries of the KKT matrix: bands where they pay."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, Native, Structure, native
from hhtbench.lowering.compile.coloured import find_pattern
from hhtbench.lowering.compile.loops import BoolArray, FloatMatrix, IntMatrix
from hhtbench.lowering.dynamics.jax_dynamics import MatrixFree
from hhtbench.lowering.dynamics.kkt import kkt_entries, kkt_residual, kkt_terms
from solvers.hht.linear.analysis import Analysis, chosen, of_pattern
from solvers.hht.linear.matrix import factor_band, factor_dense, solve, step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import called, compiled
from solvers.hht.loops.memory import Memory
from solvers.hht.loops.sections import address, call, finite, indices, part, put
from solvers.hht.step.acceleration import MAX_ITERATIONS, small


@called
def recover_entries(z: Memory, linear: bool, places: IntMatrix, rows: FloatMatrix, done: BoolArray) -> None:
    """Put the multipliers of every row of ``rows``, [t, q, v, lam, mu], in their places and mark it as ``done``.

    ``places`` (2, entries): rows and columns of the entries of the KKT matrix.  What is not finite, singular or does not
    converge is left as it is.
    """
    n, x, increment, at = z.i[mem.N], part(z, mem.X), part(z, mem.INCREMENT), address(z, mem.PLACE)
    for i in range(rows.shape[0]):
        row = rows[i]
        put(part(z, mem.PLACE), 0, row[: 1 + 2 * n])
        for j in range(x.size):
            x[j] = 0.0 if linear or j < n else row[1 + n + j]
        for _ in range(MAX_ITERATIONS):
            call(z, mem.C_MATRIX, mem.COMPUTED, (at, at + 8, at + 8 + 8 * n, address(z, mem.X)))
            if not scaled_solve(z, places[0], places[1]):
                break
            step_back(z)
            if linear or (small(increment[:n], x[:n]) and small(increment[n : x.size], x[n:])):
                done[i] = True
                put(row, 1 + 2 * n, x[n:])
                break


@compiled
def scaled_solve(z: Any, rows: Any, columns: Any) -> Any:
    """The increment after scaling rows and columns to size one; False where the matrix is singular, or not finite."""
    terms, computed, slots, size = part(z, mem.VALUES), part(z, mem.COMPUTED), indices(z, mem.SLOTS), z.i[mem.SIZE]
    right, of_column, increment = part(z, mem.RESIDUAL), part(z, mem.RIGHT), part(z, mem.INCREMENT)
    for k in range(slots.size):
        terms[k] = computed[slots[k]]
    if not finite(terms):
        return False
    entries = terms[size:]
    scale_to_one(entries, rows, right)
    scale_to_one(entries, columns, of_column)
    for i in range(size):
        if right[i] == 0.0 or of_column[i] == 0.0:
            return False
        right[i] = terms[i] / right[i]
    ended = factor_band(z, 0, entries) if z.i[mem.KIND] == mem.KIND_BAND else factor_dense(z, 0, entries)
    if ended != mem.CONVERGED or part(z, mem.RECORD)[mem.RANK] < size:
        return False
    solve(z, 0, right, increment)
    for j in range(size):
        increment[j] /= of_column[j]
    return finite(increment[:size])


@compiled
def scale_to_one(entries: Any, places: Any, largest_of: Any) -> None:
    """Divide ``entries`` by the largest magnitude of their row, or column, ``places``, which goes into ``largest_of``."""
    for i in range(largest_of.size):
        largest_of[i] = 0.0
    for k in range(entries.size):
        largest_of[places[k]] = max(largest_of[places[k]], abs(entries[k]))
    for k in range(entries.size):
        if entries[k] != 0.0:
            entries[k] /= largest_of[places[k]]


def row_memory(kkt: Native, analysis: Analysis, s: Structure, *, calls_python: bool) -> tuple[Memory, FloatMatrix]:
    """Memory for :func:`recover_entries`, and the places of the matrix's entries."""
    z = analysis.memory(n=s.n, m=s.m, p=s.p, inverse_mass=0, computed=kkt.size)
    z.i[mem.CALLS_PYTHON], z.i[mem.C_MATRIX : mem.C_MATRIX + 2] = calls_python, kkt.pair
    return z, np.array([analysis.rows, analysis.columns], dtype=np.int64)


def kkt_code(dynamics: Dynamics) -> tuple[Native, Analysis]:
    """Machine code of residual and matrix of (H16), and the linear algebra for the entries that can differ from zero.

    The ``slots`` say where code puts each of [residual; entries].
    """
    s = dynamics.structure
    size, vector = s.n + s.m + s.p, (s.n,)
    shapes = (), vector, vector, (size,)
    if isinstance(dynamics, MatrixFree):
        pattern = find_pattern(kkt_residual, dynamics, example=(np.zeros(size), 0.0, np.zeros(s.n), np.zeros(s.n)))
        return native(kkt_entries, dynamics, pattern, shapes=shapes), of_pattern(pattern, size, "auto")
    code = native(kkt_terms, dynamics, shapes=shapes)
    flat = np.union1d(code.varying, np.flatnonzero(code.constants))
    flat = flat[flat >= size]
    slots = np.concatenate([np.arange(size), flat])
    entries = Analysis(size, flat // size - 1, flat % size, 0, slots, np.zeros(slots.size))
    return code, chosen(entries, "auto", measured=False)
