"""Multipliers of rows of output from the acceleration level, (H16), many rows in one call of the loops."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import NotNative
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import MachineCode
from solvers.hht.run.recover import recover_entries, row_memory
from solvers.hht.step.acceleration import recover

FEW = 20  # rows below which their multipliers are found one by one, where no code is there for them
FIRST = 512  # rows of the first call, and FEW of a NumPy system
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are looked at between


def recovered(engine: Engine, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``."""
    done = np.zeros(times.size, dtype=bool)
    packed = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    recover_block = _by_blocks(engine, packed, done)
    if recover_block is None:
        return done
    loops, clock, first, block = engine.loops, engine.work.clock, 0, FIRST if engine.points else FEW
    while first < times.size and clock.left() >= 0.0 and loops.callbacks.cause is None:
        began = time.perf_counter()
        recover_block(slice(first, first + block))
        first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
    found, m = packed[:, 1 + 2 * engine.structure.n :], engine.structure.m
    which = slice(None) if np.count_nonzero(done) == done.size else done
    lam[which], mu[which] = found[which, :m], found[which, m:]
    loops.raise_noted()
    return done


def _by_blocks(engine: Engine, packed: Matrix, done: Any) -> Callable[[slice], Any] | None:
    """What recovers a block of rows: the loops' own acceleration level, or code for many rows; None: there is none."""
    functions, loops, s = engine.functions, engine.loops, engine.structure
    if engine.plain or not isinstance(functions, MachineCode):
        return None
    if loops.z.i[mem.C_KKT]:
        return lambda block: loops.call_noting(recover, packed[block], done[block])
    if len(packed) < FEW:
        return None
    try:
        kkt, analysis = functions.kkt
    except NotNative:  # more operations than pay, say
        return None
    if analysis.kind == "sparse":  # Python would factorise
        return None
    z, places = row_memory(kkt, analysis, s, calls_python=not engine.points)

    def recover_block(block: slice) -> None:
        with loops.callbacks:
            recover_entries(z, s.linear_reaction, places, packed[block], done[block])
        engine.work.add("residual_evaluations", engine.points * int(done[block].sum()))

    return recover_block
