"""A run that will not arrive: steps so short, and so many of them refused by Newton's iteration, that it ends early."""

from __future__ import annotations

from dataclasses import dataclass

from hhtbench.result import Status
from solvers._start import Failure
from solvers.hht.run.engine import Engine
from solvers.hht.step.state import State

LOOK = 1_000  # accepted steps before the first look: step control has then long found its length
HOPELESS = 1e9  # steps to the end at the present pace: hours at least, and a thousand times the default budget
STUCK = 1e6  # times as many steps as it has taken would have been needed to come this far: it was faster before
REFUSED = 0.1  # of the attempts by Newton's iteration: without it a slow run is one that was asked for


@dataclass(frozen=True)
class Pace:
    """How far a run under error control has come."""

    taken: int  #: accepted steps
    t: float  #: [s]
    refused: int  #: attempts that Newton's iteration did not solve
    nonfinite: int  #: evaluations that gave no numbers


def pace_of(engine: Engine, taken: int, t: float) -> Pace:
    """After ``taken`` steps, at ``t`` [s]."""
    tally = engine.work.tally
    return Pace(taken, t, tally["steps_rejected_newton"], tally["nonfinite_evaluations"])


def hopeless(engine: Engine, paces: tuple[Pace, Pace, Pace], state: State, stop: float) -> Failure | None:
    """Why the run ends at ``state``, as :meth:`Engine.explain` tells it; None where it goes on to ``stop`` [s].

    ``paces``: at the start, at the last look, now.  A rough start before a long quiet rest is slow too: where only Newton's
    iteration complains, the run must have come to a standstill, beside the way that it has come.
    """
    first, before, now = paces
    steps, refused, nonfinite = now.taken - before.taken, now.refused - before.refused, now.nonfinite - before.nonfinite
    left, made = abs(stop - now.t), abs(now.t - before.t)
    if refused < REFUSED * (steps + refused) or steps * left <= HOPELESS * made:
        return None
    if nonfinite < refused and steps * abs(now.t - first.t) <= STUCK * made:
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
