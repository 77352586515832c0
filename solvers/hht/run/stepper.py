"""Steps one after the other, with what the events in them ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import ConstraintLevels
from hhtbench.result import Status
from solvers._start import Failure, Place, budget_failure
from solvers.hht.control.first_step import prepared
from solvers.hht.control.plan import ControlOptions, Plan
from solvers.hht.events.event import Event, Occurrence, changed_by, value_of
from solvers.hht.events.locate import Attempt, Crossing, NotMade, StepTo, along, crossings
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine
from solvers.hht.run.failures import failure_of
from solvers.hht.run.march import Control
from solvers.hht.run.start import first_state, project
from solvers.hht.step.state import State

CUTS = 20  # of one step: each finds an earlier event than the last
PILED = 1e-5  # of a step: an event that comes again so soon after its own change will not let go, as at the end of bounces
PILED_UP = "let the change end the motion there, or make the event terminal."
NAMES = ("min_step", "max_step", "target", "integral", "proportional", "growth", "shrink", "least", "spacings")


@dataclass(frozen=True)
class EventState:
    """What the search for events keeps between two steps."""

    counts: tuple[int, ...] = ()  #: occurrences so far
    values: Vector | None = None  #: (k,) event functions at the last step's end; None: the motion begins here
    changed: tuple[int, ...] = ()  #: events that made the state it begins from


@dataclass(frozen=True)
class Accepted:
    """Accepted steps, the last of which ends at the first event that stops it, with the events on the way there."""

    state: State  #: after them
    made: int  #: how many
    watch: EventState
    occurrences: tuple[Occurrence, ...] = ()
    stopping: tuple[int, ...] = ()  #: events at the end of the last step that end the integration or change the state
    failure: Failure | None = None  #: why there are no more


@dataclass(frozen=True)
class Shortened:
    """A step made shorter to end at an event."""

    attempt: Attempt
    index: int  #: of the event


@dataclass(frozen=True, kw_only=True)
class Stepper:
    """How an integration goes on from a state."""

    engine: Engine
    plan: Plan
    events: tuple[Event, ...] = ()

    def advance(self, state: State, watch: EventState, stop: float, rows: Matrix) -> Accepted:
        """At most as many accepted steps towards ``stop`` [s] as there are ``rows`` to write to, up to an event in one.

        A spent budget and a value that is not finite are failures like others.
        """
        try:
            return self._advance(state, watch, stop, rows)
        except BudgetSpent as spent:
            return Accepted(state, 0, watch, failure=budget_failure(spent, state.t))
        except NonFiniteValue as error:  # of an event function, or of the look at a motion's start
            text = f"{error}, in the step from t = {state.t:.17g}"
            return Accepted(state, 0, watch, failure=Failure(Status.nonfinite_callback, text))

    def _advance(self, state: State, watch: EventState, stop: float, rows: Matrix) -> Accepted:
        engine, by_error = self.engine, self.plan.by_error
        engine.work.check_time()
        engine.watch(self.events)
        if by_error is not None:
            engine.tolerate(by_error.tolerances.rtol, by_error.tolerances.atol)
            if state.memory is None:
                state = prepared(engine, state, by_error.tolerances, by_error.options, stop)
            if failure := by_error.unreachable(state, stop):
                return Accepted(state, 0, watch, failure=failure)
        lengths, ends = self.plan.ahead(state, stop, len(rows))
        rows = rows if by_error is not None else rows[: lengths.size]
        before = state
        state, made, ended = engine.march(state, self._control(stop), lengths, ends, rows, watch.values)
        self.plan.made(made)
        if made and self.events:
            watch = replace(watch, values=engine.event_values(), changed=())
        if ended == mem.CONVERGED:
            return Accepted(state, made, watch)
        if ended == mem.SUSPECT:
            engine.give_up_derivatives(before)
            return self._advance(before, watch, stop, rows)
        if ended == mem.EVENT_NONFINITE:
            self._raise_nonfinite()
        if ended == mem.EVENT_FOUND:
            return self._with_events(state, watch, stop, rows)
        return Accepted(state, 0, watch, failure=failure_of(engine, self.plan, state, ended))

    def _control(self, stop: float) -> Control:
        by_error = self.plan.by_error
        return control_of(
            ControlOptions() if by_error is None else by_error.options, stop, by_error is not None, self.events
        )

    def _raise_nonfinite(self) -> None:
        """Raise for the event function that was not finite where the loops have looked last."""
        n = self.engine.structure.n
        (t,), q, v = np.split(self.engine.section(mem.PLACE), [1, 1 + n])
        for event in self.events:
            value_of(event, float(t), q, v, self.engine.work)
        raise NonFiniteValue("an event function", (), float("nan"), float(t))

    def terminal(self, accepted: Accepted) -> str | None:
        """The event that ends the integration after ``accepted``, in words."""
        named = [self.events[i].name for i in accepted.stopping if self.events[i].ends(accepted.watch.counts[i])]
        if not named:
            return None
        return f"event {', '.join(map(repr, named))} at t = {accepted.state.t:.17g}. {Status.event.text}"

    def watch_after(self, accepted: Accepted, state: State) -> EventState:
        """What goes on with ``state``, the end of ``accepted`` or what its events made of it."""
        if state is accepted.state:
            return accepted.watch
        return replace(accepted.watch, values=None, changed=accepted.stopping)

    def changed(self, accepted: Accepted) -> State | Failure:
        """The state after the changes that events make at the end of ``accepted``; without one the end itself."""
        state = accepted.state
        events = [self.events[i] for i in accepted.stopping if self.events[i].change is not None]
        if not events:
            return state
        where = f"after the change by event {', '.join(repr(event.name) for event in events)} at t = {state.t:.17g}"
        try:
            found = _begun_anew(self.engine, events, state)
        except BudgetSpent as spent:
            return budget_failure(spent, state.t)
        except NonFiniteValue as error:
            return Failure(Status.nonfinite_callback, f"{error}, {where}")
        return Failure(found.status, f"{where}: {found.message}") if isinstance(found, Failure) else found

    def _with_events(self, before: State, watch: EventState, stop: float, rows: Matrix) -> Accepted:
        """The step that the loops have tried, up to its first event that stops it."""
        engine, cut = self.engine, None
        whole = now = engine.attempted()
        for _ in range(CUTS):
            output = along(before, now)
            times, values = engine.section(mem.SAMPLE_TIMES).copy(), engine.section(mem.SAMPLE_VALUES).copy()
            found = _with_cut(crossings(self.events, times, values, output, engine.work), cut, float(now[0][mem.T_END]))
            try:
                earlier = self._cut_first(before, now, found, watch.counts)
            except NotMade as error:
                return Accepted(before, 0, watch, failure=failure_of(engine, self.plan, before, error.ended))
            if earlier is None:
                engine.put_back(now)
                state, row = engine.take(before, self._control(stop), watch.values, located=cut is not None)
                rows[0] = row
                self.plan.made(1)
                if cut is not None:
                    self.plan.cut_short()
                return self._passed(state, output, found, replace(watch, values=engine.event_values(), changed=()))
            if self._piled(earlier, before, float(whole[0][mem.T_END]), watch):
                name, t = self.events[earlier.index].name, float(earlier.attempt[0][mem.T_END])
                text = f"changes by event {name!r} pile up at t = {t:.17g}; {PILED_UP}"
                return Accepted(before, 0, watch, failure=Failure(Status.time_resolution, text))
            now, cut = earlier.attempt, earlier
            engine.put_back(now)
            if engine.look() == mem.EVENT_NONFINITE:
                self._raise_nonfinite()
        h = float(whole[0][mem.T_END]) - before.t
        text = f"in the step from t = {before.t:.17g} with h = {h:g} each look shows an event before the last"
        return Accepted(before, 0, watch, failure=Failure(Status.time_resolution, f"{text}; take shorter steps."))

    def _piled(self, cut: Shortened, before: State, end: float, watch: EventState) -> bool:
        """Whether the event that made the state ``before`` comes again in no time, in a step that was to reach ``end``."""
        again = cut.index in watch.changed and self.events[cut.index].change is not None
        return again and abs(float(cut.attempt[0][mem.T_END]) - before.t) < PILED * abs(end - before.t)

    def _cut_first(self, before: State, now: Attempt, found: list[Crossing], counts: tuple[int, ...]) -> Shortened | None:
        """The shorter step to the first of ``found`` that stops, None where that is at the end or there is none.

        What only the interpolant crosses is removed from ``found``.
        """
        while (first := self._first_stop(found, counts)) is not None and first.t != now[0][mem.T_END]:
            attempt = StepTo(self.engine, self.events[first.index], first, before, now).attempt()
            if attempt is not None:
                return Shortened(attempt, first.index)
            found.remove(first)
        return None

    def _first_stop(self, crossings: Sequence[Crossing], counts: tuple[int, ...]) -> Crossing | None:
        tally = list(counts)
        for crossing in crossings:
            event = self.events[crossing.index]
            tally[crossing.index] += 1
            if event.change is not None or event.ends(tally[crossing.index]):
                return crossing
        return None

    def _passed(self, state: State, output: Any, found: Sequence[Crossing], watch: EventState) -> Accepted:
        counts, occurrences, stopping = list(watch.counts), [], []
        for crossing in found:
            event = self.events[crossing.index]
            counts[crossing.index] += 1
            occurrences.append(Occurrence(crossing.index, event.name, crossing.t, *output(crossing.t)))
            if event.change is not None or event.ends(counts[crossing.index]):
                stopping.append(crossing.index)
        watch = replace(watch, counts=tuple(counts))
        return Accepted(state, 1, watch, tuple(occurrences), tuple(sorted(set(stopping))))


def control_of(o: ControlOptions, stop: float, controlled: bool, events: Sequence[Event]) -> Control:
    """As the loops take it."""
    values = {name: float(getattr(o, name)) for name in (*NAMES, "after_failure", "grown")}
    return Control(controlled=controlled, watching=bool(events), stop=float(stop), keep=o.keep, **values)


def _with_cut(found: Sequence[Crossing], cut: Shortened | None, end: float) -> list[Crossing]:
    """``found`` in a step that was made to end at the event of ``cut``: the last one of that is at its end."""
    if cut is None:
        return list(found)
    index, result = cut.index, list(found)
    own = [crossing for crossing in result if crossing.index == index]
    if own:
        result.remove(own[-1])
    return [*result, replace(own[-1], t=end) if own else Crossing(index, end, 0, (end, end))]


def _begun_anew(engine: Engine, events: Sequence[Event], state: State) -> State | Failure:
    """A first state at the time of ``state``, from what ``events`` make of q and v, projected by (H20)."""
    q, v = state.q, state.v
    for event in events:
        q, v = changed_by(event, state.t, q, v)
    place = Place(state.t, q, v)
    if engine.structure.constrained:
        projected: Any = project(engine.dynamics, ConstraintLevels(engine.dynamics), place, engine.work)
        if isinstance(projected, Failure):
            return projected
        place = projected[0]
    new = first_state(engine, place, state.lam, state.mu, state.h or 0.0)
    if isinstance(new, Failure):
        return new
    return replace(new, size_q=max(new.size_q, state.size_q), size_v=max(new.size_v, state.size_v))
