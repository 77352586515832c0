"""Plans of steps: prescribed one by one, constant, or as long as the local error allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.request import StepPlan
from hhtbench.solution.result import Status
from solvers._start import Failure
from solvers.hht.control.controller import ControlOptions
from solvers.hht.control.first_step import STILL
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.formulas import CERTAIN, representable
from solvers.hht.step.state import State

UNKNOWN = np.zeros(1)
CRAWL = 1e-6  # steps shorter than this, relative to the rest of the interval, do not reach its end
LEFT_OVER = 1e-9  # a rest before ``stop`` shorter than this, relative to the step, is no step of its own


class Plan:
    """Determines the lengths of the next steps."""

    by_error: ByError | None = None  #: the plan itself, if it is under error control

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` steps from ``state`` towards ``stop`` [s]; zeros under error control."""
        return UNKNOWN, UNKNOWN

    def made(self, count: int) -> None:
        """Note that ``count`` of the planned steps were made."""

    def cut_short(self) -> None:
        """Note that the last step ended early at an event."""


class Prescribed(Plan):
    """The steps of a request, one after the other; after an event the rest of a step comes next."""

    def __init__(self, steps: StepPlan) -> None:
        self.steps, self.taken = steps, 0
        self._left_over = False

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` steps, or of the rest of one."""
        if self._left_over:
            end = self.steps.end(self.taken)
            return np.array([end - state.t]), np.array([end])
        return self.steps.ahead(self.taken, count)

    def made(self, count: int) -> None:
        """Note that ``count`` of the planned steps were made."""
        self.taken, self._left_over = self.taken + count, self._left_over and not count

    def cut_short(self) -> None:
        """Note that the rest of the last step comes next."""
        self.taken, self._left_over = self.taken - 1, True


@dataclass(frozen=True)
class Constant(Plan):
    """Steps of one length; the last before ``stop`` is shortened to end there."""

    h: float  #: signed [s]

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Length and end [s] of the next step, (1,) each."""
        h = representable(state.t, self.h)
        t1 = state.t + h
        if t1 != stop and (t1 - stop) * math.copysign(1.0, h) > -LEFT_OVER * abs(h):
            h, t1 = stop - state.t, stop
        return np.array([h]), np.array([t1])


@dataclass(frozen=True)
class ByError(Plan):
    """Steps as long as their local error (H26) is at most 1."""

    tolerances: Tolerances
    options: ControlOptions

    @property
    def by_error(self) -> ByError:  # type: ignore[override]
        """This plan, since it is under error control; None of any other plan."""
        return self

    def first(self, state: State) -> float:
        """Length |h| [s] to try first."""
        if state.memory is None:
            raise ValueError("the state was not prepared for step control.")
        return max(min(state.memory.h_next, self.options.max_step), self.options.min_step)

    def unreachable(self, state: State, stop: float) -> Failure | None:
        """Failure if the roundoff of q and v exceeds the tolerances of any step from ``state``; else None.

        Also None for a motion so regular that one step to ``stop`` [s] would meet the tolerances.
        """
        tolerances = self.tolerances
        if tolerances.above_roundoff or state.memory is None:
            return None
        memory = state.memory
        roundoff = tolerances.roundoff(state)
        if roundoff <= CERTAIN:
            return None
        left = abs(stop - state.t)
        change, h = memory.acceleration - memory.earlier, min(left, self.options.max_step)
        moves = float(np.abs(change).max()) > STILL * float(np.abs(memory.acceleration).max())
        with np.errstate(all="ignore"):
            error = tolerances.size(state, state, np.pad(h**3 / 12 * change / memory.last, (0, change.size)))  # (H27)
        crawls = state.h is not None and memory.h_next < CRAWL * left
        if not crawls and not (moves and error > 1.0):
            return None
        head = (
            f"at t = {exact(state.t)} the roundoff of q and v is {roundoff:.3g} times what the tolerances allow of a step: "
        )
        return Failure(Status.step_too_small, head + tolerances.reachable(state, self.first(state)))
