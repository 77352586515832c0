"""The state at an event: the solver's own, from the start of the step, then the last digits of time by a parabola."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers.eventful.steps import Point
from solvers.hht.events.event import value_of
from solvers.hht.events.locate import Crossing, between

SOLVES = 5  # times that the solver is run up to the event
NEAR = 1e-6  # distance over the step within which the parabola has all digits
SHORTEST = 1e3  # spacings of floating-point times that the solver is run over, at least
ITERATIONS = 12  # of Newton's method on the parabola
NUDGE = 1e-4  # increment of time for a rate, over the step

Reach = Callable[[Point, float], Any]  # the solver from a point to a time: a Point, or how it failed


def located(event: Event, crossing: Crossing, before: Point, end: float, reach: Reach, work: Work) -> Any:
    """The Point at which ``event`` happens in the step from ``before`` to ``end`` [s], or how the solver failed.

    Where the function has no zero by its rate, as one that jumps, it is the solver's at the time of the ``crossing``.
    """
    h, t = end - before.t, crossing.t
    near = max(NEAR * abs(h), SHORTEST * float(np.spacing(abs(t))))
    for _ in range(SOLVES):
        base = before if abs(t - before.t) <= near else reach(before, t)
        if not isinstance(base, Point):
            return base
        dt = _zero(event, base, t - base.t, h, work)
        if dt is None:
            return base.after(t - base.t)
        if abs(base.t + dt - t) <= near:
            return base.after(dt)
        t = between(base.t + dt, before.t, end + h)
    return base if t == crossing.t else reach(before, crossing.t)


def _zero(event: Event, base: Point, dt: float, h: float, work: Work) -> float | None:
    """Signed time [s] from ``base`` to the zero near ``dt`` along the parabola; None if Newton's method finds none."""

    def value(s: float) -> float:
        return value_of(event, *base.moved(s), work)

    d = NUDGE * h
    rate = (value(dt + d) - value(dt - d)) / (2 * d)
    for _ in range(ITERATIONS):
        change = -value(dt) / rate if rate else np.inf
        if not abs(change) <= abs(h):
            return None
        dt += change
        if abs(change) <= float(np.spacing(abs(base.t + dt))) / 2:
            return dt
    return dt
