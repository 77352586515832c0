"""Steps watched for events: which occur in a step, the step cut short at one that stops it, the state after a change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Native
from hhtbench.result import Status
from solvers._start import Failure, Place, budget_failure
from solvers.hht.control import Advance, ErrorControlled, Prescribed
from solvers.hht.dense import HermiteOutput
from solvers.hht.engine import HostEngine
from solvers.hht.estimate import remembered
from solvers.hht.events import Crossing, Event, Occurrence, changed_by, scan
from solvers.hht.history import History
from solvers.hht.landing import along, land
from solvers.hht.native.engine import NativeEngine
from solvers.hht.native.watching import CompiledEvents, Watched
from solvers.hht.start import first_state, project
from solvers.hht.state import State, Step

CUTS = 20  # of one step: each finds an earlier event than the last
PILED = 1e-5  # of a step: an event that comes again so soon after its own change will not let go, as at the end of bounces
PILED_UP = "let the change end the motion there, or make the event terminal."


@dataclass(frozen=True)
class Watch:
    """What the search for events keeps between two steps."""

    counts: tuple[int, ...] = ()  #: occurrences so far
    values: Vector | None = None  #: (k,) event functions at the last step's end; None: the motion begins here
    changed: tuple[int, ...] = ()  #: events that made the state it begins from


@dataclass(frozen=True)
class Passage:
    """One accepted step, which ends at the first event that stops it, with the events on the way."""

    step: Step
    watch: Watch
    occurrences: tuple[Occurrence, ...] = ()
    stopping: tuple[int, ...] = ()  #: events at the end of the step that end the integration or change the state


@dataclass(frozen=True)
class Landed:
    """A step made shorter to end at an event."""

    step: Step
    index: int  #: of the event


@dataclass(frozen=True, kw_only=True)
class Course:
    """How an integration goes on from a state."""

    engine: HostEngine
    advance: Advance
    events: tuple[Event, ...] = ()
    prepare: Callable[[State, float], State] | None = None  #: for step control, where a motion begins

    def march(self, state: State, watch: Watch, stop: float, history: History, most: int | None) -> tuple[State, Watch, int]:
        """As many steps at once as compiled loops make, at most ``most``: where they end, and their number.

        None where the next step needs a closer look, as one with an event does: :meth:`next` makes it.
        """
        if not isinstance(self.engine, NativeEngine) or self._codes is None or (self.events and watch.values is None):
            return state, watch, 0
        try:
            self.engine.work.check_time()
            if self.prepare is not None and state.memory is None:
                state = self.prepare(state, stop)
        except (BudgetSpent, NonFiniteValue):  # the next step tells
            return state, watch, 0
        if self._unreachable(state, stop):
            return state, watch, 0
        looks = self._looks(watch)
        state, made = self.engine.march(state, self.advance, stop, history, most, looks)
        return state, replace(watch, values=looks.values) if made and self.events else watch, made

    def _unreachable(self, state: State, stop: float) -> Failure | None:
        return self.advance.unreachable(state, stop) if isinstance(self.advance, ErrorControlled) else None

    def _in_machine_code(self, state: State, stop: float) -> Step | None:
        """The next step from compiled loops, with the events it may have; None: the host engine makes it."""
        if not isinstance(self.engine, NativeEngine):
            return None
        self.engine.work.check_time()
        return self.engine.one(state, self.advance, stop, self._looks(Watch()))

    def _looks(self, watch: Watch) -> Watched:
        events = self.events if self._codes is not None else ()
        return Watched(events, self._codes or [], np.zeros(len(events)) if watch.values is None else watch.values)

    @property
    def _codes(self) -> list[Native] | None:
        """The event functions in machine code; None where one cannot be compiled."""
        return self._compiled.codes

    @cached_property
    def _compiled(self) -> CompiledEvents:
        return CompiledEvents(self.engine.dynamics, self.events, self.engine.structure.n)

    def next(self, state: State, watch: Watch, stop: float) -> Passage | Failure:
        """The next accepted step towards ``stop`` [s]; a spent budget is a failure like others."""
        try:
            if self.prepare is not None and state.memory is None:
                state = self.prepare(state, stop)
            if failure := self._unreachable(state, stop):
                return failure
            step = self._in_machine_code(state, stop) or self.advance(state, stop)
            if isinstance(step, Failure) or not self.events:
                return step if isinstance(step, Failure) else Passage(step, watch)
            return self._watched(state, step, watch)
        except BudgetSpent as spent:
            return budget_failure(spent, state.t)
        except NonFiniteValue as error:  # of an event function
            return Failure(Status.nonfinite_callback, f"{error}, in the step from t = {state.t:.17g}")

    def terminal(self, passage: Passage) -> str | None:
        """The event that ends the integration after ``passage``, in words."""
        named = [self.events[i].name for i in passage.stopping if self.events[i].ends(passage.watch.counts[i])]
        if not named:
            return None
        return f"event {', '.join(map(repr, named))} at t = {passage.step.state.t:.17g}. {Status.event.text}"

    def watch_after(self, passage: Passage, state: State) -> Watch:
        """What goes on with ``state``, the end of ``passage`` or what its events made of it."""
        if state is passage.step.state:
            return passage.watch
        return replace(passage.watch, values=None, changed=passage.stopping)

    def changed(self, passage: Passage) -> State | Failure:
        """The state after the changes that events make at the end of ``passage``; without one the end itself."""
        state = passage.step.state
        events = [self.events[i] for i in passage.stopping if self.events[i].change is not None]
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

    def _watched(self, before: State, step: Step, watch: Watch) -> Passage | Failure:
        """``step`` from ``before`` up to its first event that stops it."""
        whole, landed = step, None
        for _ in range(CUTS):
            output = along(before, step)
            found = scan(self.events, watch.values, output, self.engine.work)
            crossings = _with_landed(found.crossings, landed, step.state.t)
            earlier = self._land_first(before, step, crossings, watch.counts)
            if isinstance(earlier, Failure):
                return earlier
            if earlier is not None and self._piled(earlier, before, whole, watch):
                name, t = self.events[earlier.index].name, earlier.step.state.t
                return Failure(Status.time_resolution, f"changes by event {name!r} pile up at t = {t:.17g}; {PILED_UP}")
            if earlier is None:
                step = step if step is whole else self._as_accepted(before, whole, step)
                return self._passage(step, output, crossings, Watch(watch.counts, found.values))
            step, landed = earlier.step, earlier
        text = f"in the step from t = {before.t:.17g} with h = {whole.state.h:g} each look shows an event before the last"
        return Failure(Status.time_resolution, f"{text}; take shorter steps.")

    def _piled(self, landed: Landed, before: State, whole: Step, watch: Watch) -> bool:
        """Whether the event that made the state ``before`` comes again in no time."""
        again = landed.index in watch.changed and self.events[landed.index].change is not None
        return again and abs(landed.step.state.t - before.t) < PILED * abs(whole.state.t - before.t)

    def _land_first(
        self, before: State, step: Step, crossings: list[Crossing], counts: tuple[int, ...]
    ) -> Landed | Failure | None:
        """The shorter step to the first of ``crossings`` that stops, None where that is at the end or there is none.

        What only the interpolant crosses is removed from ``crossings``.
        """
        while (first := self._first_stop(crossings, counts)) is not None and first.t != step.state.t:
            cut = land(self.engine, self.events[first.index], first, before, step)
            if cut is not None:
                return cut if isinstance(cut, Failure) else Landed(cut, first.index)
            crossings.remove(first)
        return None

    def _first_stop(self, crossings: Sequence[Crossing], counts: tuple[int, ...]) -> Crossing | None:
        tally = list(counts)
        for crossing in crossings:
            event = self.events[crossing.index]
            tally[crossing.index] += 1
            if event.change is not None or event.ends(tally[crossing.index]):
                return crossing
        return None

    def _passage(self, step: Step, output: HermiteOutput, crossings: Sequence[Crossing], watch: Watch) -> Passage:
        counts, occurrences, stopping = list(watch.counts), [], []
        for crossing in crossings:
            event = self.events[crossing.index]
            counts[crossing.index] += 1
            occurrences.append(Occurrence(crossing.index, event.name, crossing.t, *output(crossing.t)))
            if event.change is not None or event.ends(counts[crossing.index]):
                stopping.append(crossing.index)
        return Passage(step, replace(watch, counts=tuple(counts)), tuple(occurrences), tuple(sorted(set(stopping))))

    def _as_accepted(self, before: State, whole: Step, step: Step) -> Step:
        """``step``, cut from ``whole``, with what the control of steps keeps of it."""
        if isinstance(self.advance, Prescribed):
            self.advance.cut_short()
        memory = whole.state.memory
        if memory is None:
            return step
        if isinstance(self.advance, ErrorControlled):
            memory = remembered(step, self.advance.estimator(before, step), before, memory.h_next)
        else:
            memory = replace(memory, last=step.state.h or 0.0, acceleration=step.state.f)
        return replace(step, state=replace(step.state, memory=memory))


def _with_landed(crossings: Sequence[Crossing], landed: Landed | None, end: float) -> list[Crossing]:
    """``crossings`` of a step that was made to end at the event ``landed``: the last one of that is at its end."""
    if landed is None:
        return list(crossings)
    index, result = landed.index, list(crossings)
    own = [crossing for crossing in result if crossing.index == index]
    if own:
        result.remove(own[-1])
    return [*result, replace(own[-1], t=end) if own else Crossing(index, end, 0, (end, end))]


def _begun_anew(engine: HostEngine, events: Sequence[Event], state: State) -> State | Failure:
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
