"""A run that will not arrive: steps so short, and so many of them refused, that it ends early with the cause."""

from __future__ import annotations

from contextlib import suppress
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hhtbench.counting import uncounted
from hhtbench.errors import NonFiniteValue
from hhtbench.result import Status
from solvers._start import Failure
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.run.engine import Engine
from solvers.hht.run.stepping import MAX_STEPS
from solvers.hht.step.state import State

LOOK = 500  # accepted steps before the first look: about those of a first call
SETTLED = 1_000  # accepted steps after which step control has long found its length
HOPELESS = 1e9  # steps to the end at the present pace: hours at least, and a thousand times the default budget
STANDSTILL = 1e6  # times as many steps as it has taken would have been needed to come this far: it was faster before
COUNTED = itemgetter("steps_rejected_newton", "steps_rejected_error", "jacobian_evaluations", "nonfinite_evaluations")
REFUSED = 0.1  # of the attempts by Newton's iteration: without it a slow run is one that was asked for
MANY = 200_000  # steps through a noisy force, unless max_num_steps allows others: half an hour of calls in Python
NOISY = 0.01  # of what a step's error may be: noise that lengths of steps are found by; two calls may differ by little


class Pace(NamedTuple):
    """How far a run under error control has come."""

    taken: int  #: accepted steps
    t: float  #: [s]
    refused: int  #: attempts that Newton's iteration did not solve
    rejected: int  #: attempts whose error was too large
    matrices: int  #: of Newton's iteration that were made
    nonfinite: int  #: evaluations that gave no numbers


def pace_of(engine: Engine, taken: int, t: float) -> Pace:
    """After ``taken`` steps, at ``t`` [s]."""
    return Pace(taken, t, *COUNTED(engine.work.tally))


def hopeless(
    engine: Engine, paces: tuple[Pace, Pace, Pace], state: State, stop: float, tolerances: Tolerances, most: int | None
) -> Failure | None:
    """Why the run ends at ``state``, as :meth:`Engine.explain` tells it; None where it goes on to ``stop`` [s].

    ``paces``: at the start, at the last look, now; ``most`` steps may be taken.  A rough start before a long quiet rest is
    slow too: where only Newton's iteration complains, the run must have come to a standstill, beside the way that it has
    come.
    """
    first, before, now = paces
    steps, refused, nonfinite = now.taken - before.taken, now.refused - before.refused, now.nonfinite - before.nonfinite
    left, made = abs(stop - now.t), abs(now.t - before.t)
    allowed = MANY if most is None or most == MAX_STEPS else most
    late = steps * left > (allowed - now.taken) * made
    if late and uneven(before, now) and (text := noisy_force(engine, state, tolerances)):
        needed = f"at the pace of the last {steps} steps {allowed} do not lead to the end"
        return Failure(Status.step_too_small, f"at t = {state.t:.17g} {needed}: {text}")
    if now.taken < SETTLED or refused < REFUSED * (steps + refused) or steps * left <= HOPELESS * made:
        return None
    if nonfinite < refused and steps * abs(now.t - first.t) <= STANDSTILL * made:
        return None
    text = (
        f"it will not arrive: the last {steps} steps came from t = {before.t:.17g} to {now.t:.17g} and at that pace "
        f"{steps * left / made if made else float('inf'):.1g} more are needed, while Newton's iteration refuses "
        f"{refused / (steps + refused):.0%} of them"
    )
    cause = engine.explain(state, now.t) if nonfinite >= refused else None
    if nonfinite >= refused:
        return Failure(Status.nonfinite_callback, f"{cause or 'a value is not finite'}, again and again; {text}.")
    return Failure(Status.newton_failed, f"{text}; look for a jump in the forces, or a wrong derivative.")


def uneven(before: Pace, now: Pace) -> bool:
    """Whether many steps were rejected, or each took a matrix of its own: so it is where a force is no smooth function."""
    steps, rejected = now.taken - before.taken, now.rejected - before.rejected
    return rejected >= REFUSED * (steps + rejected) or now.matrices - before.matrices >= steps


def noisy_force(engine: Engine, state: State, tolerances: Tolerances) -> str:
    """That two calls of the force with the same arguments differ by as much as steps are short for, in words; else empty.

    Noise enters v with h and q with h^2: every noise has steps that are short enough, but they may be too many.
    """
    h = abs(state.h or 0.0)
    with suppress(NonFiniteValue), uncounted():
        one, other = (engine.bare_force(state.t, state.q, state.v)[: state.q.size] for _ in range(2))
        noise = np.abs(one - other)
        if tolerances.size(state, state, np.concatenate([h * h * noise, h * noise])) > NOISY:
            relative = float(noise.max()) / (float(np.abs(one).max()) or 1.0)
            return (
                f"two calls of the force, or of the mass, with the same arguments differ by {relative:.2g} of their size, "
                f"which takes steps of {h:.2g} s: make them functions of t, q and v alone, loosen the tolerances, "
                "or allow more steps."
            )
    return ""
