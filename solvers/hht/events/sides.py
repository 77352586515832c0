"""The side of zero on which an event function is at a start, or after a change of state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers.hht.events.event import value_of
from solvers.kernel.numbers import EPS

BESIDE = 1e-300  # value stored for a function at its zero, with the sign of the motion's side
ZERO = 1e-12  # values at a start below this share of their change in the first step count as zero
NUDGE = EPS ** (1 / 3)  # increment over the step that balances roundoff and truncation of a second-order difference
MIN_SCALE = 1e-4  # lower bound on the step over which rates are taken, over the time size_q / size_v
ROUNDOFFS = 32.0  # roundoffs of t, q and v within which a located event is from its zero
SHIFT = 2.0**-26  # perturbation relative to q and v that shows the effect of their roundoff on a function


class Moving(Protocol):
    """A state of a motion: of HHT, or between the steps of another solver."""

    @property
    def t(self) -> float: ...  # noqa: D102 - [s]
    @property
    def q(self) -> Vector: ...  # noqa: D102 - (n,)
    @property
    def v(self) -> Vector: ...  # noqa: D102 - (n,)
    @property
    def vdot(self) -> Vector: ...  # noqa: D102 - (n,) acceleration
    @property
    def size_q(self) -> float: ...  # noqa: D102 - largest |q| seen
    @property
    def size_v(self) -> float: ...  # noqa: D102 - largest |v| seen


@dataclass(frozen=True)
class Local:
    """An event function at one state, and its change along the motion from there."""

    value: float
    rate: float  #: [1/s]
    change: float  #: estimate over a step of h
    roundoff: float  #: roundoff of ``value``
    near: float  #: largest value after an event was located at the function's zero
    unsure: float  #: error of the rate [1/s]

    @property
    def side(self) -> float:
        """Sign of the side to which the motion leaves; 0 if the rate is below its error."""
        return float(np.sign(self.rate)) if abs(self.rate) > self.unsure else 0.0


def starting_values(events: Sequence[Event], state: Moving, h: float, work: Work) -> Vector:
    """(2k,) values at a start before a first step of ``h`` [s], then roundoff of those at a zero.

    A motion that begins on a zero has an event there only if that has a change and a direction in which the motion sets out.
    """
    return _paired([_at_start(event, state, h, work) for event in events])


def _at_start(event: Event, state: Moving, h: float, work: Work) -> tuple[float, float]:
    here = local_at(event, state, h, work)
    if abs(here.value) > max(ZERO * here.change, here.roundoff):
        return here.value, 0.0
    held = event.acts and event.direction
    return (-event.direction if held else here.side) * BESIDE, max(here.roundoff, abs(here.value), BESIDE)


def changed_values(
    events: Sequence[Event], sides: Sequence[int], values: Vector, state: Moving, h: float, work: Work
) -> Vector:
    """(2k,) values in ``state`` after changes at the end of a step that had led to ``values`` (2k,).

    ``sides``: result of :func:`side_after` for events that changed the state, 0 for others.
    """
    known = zip(events, sides, *np.split(values, 2), strict=True)
    return _paired([_after(event, side, before, off, state, h, work) for event, side, before, off in known])


def _after(
    event: Event, side: int, before: float, roundoff: float, state: Moving, h: float, work: Work
) -> tuple[float, float]:
    here = local_at(event, state, h, work)
    if abs(here.value) > max(here.near, roundoff):
        return here.value, 0.0
    roundoff = max(here.roundoff, roundoff, abs(here.value), BESIDE)
    return (side or float(np.sign(before))) * BESIDE, roundoff


def side_after(event: Event, before: int, state: Moving, h: float, work: Work) -> int:
    """Side of zero (-1 or 1) of the motion after the event's own change; ``before``: the side before it.

    A change that reverses or stops the function leaves the motion on its side; any other lets it pass.
    """
    return -before if is_leaving(event, -before, state, h, work) else before


def is_leaving(event: Event, side: int, state: Moving, h: float, work: Work) -> bool:
    """True if the motion leaves ``state`` towards that ``side`` of the zero."""
    return local_at(event, state, h, work).side == side


def local_at(event: Event, state: Moving, h: float, work: Work) -> Local:
    """The event function at ``state``, and its change along the motion over ``h`` [s]."""
    if event.period:
        return Local(value=1.0, rate=0.0, change=0.0, roundoff=0.0, near=0.0, unsure=0.0)
    t, q, v, a = state.t, state.q, state.v, state.vdot
    passing = state.size_q / state.size_v if state.size_v else 0.0
    d = NUDGE * float(np.copysign(max(abs(h), MIN_SCALE * passing), h))
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
