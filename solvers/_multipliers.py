"""Multipliers of many rows by compiled loops, instead of one acceleration level in Python for each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.lowering import Dynamics, route_of
from solvers.forms.eliminated import kkt_of
from solvers.forms.functions import products_of
from solvers.hht.run.recover import recover_entries, row_memory

FEW = 20  # rows: fewer go without machine code, made before or not, as the bits must not depend on earlier solves
BLOCK = 256  # rows of one call: budgets and the user's interrupt are looked at between

RecoverBlock = Callable[[Matrix, Any], None]  # (rows [t, q, v, lam, mu], done): fills rows, marks them and counts


def in_blocks(recover: RecoverBlock, work: Work, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``."""
    done, packed = np.zeros(times.size, dtype=bool), np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    for first in range(0, times.size, BLOCK):
        if work.clock.left() < 0.0:
            break
        block = slice(first, first + BLOCK)
        recover(packed[block], done[block])
    found = packed[done, 1 + 2 * q.shape[1] :]
    lam[done], mu[done] = found[:, : lam.shape[1]], found[:, lam.shape[1] :]
    return done


def recovered(dynamics: Dynamics, work: Work, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """The same by the entries of the KKT matrix; none where there is no machine code for them."""
    none = np.zeros(times.size, dtype=bool)
    if times.size < FEW or route_of(dynamics) == "numpy":
        return none
    code = kkt_of(dynamics, products_of(dynamics))
    if code is None:
        return none
    kkt, analysis = code
    z = row_memory(kkt, analysis, dynamics.structure)
    linear = dynamics.structure.linear_reaction

    def recover(rows: Matrix, done: Any) -> None:
        recover_entries(z, linear, rows, done)
        work.add("residual_evaluations", int(done.sum()))

    return in_blocks(recover, work, times, q, v, lam, mu)
