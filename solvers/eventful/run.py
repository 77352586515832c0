"""One solve with events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Clock
from hhtbench.solution.phases import Impact
from hhtbench.solution.request import Request
from hhtbench.solution.result import Solution, Status
from solvers._initcond import consistent_start
from solvers._start import Failure, PhasePoint, budget_failure
from solvers.eventful.changes import MAX_CHANGES_AT_ONCE, PILED_UP, Changes, changes_state
from solvers.eventful.dense import joined
from solvers.eventful.impacts import impact_of
from solvers.eventful.locate import located
from solvers.eventful.phase import PhaseFunctions
from solvers.eventful.rows import Rows
from solvers.eventful.runs import SolverRuns
from solvers.eventful.steps import Point, crossings_in
from solvers.hht.events.event import Occurrence
from solvers.hht.events.locate import TOGETHER, Crossing
from solvers.hht.events.sides import BESIDE, starting_values

FIRST = 0.1  # share of the interval of the first run: nothing is integrated far beyond an event
LONGER = 2.0  # length of a run over the last one without an event, or over the time between two changes
SHORTEST = 1e3  # length of a run over the resolution of time; changes that follow one another sooner pile up


class Run:
    """One solve with events."""

    def __init__(self, solver: Any, events: tuple[Event, ...], problem: Problem, request: Request, clock: Clock) -> None:
        self.problem, self.request, self.events = problem, request, events
        t, self.end = problem.t_span
        self.ahead, self.length = float(np.sign(self.end - t)), FIRST * abs(self.end - t)
        self.runs = SolverRuns(solver, request, abs(self.end - t), clock)
        self.work = self.runs.work
        self.rows, self.parts = Rows(problem.q0.size), list[Solution]()  #: runs, if dense output is asked for
        self.pieces: list[tuple[int, PhaseFunctions, Point, float]] = []  #: motions without changes: phase, start, end [s]
        self.occurrences: tuple[list[Occurrence], ...] = tuple([] for _ in events)
        self.known: Vector | None = None  #: (2k,) event functions, then roundoff of those at a zero
        self.samples = {i: 0 for i, event in enumerate(events) if event.period}  #: numbers of their next samples
        self.phase = PhaseFunctions(problem, events, PhasePoint(t, problem.q0, problem.v0), self.work)
        self.point = Point(t=t, q=problem.q0, v=problem.v0, vdot=np.zeros_like(problem.v0), size_q=0.0, size_v=0.0)
        self.sizes: tuple[float, ...] = (0.0, 0.0)  #: largest of |q| and of |v| until now
        self.begun: list[tuple[Any, str, Point]] = [(problem.system, "", self.point)]  #: the phases: system, event and state
        self.switched: list[int] = []  #: events that have begun a phase at this time
        self.impacts: list[Impact] = []
        self.consistent: Point | None = None  #: state that has been put onto the constraints after a change
        self.fresh = True  #: whether the motion begins at ``point``, and not only a run of the solver

    def solution(self) -> Solution:
        """The solution up to the end, a terminal event or a failure."""
        ended = None
        try:
            while ended is None:
                ended = self._advance()
            if self.request.t_eval is not None:
                self.rows = self.rows.at(self.request.t_eval, self.pieces, self.ahead, self._solve)
        except BudgetSpent as spent:
            ended = budget_failure(spent, self.point.t)
        except NonFiniteValue as error:
            ended = Failure(Status.nonfinite_callback, f"{error}, after t = {exact(self.point.t)}")
        n = self.problem.q0.size
        rows: dict[str, Any] = self.rows.joined()
        return Solution(
            **rows,
            status=ended.status,
            message=ended.message,
            counters=self.runs.counters(),
            t_events=tuple(np.array([o.t for o in each]) for each in self.occurrences),
            q_events=tuple(np.array([o.q for o in each]).reshape(-1, n) for each in self.occurrences),
            v_events=tuple(np.array([o.v for o in each]).reshape(-1, n) for each in self.occurrences),
            phases=self.rows.phases(self.begun) if len(self.begun) > 1 else (),
            impacts=tuple(self.impacts),
            interpolant=joined(self.parts, float(rows["t"][-1]) if rows["t"].size else 0.0),
        )

    def _advance(self) -> Failure | None:
        """Run the solver once, up to the first event that stops it; a Failure if the solve ends there."""
        self.work.check_time()
        t = self.point.t
        if due := [i for i in self.samples if abs(self._sample_time(i) - t) <= _resolved(t)]:
            return self._sampled(due)
        whole = abs(self.end - t) <= LONGER * self.length
        h = self.runs.h
        length = self.length if h is None else h * max(1.0, self.length // h)
        stops = [self.end if whole else t + self.ahead * length, *map(self._sample_time, self.samples)]
        part = self._solve(self.phase, self.point, min(stops) if self.ahead > 0 else max(stops))
        if not part.t.size:
            begun = f"after event {self.begun[-1][1]!r} at t = {exact(t)}: " if self.begun[-1][2] is self.point else ""
            return Failure(part.status, f"{begun}{part.message}" if self.begun[-1][1] else part.message)
        one = self._point(part, 0)
        if self.fresh:
            self.pieces.append((len(self.begun) - 1, self.phase, one, self.end))
        for row in range(1, part.t.size):
            other = self._point(part, row)
            if self.known is None:
                self.known = starting_values(self.phase.events, one, other.t - one.t, self.work)
                if (index := self.phase.passed(self.known)) is not None:
                    self._keep(part, row)
                    return self._stopped(one, [self._at_once(index, one)], other.t - one.t)
            found, after = crossings_in(self.phase.events, self.known, one, other, self.work)
            if at_once := [c for c in found if c.t == one.t and abs(self.known[c.index]) == BESIDE]:
                self._keep(part, row)
                return self._stopped(one, at_once, other.t - one.t)
            for crossing in found:
                place = located(self.phase.events[crossing.index], crossing, one, other.t, self._reach, self.work)
                if isinstance(place, Failure):
                    self._keep(part, row)
                    return place
                if self.ahead * (place.t - self.end) > -_resolved(self.end):
                    place = replace(place, t=self.end)
                elif self.ahead * (place.t - one.t) < 0.0:  # by the last bits of time
                    place = replace(place, t=one.t)
                if self._stops(crossing):
                    self._keep(part, row)
                    return self._stopped(place, [crossing], other.t - one.t)
                self._noted(crossing, place)
            self.known, one = after, other
            if abs(one.t - self.pieces[-1][2].t) > SHORTEST * _resolved(one.t):
                self.changes.made, self.switched = [], []
        self._keep(part, part.t.size)
        self.point, self.fresh = one, False
        self.length = min(LONGER * self.length, abs(self.end - self.problem.t_span[0]))  # samples shorten runs
        return Failure(part.status, part.message) if not part.success or one.t == self.end else None

    @property
    def changes(self) -> Changes:
        """The changes of state in this phase."""
        return self.phase.changes

    def _at_once(self, index: int, place: Point) -> Crossing:
        """The occurrence of an event that is beyond its zero where its phase begins."""
        return Crossing(index, place.t, -self.events[index].direction, (place.t, place.t))

    def _stopped(self, place: Point, found: list[Crossing], h: float) -> Failure | None:
        """End the motion at ``place`` by the events ``found`` there; a Failure unless it goes on after a change."""
        begun = self.pieces[-1][2]
        if abs(place.t - begun.t) > _resolved(place.t):
            self.rows.add(len(self.begun) - 1, place, self.phase)
        if abs(place.t - begun.t) > SHORTEST * _resolved(place.t):
            self.changes.made, self.switched = [], []
        piled = self.changes.piled_up(found, place, h)
        if unsure := [i for i in piled if self.events[i].restitution is None or self.events[i].then is None]:
            names = ", ".join(repr(self.events[i].name) for i in unsure)
            return Failure(Status.time_resolution, f"changes by event {names} pile up at t = {exact(place.t)}; {PILED_UP}")
        found += self.changes.together(found, self.known, place, h)
        self.length = max(LONGER * abs(place.t - begun.t), abs(h), SHORTEST * _resolved(max(abs(place.t), abs(self.end))))
        return self._changed(place, found, h, piled)

    def _sample_time(self, index: int) -> float:
        """Time [s] of the next sample of a periodic event."""
        event = self.events[index]
        t = self.problem.t_span[0] + self.ahead * (event.first + self.samples[index] * event.period)
        return self.end if abs(t - self.end) <= _resolved(t) else t

    def _sampled(self, due: list[int]) -> Failure | None:
        """Apply the periodic events ``due`` at this time; a Failure if the solve ends there."""
        at: Any = PhasePoint(self.point.t, self.point.q, self.point.v)
        if self.known is None:
            guesses, initcond = (self.problem.lam_guess, self.problem.mu_guess), self.request.calc_initcond
            found = consistent_start(self.phase.dynamics, at, guesses, self.work, calc_initcond=initcond)
            if isinstance(found, Failure):
                return found
            at = found[0]
        h, place = self.ahead * self.length, self.changes.point(at.t, at.q, at.v, self.point.size_q, self.point.size_v)
        self.changes.made, self.switched = [], []
        if self.known is None:
            self.known = starting_values(self.phase.events, place, h, self.work)
            self.rows.add(len(self.begun) - 1, place, self.phase)
        for index in due:
            self.samples[index] += 1
        return self._changed(place, [Crossing(index, place.t, 1, (place.t, place.t)) for index in due], h)

    def _changed(self, place: Point, found: list[Crossing], h: float, resting: Sequence[int] = ()) -> Failure | None:
        """Go on from ``place`` after the changes by ``found``; a Failure if the solve ends there.

        ``resting``: events whose rebounds have piled up.  Of several events that begin another phase, the first one does.
        """
        switching = sorted((c for c in found if self._switches(c.index, resting)), key=lambda c: c.index)
        found = [c for c in found if c not in switching[1:]]
        for crossing in found:
            self._noted(crossing, place)
        if self.pieces:
            self.pieces[-1] = *self.pieces[-1][:3], place.t
        named = [repr(self.events[c.index].name) for c in found if self._ends(c.index)]
        bouncing = [c for c in found if c not in switching or self.events[c.index].restitution is None]
        bound = self.phase.consistent if self.phase.dynamics.structure.constrained and not switching else None
        after = self.changes.applied(bouncing, place, h, self._values_before(), bound)
        self.impacts += self.changes.impacts
        self.changes.impacts = []
        if isinstance(after, Failure):
            return after
        self.point, self.known, self.fresh = *after, True
        changed = bound is not None and any(self.events[c.index].change is not None for c in bouncing)
        self.consistent = self.point if changed else None
        if named:
            if any(changes_state(self.events[c.index]) for c in found):
                self.rows.add(len(self.begun) - 1, self.point, self.phase)
            return Failure(Status.event, f"event {', '.join(named)} at t = {exact(place.t)}. {Status.event.text}")
        if switching:
            failed = self._switched(switching[0], self.point, h)
            if failed is not None:
                return failed
        if self.point.t == self.end:
            self.rows.add(len(self.begun) - 1, self.point, self.phase)
            return Failure(Status.success, Status.success.text)
        return None

    def _values_before(self) -> Vector:
        return np.zeros(2 * len(self.events)) if self.known is None else self.known

    def _switches(self, index: int, resting: Sequence[int]) -> bool:
        event = self.events[index]
        return event.then is not None and (not event.restitution or index in resting)

    def _switched(self, crossing: Crossing, place: Point, h: float) -> Failure | None:
        """Begin the phase of an event at ``place``; a Failure if no motion begins there."""
        index = crossing.index
        event, made = self.events[index], [*self.changes.made, index]
        self.switched.append(index)
        system: Any = event.then
        if self.switched.count(index) > MAX_CHANGES_AT_ONCE:
            names = ", ".join(repr(self.events[i].name) for i in sorted({*self.switched}))
            text = f"events {names} begin one another's systems at t = {exact(place.t)} and never settle"
            return Failure(Status.time_resolution, text)
        rtol = 0.0 if self.request.rtol is None else float(np.max(self.request.rtol))
        at = PhasePoint(place.t, place.q, place.v)
        try:
            phase = PhaseFunctions(self.problem.with_system(system), self.events, at, self.work)
        except (ProblemError, TypeError) as error:
            text = f"event {event.name!r} begins a system that does not fit; all have the same coordinates: {error}"
            raise type(error)(text) from None
        started = phase.started(place, event, rtol)
        if isinstance(started, Failure):
            return started
        self.impacts.append(impact_of(event.name, phase.dynamics, place, started.v))
        self.phase, self.point, self.known = phase, started, starting_values(phase.events, started, h, self.work)
        self.changes.made = made
        if abs(self.known[index]) == BESIDE:  # it has passed its zero
            self.known[index] = -crossing.side * BESIDE
        self.begun.append((system, event.name, started))
        beyond = phase.passed(self.known)
        return None if beyond is None else self._changed(started, [self._at_once(beyond, started)], h)

    def _stops(self, crossing: Crossing) -> bool:
        """True if the next occurrence of this event ends the run, changes the state or the system."""
        event = self.events[crossing.index]
        return event.acts or event.ends(len(self.occurrences[crossing.index]) + 1)

    def _ends(self, index: int) -> bool:
        return self.events[index].ends(len(self.occurrences[index]))

    def _noted(self, crossing: Crossing, at: Point) -> None:
        name = self.events[crossing.index].name
        self.occurrences[crossing.index].append(Occurrence(crossing.index, name, at.t, at.q, at.v))

    def _solve(self, phase: PhaseFunctions, start: Point, end: float, t_eval: Vector | None = None) -> Solution:
        """The solver without events from ``start`` to ``end`` [s]."""
        bound = start is self.consistent
        return self.runs.between(phase, start, end, begun=self.known is not None, bound=bound, t_eval=t_eval)

    def _reach(self, start: Point, end: float) -> Point | Failure:
        part = self._solve(self.phase, start, end)
        return self._point(part, -1) if part.success else Failure(part.status, part.message)

    def _point(self, part: Solution, row: int) -> Point:
        t, q, v = float(part.t[row]), part.q[row], part.v[row]
        self.sizes = tuple(max(size, float(np.max(np.abs(x)))) for size, x in zip(self.sizes, (q, v), strict=True))
        return self.changes.point(t, q, v, *self.sizes)

    def _keep(self, part: Solution, end: int) -> None:
        """Keep the rows of ``part`` before row ``end``; the first one only if the motion begins there."""
        self.rows.keep(len(self.begun) - 1, part, slice(0 if self.fresh else 1, end))
        if self.request.dense_output:
            self.parts.append(part)


def _resolved(t: float) -> float:
    """Times [s] closer than this to ``t`` are one time."""
    return TOGETHER * float(np.spacing(abs(t)))
