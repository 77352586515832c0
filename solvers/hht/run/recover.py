"""Multipliers of many rows from the acceleration level, (H16), by the entries of the KKT matrix: bands where they pay."""

from __future__ import annotations

import numpy as np

from hhtbench.lowering import Dynamics, Native, NotNative, Structure, native
from hhtbench.lowering.compile.coloured import find_pattern
from hhtbench.lowering.compile.loops import BoolArray, FloatMatrix
from hhtbench.lowering.dynamics.kkt import kkt_entries, kkt_residual, kkt_terms
from solvers.hht.linear.analysis import Analysis, chosen, of_pattern
from solvers.hht.linear.matrix import step_back
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import called
from solvers.hht.loops.memory import Memory
from solvers.hht.loops.sections import part, put
from solvers.hht.step.acceleration import MAX_ITERATIONS, small
from solvers.hht.step.entries import compute_entries, factor_entries, solve_entries

LARGEST = 300  # unknowns up to which code of full matrices is made: three seconds, and fourteen at 480


@called
def recover_entries(z: Memory, linear: bool, rows: FloatMatrix, done: BoolArray) -> None:
    """Put the multipliers of every row of ``rows``, [t, q, v, lam, mu], in their places and mark it as ``done``.

    What is not finite, singular or does not converge is left as it is.
    """
    n, x, increment = z.i[mem.N], part(z, mem.X), part(z, mem.INCREMENT)
    for i in range(rows.shape[0]):
        row = rows[i]
        put(part(z, mem.PLACE), 0, row[: 1 + 2 * n])
        for j in range(x.size):
            x[j] = 0.0 if linear or j < n else row[1 + n + j]
        for _ in range(MAX_ITERATIONS):
            compute_entries(z)
            if not (factor_entries(z) and solve_entries(z)):
                break
            step_back(z)
            if linear or (small(increment[:n], x[:n]) and small(increment[n : x.size], x[n:])):
                done[i] = True
                put(row, 1 + 2 * n, x[n:])
                break


def row_memory(kkt: Native, analysis: Analysis, s: Structure) -> Memory:
    """Memory for :func:`recover_entries`, and for a projection by entries."""
    z = analysis.memory(n=s.n, m=s.m, p=s.p, inverse_mass=0, computed=kkt.size, by_entries=True)
    z.i[mem.C_MATRIX : mem.C_MATRIX + 2] = kkt.pair
    return z


def kkt_code(dynamics: Dynamics) -> tuple[Native, Analysis]:
    """Machine code of residual and matrix of (H16), and the linear algebra for the entries that can differ from zero.

    The ``slots`` say where code puts each of [residual; entries].

    Raises
    ------
    NotNative
        There is none, or it would take long to make.
    """
    s = dynamics.structure
    size, vector = s.n + s.m + s.p, (s.n,)
    if size > LARGEST and dynamics.matrices:
        raise NotNative(f"full matrices of {size} unknowns")
    shapes = (), vector, vector, (size,)
    if not dynamics.matrices:
        pattern = find_pattern(kkt_residual, dynamics, example=(np.zeros(size), 0.0, np.zeros(s.n), np.zeros(s.n)))
        return native(kkt_entries, dynamics, pattern, shapes=shapes), of_pattern(pattern, size, "auto")
    code = native(kkt_terms, dynamics, shapes=shapes)
    flat = np.union1d(code.varying, np.flatnonzero(code.constants))
    flat = flat[flat >= size]
    slots = np.concatenate([np.arange(size), flat])
    entries = Analysis(size, flat // size - 1, flat % size, 0, slots, np.zeros(slots.size))
    return code, chosen(entries, "auto", measured=False)
