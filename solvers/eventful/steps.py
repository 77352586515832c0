"""Steps of any solver as a quintic between their ends, and the signs of event functions along them.

At both ends of a step position, velocity and acceleration are known, the last from the acceleration level of the equations;
they determine a polynomial of degree 5, whose error in q is of order h^6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers.hht.events.event import value_of
from solvers.hht.events.locate import Crossing, crossings
from solvers.hht.events.scan import EXTRA
from solvers.kernel.numbers import EPS

POWERS = np.arange(6)
ROUNDOFFS = 4.0  # roundoffs of q that a short step's difference of positions may hold


@dataclass(frozen=True, kw_only=True)
class Point:
    """A state with its acceleration and the largest |q| and |v| so far."""

    t: float  #: [s]
    q: Vector  #: (n,)
    v: Vector  #: (n,)
    vdot: Vector  #: (n,)
    size_q: float
    size_v: float

    def moved(self, dt: float) -> tuple[float, Vector, Vector]:
        """Time, q and v after ``dt`` [s] by the Taylor polynomial of degree 2, whose error in q is of order dt^3."""
        return self.t + dt, self.q + dt * self.v + dt * dt / 2 * self.vdot, self.v + dt * self.vdot

    def after(self, dt: float) -> Point:
        """The state of :meth:`moved`, with this acceleration."""
        t, q, v = self.moved(dt)
        return replace(self, t=t, q=q, v=v)


class Quintic:
    """The polynomial of degree 5 through the ends of one step."""

    def __init__(self, one: Point, other: Point) -> None:
        self.t = np.array([one.t, other.t])
        h = self._h = other.t - one.t
        v0, v1, a0, a1 = h * one.v, h * other.v, h * h * one.vdot, h * h * other.vdot
        rise = (v0 + v1) / 2 + (a0 - a1) / 12  # of velocity and acceleration alone
        apart = other.q - one.q - rise
        rise += np.where(abs(apart) > ROUNDOFFS * EPS * (abs(one.q) + abs(other.q)), apart, 0.0)
        rise, turn, bend = rise - v0 - a0 / 2, v1 - v0 - a0, a1 - a0  # beyond the parabola of the start
        self._c = np.stack(
            [
                one.q,
                v0,
                a0 / 2,
                10 * rise - 4 * turn + bend / 2,
                -15 * rise + 7 * turn - bend,
                6 * rise - 3 * turn + bend / 2,
            ]
        )

    def __call__(self, t: float) -> tuple[Vector, Vector]:
        """q and v (n,) at ``t`` [s]."""
        s = (t - self.t[0]) / self._h
        return s**POWERS @ self._c, (POWERS[1:] * s ** POWERS[:-1]) @ self._c[1:] / self._h


def crossings_in(
    events: Sequence[Event], known: Vector, one: Point, other: Point, work: Work
) -> tuple[tuple[Crossing, ...], Vector]:
    """Sign changes in the step from ``one`` to ``other``, and the values (2k,) that are ``known`` at its end.

    ``known`` (2k,): values at its start, then their roundoff where the step begins at a zero, as in the loops of HHT.
    """
    if all(event.period for event in events):
        return (), known
    output = Quintic(one, other)
    starts, roundoffs = np.split(known, 2)
    times, values, after = list[float](), list[float](), known.copy()
    for e, event in enumerate(events):
        own_times = np.linspace(one.t, other.t, event.samples + EXTRA)
        own = [starts[e]]
        roundoff = roundoffs[e]
        for t in own_times[1:]:
            if event.period:  # it has no zero
                own.append(starts[e])
                continue
            state = (other.q, other.v) if t == other.t else output(t)
            value = value_of(event, float(t), *state, work)
            if roundoff > 0.0 and abs(value) <= roundoff:  # it has not left its zero
                value = starts[e]
            else:
                roundoff = 0.0
            own.append(value)
        after[e], after[len(events) + e] = own[-1], roundoff
        times += own_times.tolist()
        values += own
    quintic: Any = output
    return crossings(events, np.array(times), np.array(values), roundoffs, quintic, work), after
