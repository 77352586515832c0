"""Multipliers of many rows by compiled loops, instead of one acceleration level in Python for each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.lowering import Dynamics, route_of
from solvers.hht.run.kkt import kkt_of
from solvers.hht.run.rows import FEW, in_blocks
from solvers.hht.step import acceleration

BLOCK = 256  # rows of the first call

Recover = Callable[[Matrix, Any], Any]  # (rows [t, q, v, lam, mu], done): fills rows and marks them


def recovered(
    dynamics: Dynamics, work: Work, recover: Recover | None, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix
) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``; counted.

    By ``recover``, or the entries of the KKT matrix; none where there is no machine code for them.
    """
    done = np.zeros(times.size, dtype=bool)
    recover = recover or _by_entries(dynamics, times.size)
    if recover is None:
        return done
    rows = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    in_blocks(times.size, BLOCK, lambda block: recover(rows[block], done[block]), lambda: work.clock.left() >= 0.0)
    found = rows[done, 1 + 2 * q.shape[1] :]
    lam[done], mu[done] = found[:, : lam.shape[1]], found[:, lam.shape[1] :]
    work.add("residual_evaluations", int(done.sum()))
    return done


def _by_entries(dynamics: Dynamics, count: int) -> Recover | None:
    """Code for ``count`` rows; none for few, also where there is some: bits would depend on earlier solves."""
    entries = kkt_of(dynamics) if count >= FEW and route_of(dynamics) != "numpy" else None
    return None if entries is None else acceleration.recover.following(entries.memory(dynamics))
