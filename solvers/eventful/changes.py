"""Changes of state by events, several at one time among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.events import Event
from hhtbench.protocol.printing import exact
from hhtbench.solution.counting import Work
from hhtbench.solution.phases import Impact
from solvers._start import Failure, of_dynamics
from solvers.eventful.impacts import rebound
from solvers.eventful.steps import Point
from solvers.hht.events.event import changed_by, value_of
from solvers.hht.events.locate import TOGETHER, Crossing
from solvers.hht.events.sides import BESIDE, changed_values, is_leaving, local_at, side_after
from solvers.hht.run.stepper import MAX_CHANGES_AT_ONCE, PILED_UP
from solvers.kernel.numbers import EPS

__all__ = ["MAX_CHANGES_AT_ONCE", "PILED_UP", "Changes"]


class Changes:
    """Applies the changes of ``events`` to states of one system; ``declared``: the same events with the user's functions."""

    def __init__(self, declared: Sequence[Event], events: Sequence[Event], dynamics: Dynamics, work: Work) -> None:
        self.declared, self.events, self.dynamics, self.work = declared, events, dynamics, work
        self.level = of_dynamics(dynamics).acceleration
        self.made: list[int] = []  #: events that have changed the state at this time
        self.impacts: list[Impact] = []

    def point(self, t: float, q: Vector, v: Vector, size_q: float, size_v: float) -> Point:
        """The Point at (t, q, v)."""
        self.work.add("residual_evaluations")
        return Point(t=t, q=q, v=v, vdot=self.level.solve(t, q, v).vdot, size_q=size_q, size_v=size_v)

    def piled_up(self, found: Sequence[Crossing], place: Point, h: float) -> list[int]:
        """Events that change the state although the motion does not get away from their changes at one time.

        Or it already leads away from their zero: there the solver's error is larger than the motion, and a change would
        send it through.
        """
        return [c.index for c in found if self._again(c, place, h) or self._turned_back(c, place, h)]

    def _again(self, crossing: Crossing, place: Point, h: float) -> bool:
        times = self.made.count(crossing.index)
        event = self.events[crossing.index]
        return times > MAX_CHANGES_AT_ONCE or (times > 0 and not is_leaving(event, -crossing.side, place, h, self.work))

    def _turned_back(self, crossing: Crossing, place: Point, h: float) -> bool:
        event = self.events[crossing.index]
        return changes_state(event) and is_leaving(event, crossing.side, place, h, self.work)

    def together(self, found: Sequence[Crossing], known: Vector | None, place: Point, h: float) -> list[Crossing]:
        """Crossings by other events that act and whose zero is at ``place`` within the resolution of time.

        Or before it in this step: where events follow one another within the solver's error, the one found first is not
        always the first one.
        """
        others, there = [], {crossing.index for crossing in found}
        soon = TOGETHER * EPS * max(abs(place.t), abs(h))
        for index, event in enumerate(self.events):
            if known is None or index in there or not event.acts or known[index] == 0.0:
                continue
            here, side = local_at(event, place, h, self.work), float(np.sign(known[index]))
            at_zero = abs(here.value) <= max(here.near, abs(here.rate) * soon)
            reached = (at_zero and (here.value + here.rate * soon) * side <= 0.0) or here.value * side < 0.0
            if reached and event.direction in (0, -side):
                others.append(Crossing(index, place.t, int(side), (place.t, place.t)))
        return others

    def applied(
        self, found: Sequence[Crossing], place: Point, h: float, known: Vector, bound: Callable[[Point], Any] | None
    ) -> tuple[Point, Vector] | Failure:
        """The state after the changes of the events ``found`` at ``place``, and the values (2k,) of all functions there.

        ``known`` (2k,): values before; ``bound``: puts a changed state onto the constraints, or returns a Failure.
        """
        values, names = self._values(place), ", ".join(repr(self.events[c.index].name) for c in found)
        sides, unsure, state = [0] * len(self.events), np.zeros(values.size), place
        ordered = sorted(found, key=lambda crossing: crossing.index)
        for crossing in ordered:
            event = self.events[crossing.index]
            unsure[crossing.index] = abs(values[crossing.index])
            if event.change is None:
                continue
            q, v = changed_by(event, place.t, state.q, state.v)
            state = replace(state, q=q, v=v)
            if bound is not None:
                moved = bound(state)
                if isinstance(moved, Failure):
                    where = f"after the change by event {names} at t = {exact(place.t)}"
                    return Failure(moved.status, f"{where}: {moved.message}")
                before, state = self._values(state), moved
                unsure += abs(self._values(state) - before)  # a solver without projection has drifted
            self.made.append(crossing.index)
            sides[crossing.index] = side_after(event, crossing.side, state, h, self.work)
        if hit := [c for c in ordered if self.events[c.index].restitution is not None]:
            v, impact = rebound([(self.declared[c.index], c.side) for c in hit], self.dynamics, state)
            state = replace(state, v=v)
            self.impacts += [impact] if impact is not None else []
            for crossing in hit:
                self.made.append(crossing.index)
                sides[crossing.index] = crossing.side
        state = self.point(state.t, state.q, state.v, state.size_q, state.size_v)
        before = known[: values.size]
        stops = [
            event.acts and side != 0.0 and event.direction in (0, -side)
            for event, side in zip(self.events, np.sign(before), strict=True)
        ]
        values = np.where(stops, np.copysign(np.maximum(np.abs(values), BESIDE), before), values)  # else found before
        return state, changed_values(self.events, sides, np.concatenate([values, unsure]), state, h, self.work)

    def _values(self, at: Point) -> Vector:
        """Values (k,) of all event functions."""
        return np.array([value_of(event, at.t, at.q, at.v, self.work) for event in self.events])


def changes_state(event: Event) -> bool:
    """True if it changes the state itself, not by the system that it begins."""
    return event.change is not None or event.restitution is not None
