"""One solve with events."""

from __future__ import annotations

import warnings
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, padded, route_of
from hhtbench.lowering.scalar_compiler import native_call
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.system import Problem
from hhtbench.solution.counting import Clock, Work
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Solution, Status
from solvers._initcond import consistent_start, project
from solvers._start import Failure, PhasePoint, budget_failure, dynamics_for, of_dynamics
from solvers.eventful.changes import PILED_UP, Changes
from solvers.eventful.locate import located
from solvers.eventful.steps import Point, crossings_in
from solvers.hht.events.event import Event, Occurrence
from solvers.hht.events.functions import code_of
from solvers.hht.events.locate import TOGETHER, Crossing
from solvers.hht.events.sides import BESIDE, starting_values

FIRST = 0.1  # share of the interval of the first run: nothing is integrated far beyond an event
LONGER = 2.0  # length of a run over the last one without an event, or over the time between two changes
SHORTEST = 1e3  # length of a run over the resolution of time
ROWS = "t", "q", "v", "lam", "mu"


class Run:
    """One solve with events."""

    def __init__(self, solver: Any, events: tuple[Event, ...], problem: Problem, request: Request, clock: Clock) -> None:
        self.solver, self.problem, self.request = solver, problem, request
        t, self.end = problem.t_span
        self.ahead, self.length = float(np.sign(self.end - t)), FIRST * abs(self.end - t)
        self.work, self.spent, self.output = Work(clock=clock), list[Counters](), list[Counters]()
        self.rows: list[tuple[Matrix, ...]] = []
        self.pieces: list[tuple[Point, float]] = []  #: motions without changes: start and end [s]
        self.occurrences: tuple[list[Occurrence], ...] = tuple([] for _ in events)
        self.known: Vector | None = None  #: (2k,) event functions, then roundoff of those at a zero
        self.samples = {i: 0 for i, event in enumerate(events) if event.period}  #: numbers of their next samples
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the solver warns of the same
            self.dynamics = dynamics_for(problem.system, PhasePoint(t, problem.q0, problem.v0))
        self.events = tuple(_fast(event, self.dynamics) for event in events)
        self.changes = Changes(self.events, self.dynamics, self.work)
        self.point = Point(t=t, q=problem.q0, v=problem.v0, vdot=np.zeros_like(problem.v0), size_q=0.0, size_v=0.0)
        self.fresh = True  #: whether the motion begins at ``point``, and not only a run of the solver

    def solution(self) -> Solution:
        """The solution up to the end, a terminal event or a failure."""
        ended = None
        try:
            while ended is None:
                ended = self._advance()
            rows = self._rows() if self.request.t_eval is None else self._rows_at(self.request.t_eval)
        except BudgetSpent as spent:
            ended, rows = budget_failure(spent, self.point.t), self._rows()
        except NonFiniteValue as error:
            text = f"{error}, after t = {exact(self.point.t)}"
            ended, rows = Failure(Status.nonfinite_callback, text), self._rows()
        n = self.problem.q0.size
        t, q, v, lam, mu = rows
        return Solution(
            t=t,
            q=q,
            v=v,
            lam=lam,
            mu=mu,
            status=ended.status,
            message=ended.message,
            counters=self._counters(),
            t_events=tuple(np.array([o.t for o in each]) for each in self.occurrences),
            q_events=tuple(np.array([o.q for o in each]).reshape(-1, n) for each in self.occurrences),
            v_events=tuple(np.array([o.v for o in each]).reshape(-1, n) for each in self.occurrences),
        )

    def _advance(self) -> Failure | None:
        """Run the solver once, up to the first event that stops it; a Failure if the solve ends there."""
        self.work.check_time()
        t = self.point.t
        if due := [i for i in self.samples if abs(self._sample_time(i) - t) <= _resolved(t)]:
            return self._sampled(due)
        whole = abs(self.end - t) <= LONGER * self.length
        stops = [self.end if whole else t + self.ahead * self.length, *map(self._sample_time, self.samples)]
        part = self._solve(self.point, min(stops) if self.ahead > 0 else max(stops))
        if not part.t.size:
            return Failure(part.status, part.message)
        one = self._point(part, 0)
        if self.fresh:
            self.pieces.append((one, self.end))
        for row in range(1, part.t.size):
            other = self._point(part, row)
            if self.known is None:
                self.known = starting_values(self.events, one, other.t - one.t, self.work)
            found, after = crossings_in(self.events, self.known, one, other, self.work)
            if at_once := [c for c in found if c.t == one.t and abs(self.known[c.index]) == BESIDE]:
                self._keep(part, row)
                return self._stopped(one, at_once, other.t - one.t)
            for crossing in found:
                place = located(self.events[crossing.index], crossing, one, other.t, self._reach, self.work)
                if isinstance(place, Failure):
                    self._keep(part, row)
                    return place
                if self.ahead * (place.t - self.end) > -_resolved(self.end):
                    place = replace(place, t=self.end)
                if self._stops(crossing):
                    self._keep(part, row)
                    return self._stopped(place, [crossing], other.t - one.t)
                self._noted(crossing, place)
            self.known, self.changes.made, one = after, [], other
        self._keep(part, part.t.size)
        self.point, self.fresh, self.length = one, False, LONGER * self.length
        return Failure(part.status, part.message) if not part.success or one.t == self.end else None

    def _stopped(self, place: Point, found: list[Crossing], h: float) -> Failure | None:
        """End the motion at ``place`` by the events ``found`` there; a Failure unless it goes on after a change."""
        begun = self.pieces[-1][0]
        if abs(place.t - begun.t) > _resolved(place.t):
            self._add_row(place)
            self.changes.made = []
        elif self.changes.pile_up(found, place, h):
            names = ", ".join(repr(self.events[c.index].name) for c in found)
            return Failure(Status.time_resolution, f"changes by event {names} pile up at t = {exact(place.t)}; {PILED_UP}")
        if unsure := self.changes.turned_back(found, place, h):
            return Failure(Status.time_resolution, f"changes by event {unsure} pile up at t = {exact(place.t)}; {PILED_UP}")
        found += self.changes.together(found, self.known, place, h)
        self.length = max(LONGER * abs(place.t - begun.t), abs(h), SHORTEST * _resolved(place.t))
        return self._changed(place, found, h)

    def _sample_time(self, index: int) -> float:
        """Time [s] of the next sample of a periodic event."""
        t = self.problem.t_span[0] + self.ahead * self.samples[index] * self.events[index].period
        return self.end if abs(t - self.end) <= _resolved(t) else t

    def _sampled(self, due: list[int]) -> Failure | None:
        """Apply the periodic events ``due`` at this time; a Failure if the solve ends there."""
        at: Any = PhasePoint(self.point.t, self.point.q, self.point.v)
        if self.known is None:
            guesses = self.problem.lam_guess, self.problem.mu_guess
            found = consistent_start(self.dynamics, at, guesses, self.work, calc_initcond=self.request.calc_initcond)
            if isinstance(found, Failure):
                return found
            at = found[0]
        h, place = self.ahead * self.length, self.changes.point(at.t, at.q, at.v, self.point.size_q, self.point.size_v)
        self.changes.made = []
        if self.known is None:
            self.known = starting_values(self.events, place, h, self.work)
            self._add_row(place)
        for index in due:
            self.samples[index] += 1
        return self._changed(place, [Crossing(index, place.t, 1, (place.t, place.t)) for index in due], h)

    def _changed(self, place: Point, found: list[Crossing], h: float) -> Failure | None:
        """Go on from ``place`` after the changes by ``found``; a Failure if the solve ends there."""
        for crossing in found:
            self._noted(crossing, place)
        if self.pieces:
            self.pieces[-1] = self.pieces[-1][0], place.t
        named = [repr(self.events[c.index].name) for c in found if self._ends(c.index)]
        after = self.changes.applied(found, place, h)
        if isinstance(after, Failure):
            return after
        self.point, self.known, self.fresh = *after, True
        if named:
            if any(self.events[c.index].change is not None for c in found):
                self._add_row(self.point)
            return Failure(Status.event, f"event {', '.join(named)} at t = {exact(place.t)}. {Status.event.text}")
        if self.point.t == self.end:
            self._add_row(self.point)
            return Failure(Status.success, Status.success.text)
        return None

    def _stops(self, crossing: Crossing) -> bool:
        """True if the next occurrence of this event ends the run or changes the state."""
        event = self.events[crossing.index]
        return event.change is not None or event.ends(len(self.occurrences[crossing.index]) + 1)

    def _ends(self, index: int) -> bool:
        return self.events[index].ends(len(self.occurrences[index]))

    def _noted(self, crossing: Crossing, at: Point) -> None:
        name = self.events[crossing.index].name
        self.occurrences[crossing.index].append(Occurrence(crossing.index, name, at.t, at.q, at.v))

    def _solve(self, start: Point, end: float, *, spent: list[Counters] | None = None, **request: Any) -> Solution:
        """The solver without events from ``start`` to ``end`` [s], with what is left of the budgets."""
        spent = self.spent if spent is None else spent
        asked = self.request.but(**({"t_eval": None} | request))
        for budget, counter in (("max_num_steps", "steps_accepted"), ("max_evaluations", "residual_evaluations")):
            if (most := getattr(asked, budget)) is not None:
                left = most - sum(getattr(one, counter) or 0 for one in self.spent)
                asked = asked.but(**{budget: max(left, 1)})
        q, v = start.q, start.v
        if self.known is not None and self.dynamics.structure.constrained:  # a row may have drifted off the constraints
            moved = project(self.dynamics, PhasePoint(start.t, q, v), self.work)
            q, v = (q, v) if isinstance(moved, Failure) else (moved[0].q, moved[0].v)
            asked = asked.but(calc_initcond=False)
        found: Solution = self.solver.solve(self.problem.starting((start.t, end), q, v), asked)
        spent.append(found.counters)
        return found

    def _reach(self, start: Point, end: float) -> Point | Failure:
        part = self._solve(start, end)
        return self._point(part, -1) if part.success else Failure(part.status, part.message)

    def _point(self, part: Solution, row: int) -> Point:
        t, q, v = float(part.t[row]), part.q[row], part.v[row]
        sizes = (max(size, float(np.max(np.abs(x)))) for size, x in ((self.point.size_q, q), (self.point.size_v, v)))
        return self.changes.point(t, q, v, *sizes)

    def _keep(self, part: Solution, end: int) -> None:
        """Keep the rows of ``part`` before row ``end``; the first one only if the motion begins there."""
        rows = slice(0 if self.fresh else 1, end)
        self.rows.append(tuple(getattr(part, name)[rows] for name in ROWS))

    def _add_row(self, place: Point) -> None:
        found = of_dynamics(self.dynamics).acceleration.solve(place.t, place.q, place.v)
        lam, mu = padded(self.dynamics, found.lam[None], found.mu[None])
        self.rows.append((np.array([place.t]), place.q[None], place.v[None], lam, mu))

    def _rows(self) -> list[Matrix]:
        if not self.rows:
            n = self.problem.q0.size
            return [np.zeros(0), np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, 0)), np.zeros((0, 0))]
        return [np.concatenate(column) for column in zip(*self.rows, strict=True)]

    def _rows_at(self, times: Vector) -> list[Matrix]:
        """Rows at ``times`` (k,): each motion between changes is solved again with them."""
        if not self.rows:
            return self._rows()
        last, begun, rows = self.rows[-1][0][-1], self.problem.t_span[0], []
        if times.size and times[0] == begun:  # the start itself, before any change there
            rows.append(tuple(column[:1] for column in self.rows[0]))
            times = times[1:]
        for i, (start, end) in enumerate(self.pieces):
            closed = i == len(self.pieces) - 1
            end = last if closed else end
            inside = self.ahead * (times - start.t) >= 0
            inside &= self.ahead * (end - times) >= 0 if closed else self.ahead * (end - times) > 0
            if start.t != end and inside.any():
                part = self._solve(start, end, spent=self.output, t_eval=times[inside])
                rows.append(tuple(getattr(part, name) for name in ROWS))
        self.rows = rows
        return self._rows()

    def _counters(self) -> Counters:
        """Work of all runs; that of rows at asked times as output."""
        parts = partial(_summed, [*self.spent, self.work.counters()])
        found = {one.name: parts(one.name) for one in fields(Counters) if one.name != "provenance"}
        if self.output and found["output_evaluations"] is not None:
            found["output_evaluations"] += _summed(self.output, "residual_evaluations") or 0
        return Counters(**found, provenance=self.spent[0].provenance if self.spent else "counted")


def _resolved(t: float) -> float:
    """Times [s] closer than this to ``t`` are one time."""
    return TOGETHER * float(np.spacing(abs(t)))


def _fast(event: Event, dynamics: Dynamics) -> Event:
    """``event`` with its function as machine code where that is possible."""
    n = dynamics.structure.n
    code = None if route_of(dynamics) == "numpy" else code_of(event, dynamics, n)
    if code is None:
        return event
    call: Any = native_call(code, ((), (n,), (n,)))
    return replace(event, function=lambda t, q, v: call(t, q, v)[0])


def _summed(parts: list[Counters], name: str) -> int | None:
    values = [getattr(one, name) for one in parts]
    return None if None in values else sum(values)
