"""How long the next steps are to be: prescribed one by one, all alike, or as the local error allows, with its constants."""

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
CRAWL = 1e-6  # of what is left of the interval: steps as short as that do not get there
LEFT_OVER = 1e-9  # of a constant step: less than that before ``stop`` is no step of its own


class Plan:
    """Says how long the next steps are."""

    by_error: ByError | None = None  #: itself, where the local error decides

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` steps from ``state`` towards ``stop`` [s]; zeros by error."""
        return UNKNOWN, UNKNOWN

    def made(self, count: int) -> None:
        """``count`` of those have been made."""

    def cut_short(self) -> None:
        """The last of them ended early, at an event; the next one is whole again, or as long as its error allows."""


class Prescribed(Plan):
    """The steps of a request, one after the other; what an event leaves of one comes next."""

    def __init__(self, steps: StepPlan) -> None:
        self.steps, self.taken = steps, 0
        self._left_over = False

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` steps, or of what is left of one."""
        if self._left_over:
            end = self.steps.end(self.taken)
            return np.array([end - state.t]), np.array([end])
        return self.steps.ahead(self.taken, count)

    def made(self, count: int) -> None:
        """``count`` of those have been made."""
        self.taken, self._left_over = self.taken + count, self._left_over and not count

    def cut_short(self) -> None:
        """What is left of the last step comes next."""
        self.taken, self._left_over = self.taken - 1, True


@dataclass(frozen=True)
class Constant(Plan):
    """Steps of one length; the last before ``stop`` is cut to end there."""

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
    """Steps whose local error (H26) is at most 1, as long as that allows."""

    tolerances: Tolerances
    options: ControlOptions

    @property
    def by_error(self) -> ByError:  # type: ignore[override]
        """Itself."""
        return self

    def first(self, state: State) -> float:
        """|h| [s] to try first."""
        if state.memory is None:
            raise ValueError("the state was not prepared for step control.")
        return max(min(state.memory.h_next, self.options.max_step), self.options.min_step)

    def unreachable(self, state: State, stop: float) -> Failure | None:
        """Why no step from ``state`` can be short enough: roundoff of q and v is more than what is allowed of any.

        None where it is less, and in a motion whose v'' has no error that a single step towards ``stop`` [s] would show.
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
