"""A state on its way into the loops' memory and back."""

from __future__ import annotations

from typing import Any

from hhtbench.errors import ProblemError
from solvers.hht.equations.formulas import HIGHEST
from solvers.hht.loops import memory as mem
from solvers.hht.loops.memory import Memory, view
from solvers.hht.step.state import ControlMemory, Factorised, State


def expect_fits(z: Memory, state: State) -> None:
    """Raise unless every array of ``state`` is as long as its section of the memory.

    Raises
    ------
    ProblemError
        It is a state of another system, or of other options.
    """
    earlier, made = state.earlier, state.factorised
    size, most = view(z, mem.X_LAST).size, HIGHEST if earlier is None else len(earlier)
    wanted = {section: view(z, section).size for section in _vectors(state)}
    found = {section: values.size for section, values in _vectors(state).items()}
    fits = wanted | {mem.X_EARLIER: most * size} == found | {mem.X_EARLIER: most * size if earlier is None else earlier.size}
    fits &= most <= HIGHEST and (made is None or made.at.size == view(z, mem.MADE_AT).size)
    if not fits or (z.i[mem.VARIABLE] == 1) == (state.inverse_mass is None):
        raise ProblemError("the state is none of this system with these options: its arrays are of other lengths.")


def _vectors(state: State) -> dict[int, Any]:
    """The arrays of ``state`` by their section, but for those of earlier steps."""
    memory = state.memory
    vectors: dict[int, Any] = {mem.Q: state.q, mem.V: state.v, mem.A: state.a, mem.F: state.f, mem.LAM: state.lam}
    vectors |= {mem.MU: state.mu, mem.VDOT: state.vdot, mem.X_LAST: state.unknowns, mem.INVERSE_MASS: state.inverse_mass}
    if memory is not None:
        vectors |= {mem.BEFORE: memory.earlier, mem.ACCELERATION: memory.acceleration}
        vectors |= {mem.REACTION_K: memory.velocity_reaction}
    return {section: values for section, values in vectors.items() if values is not None}


def load(z: Memory, state: State) -> None:
    """Put ``state``, which fits, into the loops' memory; its factorisation, if any, is in slot 0 already."""
    x, earlier, memory, made = state.unknowns, state.earlier, state.memory, state.factorised
    known = 0 if x is None else 1 + (0 if earlier is None else len(earlier))
    slot = -1.0 if made is None else 0.0
    view(z, mem.NUMBER)[:] = state.t, state.h or 0.0, state.size_q, state.size_v, known, slot
    if made is not None:
        record = view(z, mem.RECORD)
        record[mem.RATE], record[mem.USES] = made.rate, made.uses
    if memory is not None:
        error = -1.0 if memory.error is None else memory.error
        view(z, mem.CONTROL)[:] = memory.h_next, memory.last, error, memory.velocity_reaction is not None
    for section, values in _vectors(state).items():
        view(z, section)[:] = values.ravel()
    if earlier is not None:
        view(z, mem.X_EARLIER)[: earlier.size] = earlier.ravel()


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
    record, at = view(z, mem.RECORD + slot), view(z, mem.MADE_AT + slot).copy()
    return Factorised(at=at, rate=float(record[mem.RATE]), uses=int(record[mem.USES]))
