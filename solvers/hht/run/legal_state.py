"""Whether what a checkpoint holds can be a state of this system's steps: nothing else is computed with."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from solvers.hht.equations.known import GIVEN, HEAD
from solvers.hht.run.engine import Engine
from solvers.hht.run.loops import misfits, misshapen
from solvers.hht.run.stepping import IntegratorState
from solvers.hht.step.state import Factorised, State

BEFORE = len(GIVEN) + len(HEAD)  # numbers of the step and of the state, which stand before its q and v
SHORTEST, LONGEST = 1e-150, 1e150  # [s] of a step: squares of what is beyond, and of their ratios, leave the numbers


def check(integrator: IntegratorState, engine: Engine, events: int) -> None:
    """Raise ProblemError unless ``integrator`` is a legal state of steps by ``engine`` with as many events."""
    n, given, s, rows = engine.structure.n, engine.functions.given[0], integrator, integrator.last.t.size
    shapes: list[tuple[Any, dict[str, Any]]] = [
        (s.place, {"q": (n,), "v": (n,)}),
        (s.tolerances, {"rtol": (2 * n,), "atol": (2 * n,)}),
        (s.watch, {"values": (events,)}),
        (s.last, {"t": (max(rows, 1),), "q": (rows, n), "v": (rows, n)}),
        *((found, {"q": (n,), "v": (n,)}) for found in s.occurrences),
    ]
    wrong = misfits(s.state, engine.layout, given)
    wrong += [text for owner, wanted in shapes for text in misshapen(owner, wanted)]
    wrong = wrong or _contradictions(s, given, events)
    if wrong:
        raise ProblemError(f"the checkpoint does not fit this system: {wrong[0]}.")


def _contradictions(s: IntegratorState, given: int, events: int) -> list[str]:
    """What contradicts something else, in words."""
    state, memory, t = s.state, s.state.memory, s.last.t
    named = {
        "either a step or tolerances are needed": (s.step is None) == (s.tolerances is None),
        "a step must not be zero": s.step == 0.0 or not (state.h is None or _is_length(state.h, state.t)),
        "the direction of time must be 1, -1 or 0": s.direction not in (-1.0, 0.0, 1.0),
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
