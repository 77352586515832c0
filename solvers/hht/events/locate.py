"""Sign changes of event functions along one step's dense output, and the step that ends at one.

That step is found as a zero of the event function at the step's end, as a function of its length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers.hht.equations.formulas import crosses
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import value_of
from solvers.hht.events.scan import EXTRA
from solvers.hht.events.sides import BESIDE
from solvers.hht.step.state import State
from solvers.kernel.memory import CONVERGED, T_END
from solvers.kernel.numbers import EPS, TINY

if TYPE_CHECKING:
    from solvers.hht.run.engine import Engine

NUDGE = 1e-7  # increment of time for the slope of an event function, over the distance of samples
WIDER = 8.0  # growth of the bracket while the other side of an event is searched
CLOSE = 4.0  # spacings of floating-point times within which an event is at the end of a step
TOGETHER = 8.0  # spacings within which events that change the state happen at one time

Attempt = tuple[Vector, ...]  # copy of an attempted step from the loops' memory


@dataclass(frozen=True)
class Crossing:
    """A change of sign of an event function along a step's dense output."""

    index: int  #: number of the event in the list that the user gave
    t: float  #: [s]
    side: int  #: sign of the function before it
    bracket: tuple[float, float]  #: times [s] of the samples on both sides


def crossings(
    events: Sequence[Event], times: Vector, values: Vector, roundoff: Vector, output: HermiteOutput, work: Work
) -> tuple[Crossing, ...]:
    """Sign changes along ``output`` (one step), ordered by time, those at one time in the order of the events.

    ``times`` and ``values``: samples of :func:`~solvers.hht.events.scan.scan`; ``roundoff`` (k,): of values at a zero at
    the step's start.
    """
    found, direction = list[Crossing](), 1.0 if output.t[-1] > output.t[0] else -1.0
    for index, part in enumerate(_parts(events)):
        found += _crossings(index, events[index], times[part], values[part], roundoff[index], output, work)
    return tuple(sorted(found, key=lambda crossing: direction * crossing.t))


def _parts(events: Sequence[Event]) -> list[slice]:
    """Slice of each event's samples among all."""
    ends = np.cumsum([event.samples + EXTRA for event in events])
    return [slice(end - event.samples - EXTRA, end) for event, end in zip(events, ends, strict=True)]


def _crossings(
    index: int, event: Event, times: Vector, values: Vector, roundoff: float, output: HermiteOutput, work: Work
) -> list[Crossing]:
    found = []
    for i in range(1, times.size):
        before, now = float(values[i - 1]), float(values[i])
        if times[i] == times[i - 1] or not crosses(before, now, event.direction):
            continue
        low, high = float(times[i - 1]), float(times[i])
        start, side, known = low, int(np.sign(before)), {low: before, high: now}

        def value(t: float, known: dict[float, float] = known) -> float:
            return known[t] if t in known else value_of(event, t, *output(t), work)

        if abs(before) == BESIDE:
            start, low = float(times[0]), _left(value, side, roundoff, low, high)
            if low == start and not event.acts:
                continue
        t = high if now == 0.0 else low if abs(value(low)) == BESIDE else zero(value, low, high)
        end = float(output.t[-1])
        t = end if abs(t - end) <= CLOSE * float(np.spacing(abs(end))) else t
        found.append(Crossing(index, t, side, (start, high)))
    return found


def _left(value: Callable[[float], float], side: int, roundoff: float, low: float, high: float) -> float:
    """A time in (low, high) at which ``value`` has left its zero at ``low`` towards ``side``; ``low`` if it never has."""
    width = high - low
    while abs(width) > CLOSE * float(np.spacing(abs(high))):
        width /= 2
        if value(low + width) * side > roundoff:
            return low + width
    return low


def together(events: Sequence[Event], times: Vector, values: Vector, found: Sequence[Crossing]) -> list[Crossing]:
    """Changes whose zero follows the step's end within the resolution of time: they are taken as happening there too.

    ``found``: events at that end already.  A step to such a zero would be as short as roundoff.
    """
    result, known = [], {crossing.index for crossing in found}
    for index, part in enumerate(_parts(events)):
        (t0, t1), (before, now), start = times[part][-2:], values[part][-2:], times[part][0]
        if t0 == t1 or index in known or not events[index].acts:
            continue
        soon = TOGETHER * EPS * max(abs(t1), abs(t1 - start))
        then = now + (now - before) * abs(soon / (t1 - t0))
        if crosses(now, then, events[index].direction):
            result.append(Crossing(index, float(t1), int(np.sign(now)), (float(t0), float(t1))))
    return result


def zero(value: Callable[[float], float], low: float, high: float) -> float:
    """A time between ``low`` and ``high`` at which ``value`` changes sign, to the last bits (Brent's method)."""
    return float(
        brentq(value, low, high, xtol=max(float(np.spacing(abs(high))), TINY), rtol=4 * EPS, maxiter=200, disp=False)
    )


def along(before: State, attempt: Attempt) -> HermiteOutput:
    """Dense output of one attempted step."""
    numbers, end, n = attempt[0], attempt[2], before.q.size
    q1, v1 = end[:n], end[n : 2 * n]
    return HermiteOutput(np.array([before.t, numbers[T_END]]), np.stack([before.q, q1]), np.stack([before.v, v1]))


class NotMade(Exception):
    """Raised where a trial step failed; ``ended``: the loops' ending code."""

    def __init__(self, ended: int) -> None:
        self.ended = ended
        super().__init__(f"a trial step ended with {ended}")


class StepTo:
    """The step from ``before`` at whose end ``event`` has just reached or crossed zero, found by trial steps."""

    def __init__(self, engine: Engine, event: Event, crossing: Crossing, before: State, whole: Attempt) -> None:
        self.engine, self.event, self.crossing, self.whole = engine, event, crossing, whole
        self.before = before
        self.start, self.end = before.t, float(whole[0][T_END])
        self.first = float(np.nextafter(self.start, self.end))  # the shortest step there is
        self.ahead = 1.0 if self.end > self.start else -1.0
        self.made: dict[float, tuple[Attempt, float]] = {}

    def attempt(self) -> Attempt | None:
        """That step; None where no end of a step has crossed zero, so that only the interpolant had the crossing.

        Raises
        ------
        NotMade
            A trial failed.
        """
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
        """True if the function is zero or beyond at the end of the step that ends at ``t``."""
        return self.value(t) * self.crossing.side <= 0

    def _bracket(self) -> tuple[float, float] | None:
        """End times of two steps, one before the event and one at or after it; None if there is no such pair."""
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
        """Distance [s] from ``t`` past the event, estimated by the function's slope along the dense output."""
        low, high = self.crossing.bracket
        h = NUDGE * abs(high - low)
        output = along(self.before, self.whole)
        times = [between(s, self.start, self.end) for s in (t - h, t + h)]
        values = [value_of(self.event, s, *output(s), self.engine.work) for s in times]
        rise = abs(values[1] - values[0])
        smallest = 2 * float(np.spacing(abs(t)))
        return smallest if rise == 0 else max(4 * abs(self.value(t)) / rise * abs(times[1] - times[0]), smallest)


def between(t: float, one: float, other: float) -> float:
    """``t`` clipped to the interval between two limits in any order."""
    return min(max(t, min(one, other)), max(one, other))
