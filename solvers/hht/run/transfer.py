"""A state on its way into the loops' memory and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.hht.equations.formulas import HIGHEST
from solvers.hht.loops import memory as mem
from solvers.hht.loops.memory import Memory, view
from solvers.hht.step.state import ControlMemory, Factorised, State


def load(z: Memory, state: State) -> None:
    """Put ``state`` into the loops' memory; its factorisation, if any, is in slot 0 already."""
    x, earlier, memory, made = state.unknowns, state.earlier, state.memory, state.factorised
    known = 0 if x is None else 1 + (0 if earlier is None else len(earlier))
    slot = -1.0 if made is None else 0.0
    view(z, mem.NUMBER)[:] = state.t, state.h or 0.0, state.size_q, state.size_v, known, slot
    if made is not None:
        record = view(z, mem.RECORD)
        record[mem.RATE], record[mem.USES] = made.rate, made.uses
    vectors: dict[int, Any] = {
        mem.Q: state.q,
        mem.V: state.v,
        mem.A: state.a,
        mem.F: state.f,
        mem.LAM: state.lam,
        mem.MU: state.mu,
        mem.VDOT: state.vdot,
    }
    vectors |= {mem.X_LAST: x, mem.X_EARLIER: earlier, mem.INVERSE_MASS: state.inverse_mass}
    if memory is not None:
        error, reaction = -1.0 if memory.error is None else memory.error, memory.velocity_reaction
        view(z, mem.CONTROL)[:] = memory.h_next, memory.last, error, reaction is not None
        vectors |= {mem.BEFORE: memory.earlier, mem.ACCELERATION: memory.acceleration, mem.REACTION_K: reaction}
    for section, values in vectors.items():
        if values is not None:
            view(z, section)[: values.size] = values.ravel()


def store(z: Memory, *, controlled: bool) -> State:
    """The state that the loops left in their memory."""
    t, h, size_q, size_v, known, slot = view(z, mem.NUMBER).tolist()
    own = _copies(z)
    memory = None
    if controlled:
        h_next, last, error, has_reaction = view(z, mem.CONTROL).tolist()
        memory = ControlMemory(
            h_next=h_next,
            last=last,
            earlier=own(mem.BEFORE),
            acceleration=own(mem.ACCELERATION),
            velocity_reaction=own(mem.REACTION_K) if has_reaction else None,
            error=None if error < 0.0 else error,
        )
    n = int(z.i[mem.N])
    return State(
        t=t,
        q=own(mem.Q),
        v=own(mem.V),
        a=own(mem.A),
        f=own(mem.F),
        h=h,
        lam=own(mem.LAM),
        mu=own(mem.MU),
        vdot=own(mem.VDOT),
        inverse_mass=own(mem.INVERSE_MASS).reshape(n, n) if z.i[mem.VARIABLE] else None,
        unknowns=own(mem.X_LAST),
        earlier=own(mem.X_EARLIER).reshape(HIGHEST, -1)[: int(known) - 1] if known > 1.0 else None,
        factorised=_factorised(z, int(slot)),
        size_q=size_q,
        size_v=size_v,
        memory=memory,
    )


def _copies(z: Memory) -> Any:
    return lambda section: view(z, section).copy()


def _factorised(z: Memory, slot: int) -> Factorised | None:
    if slot < 0:
        return None
    record = np.split(view(z, mem.RECORD), 2)[slot]
    at = np.split(view(z, mem.MADE_AT), 2)[slot].copy()
    return Factorised(at=at, rate=float(record[mem.RATE]), uses=int(record[mem.USES]))
