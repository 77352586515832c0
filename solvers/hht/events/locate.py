"""The step that ends at an event: the event function's zero as a function of the step's length."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhtbench.arguments import Vector
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.crossings import Crossing, zero
from solvers.hht.events.event import Event, value_of
from solvers.hht.loops.memory import CONVERGED, T_END
from solvers.hht.step.state import State

if TYPE_CHECKING:
    from solvers.hht.run.engine import Engine

NUDGE = 1e-7  # of the samples' distance: over it the slope of an event function is looked up
WIDER = 8.0  # factor between two looks for the other side of an event


Attempt = tuple[Vector, ...]  # what the loops' memory holds of an attempt at a step


def along(before: State, attempt: Attempt) -> HermiteOutput:
    """Dense output of one step."""
    numbers, end, n = attempt[0], attempt[2], before.q.size
    q1, v1 = end[:n], end[n : 2 * n]
    return HermiteOutput(np.array([before.t, numbers[T_END]]), np.stack([before.q, q1]), np.stack([before.v, v1]))


def step_to(engine: Engine, event: Event, crossing: Crossing, before: State, whole: Attempt) -> Attempt | None:
    """The attempt from ``before`` at whose own end ``event`` has just reached or crossed zero; each trial is an attempt.

    None where the steps' ends show no such change of sign: the interpolant alone had it.

    Raises
    ------
    NotMade
        A trial failed.
    """
    return _EndsAt(engine, event, crossing, before, whole).attempt()


class NotMade(Exception):
    """A trial step failed; ``ended`` as the loops say."""

    def __init__(self, ended: int) -> None:
        self.ended = ended
        super().__init__(f"a trial step ended with {ended}")


class _EndsAt:
    """The event function at the end of steps from ``before``, as a function of where they end."""

    def __init__(self, engine: Engine, event: Event, crossing: Crossing, before: State, whole: Attempt) -> None:
        self.engine, self.event, self.crossing, self.whole = engine, event, crossing, whole
        self.before = before
        self.start, self.end = before.t, float(whole[0][T_END])
        self.first = float(np.nextafter(self.start, self.end))  # the shortest step there is
        self.ahead = 1.0 if self.end > self.start else -1.0
        self.made: dict[float, tuple[Attempt, float]] = {}

    def attempt(self) -> Attempt | None:
        """The one that ends at the event."""
        bracket = self._bracket()
        if bracket is None:
            return None
        low, high = bracket
        t = low if low == high else zero(self.value, low, high)
        shift = self.ahead * float(np.spacing(abs(t)))
        while not self.crossed(t):
            t, shift = between(t + shift, t, high), 2 * shift
        return self.made[t][0]

    def value(self, t: float) -> float:
        """The event function at the end of the step that ends at ``t``."""
        if t not in self.made:
            if t == self.end:
                attempt = self.whole
            else:
                ended = self.engine.try_step(t - self.start, t)
                if ended != CONVERGED:
                    raise NotMade(ended)
                attempt = self.engine.attempted()
            n, end = self.before.q.size, attempt[2]
            self.made[t] = attempt, value_of(self.event, t, end[:n], end[n : 2 * n], self.engine.work)
        return self.made[t][1]

    def crossed(self, t: float) -> bool:
        """Whether the function is zero or beyond at the end of the step that ends at ``t``."""
        return self.value(t) * self.crossing.side <= 0

    def _bracket(self) -> tuple[float, float] | None:
        """Ends of two steps, before the event and at or after it."""
        t = between(self.crossing.t, self.first, self.end)
        toward = -1.0 if self.crossed(t) else 1.0
        width = self._width(t)
        while True:
            other = between(t + toward * self.ahead * width, self.first, self.end)
            if self.crossed(other) is (toward > 0):
                return (t, other) if toward > 0 else (other, t)
            if toward > 0 and other == self.end:
                return None
            if toward < 0 and other == self.first:
                return (other, other) if self.crossing.bracket[0] == self.start else None
            t, width = other, WIDER * width

    def _width(self, t: float) -> float:
        """[s] from ``t`` past the event, by the slope of the function along the step's dense output."""
        low, high = self.crossing.bracket
        h = NUDGE * abs(high - low)
        output = along(self.before, self.whole)
        times = [between(s, self.start, self.end) for s in (t - h, t + h)]
        values = [value_of(self.event, s, *output(s), self.engine.work) for s in times]
        rise = abs(values[1] - values[0])
        smallest = 2 * float(np.spacing(abs(t)))
        return smallest if rise == 0 else max(4 * abs(self.value(t)) / rise * abs(times[1] - times[0]), smallest)


def between(t: float, one: float, other: float) -> float:
    """``t``, or the nearer of two limits where it is not between them."""
    return min(max(t, min(one, other)), max(one, other))
