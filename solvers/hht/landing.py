"""The step that ends at an event: the event function's zero as a function of the step's length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solvers._start import Failure
from solvers.hht.dense import HermiteOutput
from solvers.hht.engine import HostEngine
from solvers.hht.events import Crossing, Event, value_of, zero
from solvers.hht.state import State, Step

NUDGE = 1e-7  # of the samples' distance: over it the slope of an event function is looked up
WIDER = 8.0  # factor between two looks for the other side of an event


def along(before: State, step: Step) -> HermiteOutput:
    """Dense output of one step."""
    after = step.state
    return HermiteOutput(np.array([before.t, after.t]), np.stack([before.q, after.q]), np.stack([before.v, after.v]))


def land(engine: HostEngine, event: Event, crossing: Crossing, before: State, whole: Step) -> Step | Failure | None:
    """The step from ``before`` at whose own end ``event`` has just reached or crossed zero; each trial is a step.

    None where the steps' ends show no such change of sign: the interpolant alone had it.
    """
    try:
        return _Landing(engine, event, crossing, before, whole).step()
    except _NotMade as error:
        return error.failure


class _NotMade(Exception):
    """A trial step failed."""

    def __init__(self, failure: Failure) -> None:
        self.failure = failure
        super().__init__(failure.message)


class _Landing:
    """The event function at the end of steps from ``before``, as a function of where they end."""

    def __init__(self, engine: HostEngine, event: Event, crossing: Crossing, before: State, whole: Step) -> None:
        self.engine, self.event, self.crossing, self.whole = engine, event, crossing, whole
        self.before = before
        self.start, self.end = before.t, whole.state.t
        self.first = float(np.nextafter(self.start, self.end))  # the shortest step there is
        self.ahead = 1.0 if self.end > self.start else -1.0
        self.made: dict[float, tuple[Step, float]] = {}

    def step(self) -> Step | None:
        """The landing step."""
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
            self.engine.work.check_time()
            taken = self.whole if t == self.end else self.engine.step(self.before, t - self.start, t)
            if isinstance(taken, Failure):
                raise _NotMade(taken)
            self.before = replace(self.before, factor=taken.state.factor)  # the next trial is about as long
            self.made[t] = taken, value_of(self.event, t, taken.state.q, taken.state.v, self.engine.work)
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
