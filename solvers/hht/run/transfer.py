"""A state on its way into the loops' memory and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.hht.equations.formulas import HIGHEST
from solvers.hht.step.memory import (
    ACCELERATION,
    BEFORE,
    CONTROL,
    INVERSE_MASS,
    LAM,
    MADE_AT,
    MADE_H,
    MU,
    NUMBER,
    RATE,
    REACTION_K,
    RECORD,
    USES,
    VARIABLE,
    VDOT,
    X_EARLIER,
    X_LAST,
    A,
    F,
    N,
    Q,
    V,
    view,
)
from solvers.hht.step.memory import Memory as Arrays
from solvers.hht.step.state import Factorised, Memory, State


def load(z: Arrays, state: State) -> None:
    """Put ``state`` into the loops' memory; its factorisation, if any, is in slot 0 already."""
    x, earlier, memory, made = state.unknowns, state.earlier, state.memory, state.factorised
    known = 0 if x is None else 1 + (0 if earlier is None else len(earlier))
    slot = -1.0 if made is None else 0.0
    view(z, NUMBER)[:] = state.t, state.h or 0.0, state.size_q, state.size_v, known, slot
    if made is not None:
        record = view(z, RECORD)
        record[RATE], record[USES] = made.rate, made.uses
    vectors: dict[int, Any] = {
        Q: state.q,
        V: state.v,
        A: state.a,
        F: state.f,
        LAM: state.lam,
        MU: state.mu,
        VDOT: state.vdot,
    }
    vectors |= {X_LAST: x, X_EARLIER: earlier, INVERSE_MASS: state.inverse_mass}
    if memory is not None:
        error, reaction = -1.0 if memory.error is None else memory.error, memory.velocity_reaction
        view(z, CONTROL)[:] = memory.h_next, memory.last, error, reaction is not None
        vectors |= {BEFORE: memory.earlier, ACCELERATION: memory.acceleration, REACTION_K: reaction}
    for section, values in vectors.items():
        if values is not None:
            view(z, section)[: values.size] = values.ravel()


def store(z: Arrays, *, controlled: bool) -> State:
    """The state that the loops left in their memory."""
    t, h, size_q, size_v, known, slot = view(z, NUMBER).tolist()
    own = _copies(z)
    memory = None
    if controlled:
        h_next, last, error, has_reaction = view(z, CONTROL).tolist()
        memory = Memory(
            h_next=h_next,
            last=last,
            earlier=own(BEFORE),
            acceleration=own(ACCELERATION),
            velocity_reaction=own(REACTION_K) if has_reaction else None,
            error=None if error < 0.0 else error,
        )
    n = int(z.i[N])
    return State(
        t=t,
        q=own(Q),
        v=own(V),
        a=own(A),
        f=own(F),
        h=h,
        lam=own(LAM),
        mu=own(MU),
        vdot=own(VDOT),
        inverse_mass=own(INVERSE_MASS).reshape(n, n) if z.i[VARIABLE] else None,
        unknowns=own(X_LAST),
        earlier=own(X_EARLIER).reshape(HIGHEST, -1)[: int(known) - 1] if known > 1.0 else None,
        factorised=_factorised(z, int(slot)),
        size_q=size_q,
        size_v=size_v,
        memory=memory,
    )


def _copies(z: Arrays) -> Any:
    return lambda section: view(z, section).copy()


def _factorised(z: Arrays, slot: int) -> Factorised | None:
    if slot < 0:
        return None
    record = np.split(view(z, RECORD), 2)[slot]
    at = np.split(view(z, MADE_AT), 2)[slot].copy()
    return Factorised(at=at, h=float(record[MADE_H]), rate=float(record[RATE]), uses=int(record[USES]))
