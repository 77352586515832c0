"""The system that holds during a phase of a motion: its functions, its events, and the impact that begins it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, padded, redundant_rows, route_of, unreduced
from hhtbench.lowering.dynamics.rank import minimum_norm
from hhtbench.lowering.scalar_compiler import native_call
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Work
from hhtbench.solution.result import Status
from solvers._initcond import at_rest, project
from solvers._start import Failure, PhasePoint, dynamics_for, of_dynamics
from solvers.eventful.changes import Changes
from solvers.eventful.steps import Point
from solvers.hht.events.functions import code_of
from solvers.hht.events.sides import BESIDE

NEAR = 1e-6  # displacement over the largest coordinate up to which a position meets the constraints that begin


class PhaseFunctions:
    """The functions and the events of a phase in which one system holds."""

    def __init__(self, problem: Problem, events: Sequence[Event], place: PhasePoint, work: Work) -> None:
        self.problem, self.work = problem, work
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the solver warns of the same
            self.dynamics: Dynamics = dynamics_for(problem.system, place)
        self.declared = events
        self.events = tuple(self._event(event) for event in events)
        self.changes = Changes(events, self.events, self.dynamics, work)

    def _event(self, event: Event) -> Event:
        """``event`` as a function of (t, q, v), machine code where that is possible; without zeros in other phases."""
        if not event.happens_in(self.problem.system):
            return Event(_absent, name=event.name, samples=event.samples)
        if event.takes_multipliers:
            return replace(event, function=partial(self._of_multipliers, event))
        n = self.dynamics.structure.n
        code = None if route_of(self.dynamics) == "numpy" else code_of(event, self.dynamics, n)
        if code is None:
            return event
        call: Any = native_call(code, ((), (n,), (n,)))
        return replace(event, function=lambda t, q, v: call(t, q, v)[0])

    def _of_multipliers(self, event: Event, t: float, q: Vector, v: Vector) -> Any:
        lam, mu = self.multipliers(t, q, v)
        try:
            return event.function(t, q, v, lam, mu)
        except IndexError as error:
            have = f"{type(self.problem.system).__name__} has lam {lam.shape} and mu {mu.shape}"
            text = f"event {event.name!r} reads a multiplier that is not there: {have}; give during= to name those that do."
            raise ProblemError(text) from error

    def multipliers(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """``lam`` (m,) and ``mu`` (p,) of the acceleration level, of least norm where rows are redundant."""
        self.work.add("residual_evaluations")
        found = of_dynamics(self.dynamics).acceleration.solve(t, q, v)
        lam, mu = (x[0] for x in padded(self.dynamics, found.lam[None], found.mu[None]))
        if redundant := redundant_rows(self.dynamics):
            rows = of_dynamics(unreduced(self.dynamics)).levels.at(t, q, v).rows
            lam, mu = np.split(minimum_norm(rows, np.concatenate([lam, mu]), redundant), [lam.size])
        return lam, mu

    def started(self, place: Point, event: Event, rtol: float) -> Point | Failure:
        """``place`` with velocities that this system's constraints allow: an impact without rebound.

        A Failure where its position does not meet them, up to ``NEAR`` or the relative tolerance.
        """
        where = f"after event {event.name!r} at t = {exact(place.t)}"
        if not self.dynamics.structure.constrained:
            return self.changes.point(place.t, place.q, place.v, place.size_q, place.size_v)
        moved = self.consistent(place)
        if isinstance(moved, Failure):
            return Failure(moved.status, f"{where} the system that begins holds no state: {moved.message}")
        off = np.abs(moved.q - place.q)
        allowed = max(NEAR * place.size_q, 2.0 * rtol * max(place.size_q, float(np.max(self.problem.scales.q))))
        if not np.max(off) <= allowed:
            g = of_dynamics(unreduced(self.dynamics)).levels.at(place.t, place.q, place.v).position
            i, row = int(np.argmax(off)), int(np.argmax(np.abs(g)))
            text = f"its constraints do not hold there: g[{row}] = {g[row]:.3g}, and q[{i}] would move by {off[i]:.3g}"
            return Failure(Status.inconsistent_initial, f"{where} {text}; let it happen where they hold, or tighten rtol.")
        return self.changes.point(place.t, moved.q, moved.v, place.size_q, place.size_v)

    def consistent(self, state: Point) -> Point | Failure:
        """The nearest state on the constraints; what is roundoff of the motion's size is zero."""
        moved = project(self.dynamics, PhasePoint(state.t, state.q, state.v), self.work)
        if isinstance(moved, Failure):
            return moved
        return replace(state, q=at_rest(moved[0].q, state.size_q), v=at_rest(moved[0].v, state.size_v))

    def passed(self, known: Vector) -> int | None:
        """Number of the first event of forces that begins another phase and is beyond its zero at the start of this one."""
        for index, event in enumerate(self.declared):
            looked_for = event.takes_multipliers and event.happens_in(self.problem.system)
            if looked_for and event.then is not None and known[index] * event.direction > BESIDE:
                return index
        return None


def _absent(t: Any, q: Any, v: Any) -> float:
    """Event function of an event that is not looked for."""
    return 1.0
