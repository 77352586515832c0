"""Multipliers of rows of output from the acceleration level, (H16), many rows in one call of the loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import MachineCode
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import recover
from solvers.kernel.blocks import FEW, FIRST, in_blocks
from solvers.kernel.kkt import kkt_of


def recovered(engine: Engine, rows: Matrix) -> Any:
    """Which of the ``rows`` (k, ...) [t, q, v, lam, mu] got their multipliers from the acceleration level."""
    done = np.zeros(len(rows), dtype=bool)
    recover_block = _by_blocks(engine, rows, done)
    if recover_block is None:
        return done
    loops, clock = engine.loops, engine.work.clock
    going = lambda: clock.left() >= 0.0 and loops.callbacks.cause is None  # noqa: E731
    in_blocks(len(rows), FIRST if engine.points else FEW, recover_block, going)
    loops.raise_noted()
    return done


def _by_blocks(engine: Engine, rows: Matrix, done: Any) -> Callable[[slice], Any] | None:
    """What recovers a block of rows: the loops' own acceleration level, or code for many rows; None: there is none."""
    functions, loops = engine.functions, engine.loops
    if engine.plain or not isinstance(functions, MachineCode):
        return None
    if loops.has_level:
        return lambda block: loops.call_noting(recover, rows[block], done[block])
    entries = kkt_of(functions.dynamics) if len(rows) >= FEW else None
    if entries is None:  # more operations than pay, say
        return None
    z = entries.memory(functions.dynamics)
    z.i[mem.CALLS_PYTHON] = not engine.points
    call = recover.following(z)

    def recover_block(block: slice) -> None:
        with loops.callbacks:
            call(rows[block], done[block])
        engine.work.add("residual_evaluations", engine.points * int(done[block].sum()))

    return recover_block
