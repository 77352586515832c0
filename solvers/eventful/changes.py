"""Changes of state by events, several at one time among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hhtbench.lowering import Dynamics
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.counting import Work
from hhtbench.solution.result import Impact
from solvers._initcond import project
from solvers._start import Failure, PhasePoint, of_dynamics
from solvers.eventful.impacts import impact_of, rebound
from solvers.eventful.steps import Point
from solvers.hht.events.event import Event, changed_by, value_of
from solvers.hht.events.locate import TOGETHER, Crossing
from solvers.hht.events.sides import changed_values, is_leaving, local_at, side_after
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
        return _changes(event) and is_leaving(event, crossing.side, place, h, self.work)

    def together(self, found: Sequence[Crossing], known: Vector | None, place: Point, h: float) -> list[Crossing]:
        """Crossings by other events that change the state and whose zero is at ``place`` within the resolution of time."""
        others, there = [], {crossing.index for crossing in found}
        soon = TOGETHER * EPS * max(abs(place.t), abs(h))
        for index, event in enumerate(self.events):
            if known is None or index in there or not event.acts or known[index] == 0.0:
                continue
            here, side = local_at(event, place, h, self.work), float(np.sign(known[index]))
            at_zero = abs(here.value) <= max(here.near, abs(here.rate) * soon)
            if at_zero and (here.value + here.rate * soon) * side <= 0.0 and event.direction in (0, -side):
                others.append(Crossing(index, place.t, int(side), (place.t, place.t)))
        return others

    def applied(
        self, found: Sequence[Crossing], place: Point, h: float, resting: Sequence[int] = ()
    ) -> tuple[Point, Vector] | Failure:
        """The state after the changes of the events ``found`` at ``place``, and the values (2k,) of all functions there.

        ``resting`` are events without a rebound.
        """
        sides, state, names = [0] * len(self.events), place, [repr(self.events[c.index].name) for c in found]
        where = f"after the change by event {', '.join(names)} at t = {exact(place.t)}"
        values = self._values(place)
        unsure = np.where(np.isin(np.arange(values.size), [c.index for c in found]), abs(values), 0.0)
        for crossing in sorted(found, key=lambda crossing: crossing.index):
            event = self.events[crossing.index]
            if not _changes(event) or crossing.index in resting:
                continue
            if event.change is not None:
                q, v = changed_by(event, place.t, state.q, state.v)
            else:
                q, (v, normal) = state.q, rebound(event, self.declared[crossing.index], self.dynamics, state)
                self.impacts.append(impact_of(event.name, self.dynamics, state, v, normal))
            state = replace(state, q=q, v=v)
            if self.dynamics.structure.constrained:
                moved = project(self.dynamics, PhasePoint(place.t, q, v), self.work)
                if isinstance(moved, Failure):
                    return Failure(moved.status, f"{where}: {moved.message}")
                before, state = self._values(state), replace(state, q=moved[0].q, v=moved[0].v)
                unsure += abs(self._values(state) - before)  # a solver without projection has drifted
            self.made.append(crossing.index)
            sides[crossing.index] = side_after(event, crossing.side, state, h, self.work)
        state = self.point(state.t, state.q, state.v, state.size_q, state.size_v)
        return state, changed_values(self.events, sides, np.concatenate([values, unsure]), state, h, self.work)

    def _values(self, at: Point) -> Vector:
        """Values (k,) of all event functions."""
        return np.array([value_of(event, at.t, at.q, at.v, self.work) for event in self.events])


def _changes(event: Event) -> bool:
    return event.change is not None or event.restitution is not None
