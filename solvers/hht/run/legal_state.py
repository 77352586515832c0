"""Whether what a checkpoint holds can be a state of this system's steps: nothing else is computed with."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from solvers.hht.equations.formulas import HIGHEST
from solvers.hht.equations.known import GIVEN, HEAD, Layout
from solvers.hht.run.engine import Engine
from solvers.hht.run.stepping import IntegratorState
from solvers.hht.step.state import Factorised, State

BEFORE = len(GIVEN) + len(HEAD)  # numbers of the step and of the state, which stand before its q and v
SHORTEST, LONGEST = 1e-150, 1e150  # [s] of a step: squares of what is beyond, and of their ratios, leave the numbers


def check(integrator: IntegratorState, engine: Engine, events: int) -> None:
    """Raise ProblemError unless ``integrator`` is a legal state of steps by ``engine`` with as many events."""
    mass = engine.layout.structure.mass
    wrong = _misshapen(integrator, engine.layout, engine.functions.given[0], events) or _misfits(
        integrator, mass, engine.functions.given[0], events
    )
    if wrong:
        raise ProblemError(f"the checkpoint does not fit this system: {wrong[0]}.")


def _misshapen(s: IntegratorState, layout: Layout, given: int, events: int) -> list[str]:
    """Arrays of a wrong shape, in words."""
    n, m, p, size = layout.structure.n, layout.structure.m, layout.structure.p, layout.size
    state, rows = s.state, s.last.t.size
    known = 0 if state.earlier is None else min(state.earlier.size // size, HIGHEST)
    wanted: list[tuple[Any, dict[str, Any]]] = [
        (s.place, {"q": (n,), "v": (n,)}),
        (state, dict.fromkeys(("q", "v", "a", "f", "vdot"), (n,)) | {"lam": (m,), "mu": (p,)}),
        (state, {"inverse_mass": (n, n), "unknowns": (size,), "earlier": (known, size)}),
        (state.memory, dict.fromkeys(("earlier", "acceleration", "velocity_reaction"), (n,))),
        (state.factorised, {"at": (size + given,)}),
        (s.tolerances, {"rtol": (2 * n,), "atol": (2 * n,)}),
        (s.watch, {"values": (events,)}),
        (s.last, {"t": (max(rows, 1),), "q": (rows, n), "v": (rows, n)}),
        *((found, {"q": (n,), "v": (n,)}) for found in s.occurrences),
    ]
    found = []
    for owner, shapes in wanted:
        for name, shape in shapes.items() if owner is not None else ():
            value = getattr(owner, name)
            if value is not None and (value.shape != shape or value.dtype != np.float64):
                found.append(f"{type(owner).__name__}.{name} must have shape {shape}; got {value.dtype} {value.shape}")
    return found


def _misfits(s: IntegratorState, mass: str, given: int, events: int) -> list[str]:
    """What contradicts something else, in words."""
    state, memory, t = s.state, s.state.memory, s.last.t
    named = {
        "either a step or tolerances are needed": (s.step is None) == (s.tolerances is None),
        "a step must not be zero": s.step == 0.0 or not (state.h is None or _is_length(state.h, state.t)),
        "the direction of time must be 1, -1 or 0": s.direction not in (-1.0, 0.0, 1.0),
        f"the mass is {mass}": (state.inverse_mass is None) == (mass == "variable"),
        "sizes must not be negative": min(state.size_q, state.size_v) < 0,
        "State.factorised must be of a step": state.factorised is not None
        and not _is_factorised(state.factorised, state, given),
        "the next step must be positive": memory is not None and not memory.h_next > 0.0,
        "tolerances must not be negative": s.tolerances is not None
        and min(s.tolerances.rtol.min(), s.tolerances.atol.min()) < 0.0,
        f"there are {events} events": len(s.watch.counts) != events
        or not all(0 <= i < events for i in (*s.watch.changed, *(found.index for found in s.occurrences))),
        "the last step must end at the state": not t.size or t[-1] != state.t,
    }
    return [text for text, broken in named.items() if broken]


def _is_factorised(made: Factorised, state: State, given: int) -> bool:
    """Whether it can have been made in a step that ended at ``state``: changes of q and v are measured by it."""
    n, size = state.q.size, made.at.size - given
    h, (q, v) = float(made.at[size]), np.split(made.at[size + BEFORE : size + BEFORE + 2 * n], 2)
    seen = float(np.abs(q).max()) <= state.size_q and float(np.abs(v).max()) <= state.size_v
    return seen and _is_length(h, state.t) and min(made.rate, made.uses) >= 0


def _is_length(h: float, t: float) -> bool:
    """Whether a step of ``h`` [s] can have ended at ``t``."""
    return max(float(np.spacing(abs(t))) / 2, SHORTEST) <= abs(h) <= LONGEST
