"""Multipliers of rows of output from the acceleration level, (H16), many rows in one call of the loops."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import MachineCode
from solvers.hht.step.acceleration import recover

FEW = 20  # rows below which their multipliers are found one by one, where no code is there for them
FIRST = 512  # rows of the first call, and FEW of a NumPy system
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are looked at between


def recovered(engine: Engine, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``."""
    done = np.zeros(times.size, dtype=bool)
    if engine.plain or not isinstance(engine.functions, MachineCode):
        return done
    loops, clock, packed = engine.loops, engine.work.clock, np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    for_rows_only = not loops.z.i[mem.C_KKT]
    if for_rows_only and times.size < FEW:
        return done
    if for_rows_only:
        loops.z.i[mem.C_KKT : mem.C_KKT + 2] = engine.functions.kkt.pair
    first, block = 0, FIRST if engine.points else FEW
    while first < times.size and clock.left() >= 0.0 and loops.callbacks.cause is None:
        block_of, began = slice(first, first + block), time.perf_counter()
        loops.call_noting(recover, packed[block_of], done[block_of])
        first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
    if for_rows_only:
        loops.z.i[mem.C_KKT] = 0  # the loops go on as before
    found, m = packed[:, 1 + 2 * engine.structure.n :], engine.structure.m
    which = slice(None) if done.all() else done
    lam[which], mu[which] = found[which, :m], found[which, m:]
    loops.raise_noted()
    return done
