"""A run that will not arrive: steps so short, and so many of them refused, that it ends early with the cause."""

from __future__ import annotations

import math
import time
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hhtbench.counting import uncounted
from hhtbench.result import Status
from solvers._start import Failure
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.run.engine import Engine
from solvers.hht.run.followed import followed
from solvers.hht.run.history import History
from solvers.hht.run.noise import noise
from solvers.hht.run.stepper import JUMP, Stepper
from solvers.hht.step.state import State

SETTLED = 500  # accepted steps before the first look, after which step control has long found its length
CROWDED = 5_000  # steps to the end of a run that are worth a look at what made them so many
MOST = 65_536  # steps between two looks
SECONDS = 3.0  # between two looks at a slow run: its end comes with the second one
FEWEST = 20  # steps between two looks, however slow they are
HOPELESS = 1e9  # steps to the end at the present pace: hours at least, and a thousand times the default budget
STANDSTILL = 1e6  # times as many steps as it has taken would have been needed to come this far: it was faster before
COUNTED = itemgetter("steps_rejected_newton", "steps_rejected_error", "jacobian_evaluations", "nonfinite_evaluations")
ENDLESS = 1e15  # the same of a run that nothing refuses, at an even pace: tens of years
EVEN, LEAST = 2.0, 2_000  # an even pace: this much faster than the whole run so far, after so many steps
PATIENCE = 5.0  # s before an even pace counts: what dies out slowly is even for long
REFUSED = 0.1  # of the attempts by Newton's iteration: without it a slow run is one that was asked for
MANY = 200_000  # steps through a noisy function, unless max_num_steps allows others: half an hour of calls in Python


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


class Looks:
    """Looks at a run under error control after so many steps or so much time, which tell whether it will arrive."""

    def __init__(self, stepper: Stepper, state: State, stop: float, history: History, most: int | None) -> None:
        """Of a run from ``state`` to ``stop`` [s] that may take ``most`` steps; None: nobody has said how many."""
        self._history = history
        self._engine, self._by_error, self._stop, self._most = stepper.engine, stepper.plan.by_error, stop, most
        self._first = self._before = pace_of(stepper.engine, 0, state.t)
        self._next, self._at = SETTLED if self._by_error else math.inf, time.perf_counter()
        self._began = self._at
        self._low = self._high = state.q  # of the places that were seen

    def room(self, count: int, taken: int) -> int:
        """``count`` steps, or as many as are left of those before the next look, after ``taken`` ones."""
        return int(min(count, self._next - taken))

    def ended(self, taken: int, state: State) -> Failure | None:
        """Why the run ends at ``state`` after ``taken`` steps, None where it goes on or it is no time for a look."""
        if self._by_error is None:
            return None
        self._low, self._high = np.minimum(self._low, state.q), np.maximum(self._high, state.q)
        late = time.perf_counter() - self._at > SECONDS and taken - self._before.taken >= FEWEST
        if not (late or taken >= self._next):
            return None
        paces = self._first, self._before, pace_of(self._engine, taken, state.t)
        self._before, self._next = paces[-1], taken + min(max(taken, SETTLED - taken), MOST)
        ended = hopeless(self._engine, paces, state, self._stop, self._by_error.tolerances, self._most)
        self._at = time.perf_counter()
        late = self._most is None and self._at - self._began >= PATIENCE
        return ended or (endless(paces, abs(self._stop - state.t)) if late else None)

    def arrived(self, taken: int, state: State) -> str:
        """What has made the ``taken`` steps to the end, at ``state``, so many, in words; or none."""
        return self._followed(state) if taken >= CROWDED else ""

    def many(self, taken: int, state: State) -> str:
        """Why ``taken`` steps do not lead further than to ``state``, as far as that is known, in words."""
        vibration = self._followed(state) if taken >= SETTLED else ""
        return f"{Status.max_steps.text} {vibration}".strip()

    def _followed(self, state: State) -> str:
        if self._by_error is None:
            return ""
        with uncounted():
            covered = float((self._high - self._low).max())
            return followed(self._engine, self._history, state, covered, self._by_error)


def hopeless(
    engine: Engine, paces: tuple[Pace, Pace, Pace], state: State, stop: float, tolerances: Tolerances, most: int | None
) -> Failure | None:
    """Why the run ends at ``state``, as :meth:`Engine.explain` tells it; None where it goes on to ``stop`` [s].

    ``paces``: at the start, at the last look, now; ``most`` steps may be taken.  A rough start before a long quiet rest is
    slow too: where only Newton's iteration complains, the run must have come to a standstill, beside the way that it has
    come.
    """
    first, before, now = paces
    if before is first and now.taken < SETTLED:  # steps are short at a start
        return None
    steps, refused, nonfinite = now.taken - before.taken, now.refused - before.refused, now.nonfinite - before.nonfinite
    left, made = abs(stop - now.t), abs(now.t - before.t)
    allowed = most or MANY
    late = steps * left > (allowed - now.taken) * made
    error = (state.memory and state.memory.error) or 1.0
    found = noise(engine, state, tolerances, state.h or 0.0, error) if late and uneven(before, now) else None
    if found and found.decides:
        needed = f"at the pace of the last {steps} steps {allowed} do not lead to the end"
        text = f"at t = {state.t:.17g} {needed}: {found.text}, loosen the tolerances, or allow more steps."
        return Failure(Status.step_too_small, text)
    if before is first or refused < REFUSED * (steps + refused) or steps * left <= HOPELESS * made:
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
    return Failure(Status.step_too_small, f"{text}; {JUMP}.")


def endless(paces: tuple[Pace, Pace, Pace], left: float) -> Failure | None:
    """Why a run at an even pace ends that would take more than ``ENDLESS`` steps for the ``left`` [s]; else None."""
    first, before, now = paces
    if before.taken < LEAST:
        return None
    steps, made, came = now.taken - before.taken, abs(now.t - before.t), abs(before.t - first.t)
    if not (steps * left > ENDLESS * made and made * before.taken <= EVEN * steps * came):
        return None
    text = (
        f"at t = {now.t:.17g} it will not arrive: {now.taken} steps came that far, and at the pace of the last {steps} "
        f"{steps * left / made if made else math.inf:.1g} more are needed: steps of {made / steps:.1g} s follow a motion "
        "that is so fast beside the interval; look at units and sizes, or take a shorter one; max_num_steps allows more."
    )
    return Failure(Status.max_steps, text)


def uneven(before: Pace, now: Pace) -> bool:
    """Whether many steps were rejected, or each took a matrix of its own: so it is where a force is no smooth function."""
    steps, rejected = now.taken - before.taken, now.rejected - before.rejected
    return rejected >= REFUSED * (steps + rejected) or now.matrices - before.matrices >= steps
