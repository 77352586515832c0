"""On which side of its zero an event function is where a motion begins, or begins anew after a change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.solution.counting import Work
from solvers.hht.events.event import Event, value_of
from solvers.hht.step.state import State
from solvers.kernel.numbers import EPS

BESIDE = 1e-300  # the value of a function at its zero, with the sign of the side on which the motion is
ZERO = 1e-12  # of what a function changes by in the first step: what a start on its zero may be off
NUDGE = EPS ** (1 / 3)  # of a step: over it a rate is least wrong by roundoff and by its third derivative together
SHORTEST_SCALE = 1e-4  # of the time in which the motion passes its own size: rates are not taken over less than a step of it
ROUNDOFFS = 32.0  # roundoffs of t, q and v: a located event is not further from its zero
SHIFT = 2.0**-26  # of the sizes of q and v: a change that shows what their roundoff does to a function


@dataclass(frozen=True)
class Local:
    """An event function where a motion begins, and along the motion from there."""

    value: float
    rate: float  #: [1/s]
    change: float  #: over a step
    roundoff: float  #: of the value
    near: float  #: what the value may be where an event has been located at its zero
    unsure: float  #: [1/s] of the rate

    @property
    def side(self) -> float:
        """The sign of the side to which the motion leaves; 0 where no rate is seen."""
        return float(np.sign(self.rate)) if abs(self.rate) > self.unsure else 0.0


def starting_values(events: Sequence[Event], state: State, h: float, work: Work) -> Vector:
    """(2k,): the values at a start of which the first step is ``h`` [s] long, then the roundoff of those beside zero.

    A motion that begins on a zero has no event there but one: a change with a direction, in which the motion sets out.
    """
    return _paired([_at_start(event, state, h, work) for event in events])


def _at_start(event: Event, state: State, h: float, work: Work) -> tuple[float, float]:
    here = _local(event, state, h, work)
    if abs(here.value) > max(ZERO * here.change, here.roundoff):
        return here.value, 0.0
    held = event.change is not None and event.direction
    return (-event.direction if held else here.side) * BESIDE, max(here.roundoff, abs(here.value), BESIDE)


def changed_values(
    events: Sequence[Event], sides: Sequence[int], values: Vector, state: State, h: float, work: Work
) -> Vector:
    """Those in ``state``, which changes have made at the end of a step that led to ``values`` (2k,).

    ``sides``: where :func:`side_after` says the motion is, of functions whose events have changed the state; 0 of others.
    """
    known = zip(events, sides, *np.split(values, 2), strict=True)
    return _paired([_after(event, side, before, off, state, h, work) for event, side, before, off in known])


def _after(
    event: Event, side: int, before: float, roundoff: float, state: State, h: float, work: Work
) -> tuple[float, float]:
    here = _local(event, state, h, work)
    if abs(here.value) > max(here.near, roundoff):
        return here.value, 0.0
    roundoff = max(here.roundoff, roundoff, abs(here.value), BESIDE)
    return (side or float(np.sign(before))) * BESIDE, roundoff


def side_after(event: Event, before: int, state: State, h: float, work: Work) -> int:
    """On which side of the zero the motion is in ``state``, which the event's own change has made; ``before`` it was.

    A change that turns or stops the function leaves the motion on the side from which it came; any other lets it pass.
    """
    return -before if is_leaving(event, -before, state, h, work) else before


def is_leaving(event: Event, side: int, state: State, h: float, work: Work) -> bool:
    """Whether the motion sets out from ``state`` to that ``side`` of the zero."""
    return _local(event, state, h, work).side == side


def _local(event: Event, state: State, h: float, work: Work) -> Local:
    t, q, v, a = state.t, state.q, state.v, state.vdot
    passing = state.size_q / state.size_v if state.size_v else 0.0
    d = NUDGE * float(np.copysign(max(abs(h), SHORTEST_SCALE * passing), h))
    value = value_of(event, t, q, v, work)
    one, two = (value_of(event, t + s, q + s * v + s * s / 2 * a, v + s * a, work) for s in (d, 2 * d))
    rate, bend = (4 * one - 3 * value - two) / (2 * abs(d)), (value - 2 * one + two) / d**2
    uneven = 0.5 + np.arange(q.size) * (np.sqrt(5) - 1) / 2 % 1  # no two alike: a difference of coordinates shows too
    off_q, off_v = SHIFT * uneven * state.size_q, SHIFT * uneven * state.size_v
    moved = abs(value_of(event, t, q + off_q, v + off_v, work) - value) / SHIFT
    roundoff = ROUNDOFFS * EPS * (abs(t * rate) + moved)
    near = roundoff + (ROUNDOFFS * EPS * moved * abs(t) / passing if passing else 0.0)
    return Local(value, rate, abs(rate * h) + abs(bend) * h * h / 2, roundoff, near, roundoff / abs(d))


def _paired(pairs: Sequence[tuple[float, float]]) -> Vector:
    return np.array(pairs, float).reshape(-1, 2).T.ravel()
