"""Multipliers of many rows by compiled loops, instead of one acceleration level in Python for each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.lowering import route_of
from solvers._start import Solving
from solvers.hht.run.kkt import kkt_of
from solvers.hht.run.rows import FEW, in_blocks
from solvers.hht.step.acceleration import recover

BLOCK = 256  # rows of the first call

Recover = Callable[[Matrix, Any], Any]  # (rows [t, q, v, lam, mu], done): fills rows and marks them


def many_recovered(recover: Recover, work: Work, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``; counted."""
    done, rows = np.zeros(times.size, dtype=bool), np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    in_blocks(times.size, BLOCK, lambda block: recover(rows[block], done[block]), lambda: work.clock.left() >= 0.0)
    found = rows[done, 1 + 2 * q.shape[1] :]
    lam[done], mu[done] = found[:, : lam.shape[1]], found[:, lam.shape[1] :]
    work.add("residual_evaluations", int(done.sum()))
    return done


def recovered(run: Solving, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """The same by the entries of the KKT matrix; none where there is no machine code for them."""
    dynamics, none = run.dynamics, np.zeros(times.size, dtype=bool)
    if times.size < FEW or route_of(dynamics) == "numpy":  # also where there is code: bits would depend on earlier solves
        return none
    entries = kkt_of(dynamics)
    if entries is None:
        return none
    return many_recovered(recover.following(entries.memory(dynamics)), run.work, times, q, v, lam, mu)
