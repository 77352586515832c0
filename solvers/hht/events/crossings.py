"""Sign changes of event functions along one step's dense output, located in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from hhtbench.arguments import Vector
from hhtbench.counting import Work
from solvers.hht.equations.formulas import EPS, TINY, crosses
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Event, value_of
from solvers.hht.events.scan import EXTRA

CLOSE = 4.0  # spacings of floating-point times within which an event is at the end of a step


@dataclass(frozen=True)
class Crossing:
    """A change of sign along the dense output of a step."""

    index: int  #: of the event
    t: float  #: [s]
    side: int  #: sign of the function before it
    bracket: tuple[float, float]  #: [s], samples around it


def crossings(
    events: Sequence[Event], times: Vector, values: Vector, output: HermiteOutput, work: Work
) -> tuple[Crossing, ...]:
    """Changes of sign along ``output``, which is one step, in order of time, those at one time in the order of the events.

    ``times`` and ``values``: the samples that :func:`~solvers.hht.events.scan.scan` has taken.
    """
    found, first, direction = list[Crossing](), 0, 1.0 if output.t[-1] > output.t[0] else -1.0
    for index, event in enumerate(events):
        part = slice(first, first + event.samples + EXTRA)
        found += _crossings(index, event, times[part], values[part], output, work)
        first = part.stop
    return tuple(sorted(found, key=lambda crossing: direction * crossing.t))


def _crossings(index: int, event: Event, times: Vector, values: Vector, output: HermiteOutput, work: Work) -> list[Crossing]:
    found = []
    for i in range(1, times.size):
        before, now = float(values[i - 1]), float(values[i])
        if times[i] == times[i - 1] or not crosses(before, now, event.direction):
            continue
        bracket = float(times[i - 1]), float(times[i])
        t = bracket[1] if now == 0.0 else _zero(event, bracket, (before, now), output, work)
        t = float(output.t[-1]) if _near(t, float(output.t[-1])) else t
        found.append(Crossing(index, t, int(np.sign(before)), bracket))
    return found


def _zero(event: Event, bracket: tuple[float, float], ends: tuple[float, float], output: HermiteOutput, work: Work) -> float:
    """The zero of the event function along ``output``, to the last bits of time."""
    known = dict(zip(bracket, ends, strict=True))

    def value(t: float) -> float:
        return known[t] if t in known else value_of(event, t, *output(t), work)

    return zero(value, *bracket)


def zero(value: Callable[[float], float], low: float, high: float) -> float:
    """A time between ``low`` and ``high`` at which ``value`` changes its sign, to the last bits."""
    return float(
        brentq(value, low, high, xtol=max(float(np.spacing(abs(high))), TINY), rtol=4 * EPS, maxiter=200, disp=False)
    )


def _near(t: float, end: float) -> bool:
    """Whether the two times are one but for roundoff."""
    return abs(t - end) <= CLOSE * float(np.spacing(abs(end)))
