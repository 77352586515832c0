"""Multipliers of output rows from the acceleration level, (H16), many rows in one compiled call."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.errors import NonFiniteValue
from solvers.hht.run.blend import blend
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import MachineCode
from solvers.hht.run.history import OutputRows
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import recover
from solvers.kernel.blocks import FEW, FIRST, in_blocks
from solvers.kernel.kkt import kkt_of

RecoverPlaces = Callable[[Matrix, Any], Any]  # (places [t, q, v, lam, mu], done): fills multipliers and marks them


def recovered(engine: Engine, output: OutputRows) -> Any:
    """Recover the multipliers of ``output``: by (H60) between the ends of steps, else by (H16); mask (k,) of rows done."""
    rows, done = output.rows, np.zeros(len(output.rows), dtype=bool)
    by_code = _by_code(engine, len(rows))
    recover_places = by_code or _in_python(engine)
    clock, callbacks = engine.work.clock, engine.loops.callbacks

    def recover_block(block: slice) -> None:
        between = None if output.between is None else np.flatnonzero(output.between[block])
        if between is not None and between.size:
            blended = rows[block][between]
            done[block][between] = blend(blended, output.steps, recover_places)
            rows[block][between] = blended
        if by_code is not None and callbacks.cause is None:
            _recover_rest(rows[block], done[block], by_code)

    going = lambda: clock.left() >= 0.0 and callbacks.cause is None  # noqa: E731
    in_blocks(len(rows), FIRST if by_code and engine.points else FEW if by_code else 1, recover_block, going)
    engine.loops.raise_noted()
    return done


def _recover_rest(rows: Matrix, done: Any, recover_places: RecoverPlaces) -> None:
    """Recover the multipliers of ``rows`` not yet ``done``, at their own states."""
    if not np.count_nonzero(done):  # without copies
        recover_places(rows, done)
        return
    rest = np.flatnonzero(~done)
    places, found = rows[rest], np.zeros(rest.size, dtype=bool)
    recover_places(places, found)
    rows[rest], done[rest] = places, found


def _by_code(engine: Engine, count: int) -> RecoverPlaces | None:
    """Compiled recovery for ``count`` rows: the loops' acceleration level or code of entries; None if there is none."""
    functions, loops = engine.functions, engine.loops
    if engine.plain or not isinstance(functions, MachineCode):
        return None
    if loops.has_level:
        return partial(loops.call_noting, recover)
    entries = kkt_of(functions.dynamics) if count >= FEW else None
    if entries is None:  # more operations than pay, say
        return None
    z = entries.memory(functions.dynamics)
    z.i[mem.CALLS_PYTHON] = not engine.points
    call = recover.following(z)

    def recover_places(places: Matrix, done: Any) -> None:
        with loops.callbacks:
            call(places, done)
        engine.work.add("residual_evaluations", engine.points * int(done.sum()))

    return recover_places


def _in_python(engine: Engine) -> RecoverPlaces:
    """Recovery row by row in Python; rows with values that are not finite are skipped."""
    s = engine.structure

    def recover_places(places: Matrix, done: Any) -> None:
        for i, place in enumerate(places):
            q, v, lam, mu = np.split(place[1:], np.cumsum((s.n, s.n, s.m)))
            with suppress(NonFiniteValue):
                found = engine.acceleration.solve(float(place[0]), q, v, lam, mu)
                engine.work.add("residual_evaluations", engine.points)
                done[i] = found.converged
                lam[:], mu[:] = found.lam, found.mu

    return recover_places
