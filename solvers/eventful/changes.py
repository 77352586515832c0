"""Changes of state by events, several at one time among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hhtbench.lowering import Dynamics
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.counting import Work
from solvers._initcond import project
from solvers._start import Failure, PhasePoint, of_dynamics
from solvers.eventful.steps import Point
from solvers.hht.events.event import Event, changed_by, value_of
from solvers.hht.events.locate import TOGETHER, Crossing
from solvers.hht.events.sides import changed_values, is_leaving, local_at, side_after
from solvers.hht.run.stepper import MAX_CHANGES_AT_ONCE, PILED_UP
from solvers.kernel.numbers import EPS

__all__ = ["PILED_UP", "Changes"]


class Changes:
    """Applies the changes of ``events`` to states of one system."""

    def __init__(self, events: Sequence[Event], dynamics: Dynamics, work: Work) -> None:
        self.events, self.dynamics, self.work = events, dynamics, work
        self.level = of_dynamics(dynamics).acceleration
        self.made: list[int] = []  #: events that have changed the state at this time

    def point(self, t: float, q: Vector, v: Vector, size_q: float, size_v: float) -> Point:
        """The Point at (t, q, v)."""
        self.work.add("residual_evaluations")
        return Point(t=t, q=q, v=v, vdot=self.level.solve(t, q, v).vdot, size_q=size_q, size_v=size_v)

    def pile_up(self, found: Sequence[Crossing], place: Point, h: float) -> bool:
        """True if the motion does not get away from changes by the same event at one time."""
        return any(self._again(crossing, place, h) for crossing in found)

    def _again(self, crossing: Crossing, place: Point, h: float) -> bool:
        times = self.made.count(crossing.index)
        event = self.events[crossing.index]
        return times > MAX_CHANGES_AT_ONCE or (times > 0 and not is_leaving(event, -crossing.side, place, h, self.work))

    def turned_back(self, found: Sequence[Crossing], place: Point, h: float) -> str:
        """Names of events that change the state although the motion at ``place`` already leads away from their zero.

        There the solver's error is larger than the motion: a change would send it through.
        """
        changing = [crossing for crossing in found if self.events[crossing.index].change is not None]
        away = [c for c in changing if is_leaving(self.events[c.index], c.side, place, h, self.work)]
        return ", ".join(repr(self.events[c.index].name) for c in away)

    def together(self, found: Sequence[Crossing], known: Vector | None, place: Point, h: float) -> list[Crossing]:
        """Crossings by other events that change the state and whose zero is at ``place`` within the resolution of time."""
        others, there = [], {crossing.index for crossing in found}
        soon = TOGETHER * EPS * max(abs(place.t), abs(h))
        for index, event in enumerate(self.events):
            if known is None or index in there or event.change is None or known[index] == 0.0:
                continue
            here, side = local_at(event, place, h, self.work), float(np.sign(known[index]))
            at_zero = abs(here.value) <= max(here.near, abs(here.rate) * soon)
            if at_zero and (here.value + here.rate * soon) * side <= 0.0 and event.direction in (0, -side):
                others.append(Crossing(index, place.t, int(side), (place.t, place.t)))
        return others

    def applied(self, found: Sequence[Crossing], place: Point, h: float) -> tuple[Point, Vector] | Failure:
        """The state after the changes of the events ``found`` at ``place``, and the values (2k,) of all functions there."""
        sides, state, names = [0] * len(self.events), place, [repr(self.events[c.index].name) for c in found]
        where = f"after the change by event {', '.join(names)} at t = {exact(place.t)}"
        values = self._values(place)
        unsure = np.where(np.isin(np.arange(values.size), [c.index for c in found]), abs(values), 0.0)
        for crossing in sorted(found, key=lambda crossing: crossing.index):
            event = self.events[crossing.index]
            if event.change is None:
                continue
            q, v = changed_by(event, place.t, state.q, state.v)
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
