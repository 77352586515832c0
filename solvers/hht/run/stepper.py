"""Steps one after the other: advance in the compiled loops, then end steps at events and apply state changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.events import Event
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers._initcond import project
from solvers._projection import PROJECTED, sizes_from
from solvers._start import CORRECT, Failure, PhasePoint, budget_failure, of_dynamics, violations
from solvers.hht.control.plan import ByError, Plan
from solvers.hht.equations.formulas import SHORT
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence, changed_by, value_of
from solvers.hht.events.locate import Attempt, Crossing, NotMade, StepTo, along, crossings, together
from solvers.hht.events.sides import BESIDE, changed_values, is_leaving, side_after, starting_values
from solvers.hht.run.engine import Engine
from solvers.hht.run.march import look
from solvers.hht.run.projecting import put_on_constraints
from solvers.hht.run.start import first_state
from solvers.hht.step.state import State
from solvers.kernel import memory as mem

CUTS = 20  # times that one step is shortened: each finds an earlier event than the last
JUMP = "look for a jump in the forces, or a wrong derivative"
RESIDUAL = "the step's residual"  # named in messages where each function by itself is finite
PILED_UP = "give the event a restitution and then=, a system with a constraint, or end the run earlier by terminal=N."
MAX_CHANGES_AT_ONCE = 100  # state changes by one event at one time, as between bodies that collide together


@dataclass(frozen=True)
class EventState:
    """State of the event search carried from one step to the next."""

    counts: tuple[int, ...] = ()  #: (k,) occurrences of each event so far
    values: Vector | None = None  #: (2k,) event functions, then roundoff of those at a zero; None: not evaluated yet
    changed: tuple[int, ...] = ()  #: indices of events that have changed the state at this time
    sides: tuple[int, ...] = ()  #: (k,) sign of each function after a change, 0: no change; (): ``values`` are current
    ahead: float = 0.0  #: signed length [s] of the step that follows a start or a change


class Accepted(NamedTuple):
    """Accepted steps, up to the first event that stops integration or changes the state, with all events on the way."""

    state: State  #: after the last of them
    watch: EventState
    made: int = 0  #: number of accepted steps
    occurrences: tuple[Occurrence, ...] = ()
    stopping: tuple[Crossing, ...] = ()  #: events at the last step's end that stop the run or change the state
    ended: Failure | None = None  #: why the run ends here: a failure or a terminal event; None: it goes on


Cut = tuple[Attempt, Crossing]  # a step shortened to end at an event, and that event


@dataclass(kw_only=True)
class Stepper:
    """Advances a state with an engine, a plan of steps and events."""

    engine: Engine
    plan: Plan
    events: tuple[Event, ...] = ()

    def advance(self, state: State, watch: EventState, stop: float, rows: Matrix, horizon: float | None = None) -> Accepted:
        """Take at most ``len(rows)`` accepted steps towards ``stop`` [s], ending at the first event found.

        Steps are written to ``rows``.  A spent budget and a value that is not finite are returned as failures.  The first
        step of a motion does not pass ``horizon`` [s].
        """
        try:
            return self._advance(state, watch, stop, rows, stop if horizon is None else horizon)
        except BudgetSpent as spent:
            return Accepted(state, watch, ended=budget_failure(spent, state.t))
        except NonFiniteValue as error:  # raised by an event function, or where a first step is chosen
            text = f"{error}, in the step from t = {exact(state.t)}"
            return Accepted(state, watch, ended=Failure(Status.nonfinite_callback, text))

    def _advance(self, state: State, watch: EventState, stop: float, rows: Matrix, horizon: float) -> Accepted:
        engine, by_error = self.engine, self.plan.by_error
        engine.work.check_time()
        engine.watch(self.events)
        if by_error is not None:
            engine.loops.allow(by_error.tolerances)
            if not state.controlled:
                state = engine.prepared(state, horizon)
            if failure := by_error.unreachable(state, stop):
                return Accepted(state, watch, ended=failure)
        lengths, ends = self.plan.ahead(state, stop, len(rows))
        rows = rows if by_error is not None else rows[: lengths.size]
        before = state
        if self.events and (watch.values is None or watch.sides):
            h = lengths[0] if state.memory is None else np.copysign(state.memory.h_next, stop - state.t)
            watch = self._begun(watch, state, float(h))
        state, made, ended = engine.march(state, self.plan, stop, lengths, ends, rows, watch.values)
        self.plan.made(made)
        if made and self.events:
            watch = replace(watch, values=engine.loops.section(mem.EVENT_VALUES).copy(), changed=())
        if ended == mem.CONVERGED:
            return Accepted(state, watch, made)
        if ended == mem.FALL_BACK:
            engine.retry_without_declared(before)
            return self._advance(before, watch, stop, rows, horizon)
        if ended == mem.EVENT_NONFINITE:
            self._raise_nonfinite()
        if ended == mem.EVENT_FOUND:
            return self._with_events(state, watch, rows)
        return Accepted(state, watch, ended=failure_of(engine, self.plan, state, ended))

    def _begun(self, watch: EventState, state: State, h: float) -> EventState:
        """``watch`` with the event functions evaluated at ``state`` (a start, or changed), before a step of ``h`` [s]."""
        if watch.values is None:
            values = starting_values(self.events, state, h, self.engine.work)
        else:
            values = changed_values(self.events, watch.sides, watch.values, state, h, self.engine.work)
        return replace(watch, values=values, sides=(), ahead=h)

    def _raise_nonfinite(self) -> None:
        """Raise for the event function whose last value in the loops was not finite."""
        n = self.engine.structure.n
        (t,), q, v = np.split(self.engine.loops.section(mem.PLACE), [1, 1 + n])
        for event in self.events:
            value_of(event, float(t), q, v, self.engine.work)
        raise NonFiniteValue("an event function", (), float("nan"), float(t))

    def after_events(self, accepted: Accepted) -> Accepted:
        """Apply the state changes of events at the end of ``accepted``; a terminal event or a failed change ends the run."""
        state, watch, ended = accepted.state, accepted.watch, accepted.ended
        if not accepted.stopping:
            return accepted
        before = {crossing.index: crossing.side for crossing in accepted.stopping}
        changing = [i for i in sorted(before) if self.events[i].change is not None]
        if changing:
            sides = [before[i] if i in changing else 0 for i in range(len(self.events))]
            changed = self._changed(state, sides, state.h or watch.ahead)
            if isinstance(changed, Failure):
                return accepted._replace(ended=changed)
            state, watch = changed, replace(watch, changed=(*watch.changed, *changing), sides=tuple(sides))
        named = [self.events[i].name for i in sorted(before) if self.events[i].ends(watch.counts[i])]
        if named:
            text = f"event {', '.join(map(repr, named))} at t = {exact(state.t)}. {Status.event.text}"
            ended = Failure(Status.event, text)
        return accepted._replace(state=state, watch=watch, ended=ended)

    def _changed(self, state: State, sides: list[int], h: float) -> State | Failure:
        """Apply the changes of all events with nonzero ``sides``, project by (H20), and compute a first state there.

        ``sides`` (k,): sign of each changing event function before its change, 0 for others; overwritten by that after it.
        """
        changing = [(i, event) for i, event in enumerate(self.events) if sides[i]]
        where = f"after the change by event {', '.join(repr(event.name) for _, event in changing)} at t = {exact(state.t)}"
        engine, place = self.engine, PhasePoint(state.t, state.q, state.v)
        try:
            for i, event in changing:
                made: Any = PhasePoint(state.t, *changed_by(event, state.t, place.q, place.v))
                if engine.structure.constrained:
                    made = project(engine.dynamics, made, engine.work)
                if isinstance(made, Failure):
                    return Failure(made.status, f"{where}: {made.message}")
                place = made[0] if engine.structure.constrained else made
                sides[i] = side_after(event, sides[i], replace(state, q=place.q, v=place.v), h, engine.work)
            new = first_state(engine, place, state.lam, state.mu, state.h or 0.0)
        except BudgetSpent as spent:
            return budget_failure(spent, state.t)
        except NonFiniteValue as error:
            return Failure(Status.nonfinite_callback, f"{error}, {where}")
        if isinstance(new, Failure):
            return Failure(new.status, f"{where}: {new.message}")
        return replace(new, size_q=max(new.size_q, state.size_q), size_v=max(new.size_v, state.size_v))

    def _with_events(self, before: State, watch: EventState, rows: Matrix) -> Accepted:
        """Accept the step last tried in the loops, shortened to end at its first stopping event."""
        engine, cut = self.engine, None
        now = engine.attempted()
        h, (values_before, roundoff) = float(now[0][mem.T_END]) - before.t, np.split(watch.values, 2)  # type: ignore[arg-type]
        for _ in range(CUTS):
            output = along(before, now)
            times, values = engine.loops.section(mem.SAMPLE_TIMES).copy(), engine.loops.section(mem.SAMPLE_VALUES).copy()
            end = float(now[0][mem.T_END])
            seen = crossings(self.events, times, values, roundoff, output, engine.work)
            if at_once := [c for c in seen if c.t == before.t and abs(values_before[c.index]) == BESIDE]:
                return self._at_once(before, watch, output, at_once)
            found = _with_cut(seen, cut, end)
            try:
                earlier = self._cut_first(before, now, found, watch.counts)
            except NotMade as error:
                return Accepted(before, watch, ended=failure_of(engine, self.plan, before, error.ended))
            if earlier is None:
                engine.put_back(now)
                state, rows[0] = engine.take(before, watch.values, located=cut is not None)
                self.plan.made(1)
                if cut is not None:
                    self.plan.cut_short()
                watch = replace(watch, values=engine.loops.section(mem.EVENT_VALUES).copy(), changed=())
                stopped = [crossing for crossing, _, stops in self._counted(found, watch.counts) if stops]
                if stopped:
                    found += together(self.events, times, values, stopped)
                return self._passed(state, output, found, watch)
            (now, _), cut = earlier, earlier
            engine.put_back(now)
            if engine.loops.call(look) == mem.EVENT_NONFINITE:
                self._raise_nonfinite()
        text = f"in the step from t = {exact(before.t)} with h = {h:g} every search finds a still earlier event"
        return Accepted(before, watch, ended=Failure(Status.time_resolution, f"{text}; take shorter steps."))

    def _at_once(self, before: State, watch: EventState, output: HermiteOutput, found: Sequence[Crossing]) -> Accepted:
        """Apply the events ``found`` at ``before`` itself without a step, since it starts at their zero.

        An event may change the state twice at one time if another event's change leads back to its zero, as between three
        bodies that collide together; otherwise the run ends because changes pile up.
        """
        again = [repr(self.events[c.index].name) for c in found if self._piles_up(c, before, watch)]
        if again:
            text = f"changes by event {', '.join(again)} pile up at t = {exact(before.t)}; {PILED_UP}"
            return Accepted(before, watch, ended=Failure(Status.time_resolution, text))
        return self._passed(before, output, found, watch)._replace(made=0)

    def _piles_up(self, crossing: Crossing, before: State, watch: EventState) -> bool:
        times = watch.changed.count(crossing.index)
        leaving = partial(is_leaving, self.events[crossing.index], -crossing.side, before, watch.ahead, self.engine.work)
        return times > MAX_CHANGES_AT_ONCE or (times > 0 and not leaving())

    def _cut_first(self, before: State, now: Attempt, found: list[Crossing], counts: tuple[int, ...]) -> Cut | None:
        """The shorter step that ends at the first stopping event of ``found``; None if that is the step's end or none stops.

        Crossings of the interpolant that no shorter step confirms are removed from ``found``.
        """
        while (first := next((c for c, _, stops in self._counted(found, counts) if stops), None)) is not None:
            if first.t == now[0][mem.T_END]:
                break
            attempt = StepTo(self.engine, self.events[first.index], first, before, now).attempt()
            if attempt is not None:
                return attempt, first
            found.remove(first)
        return None

    def _counted(self, found: Sequence[Crossing], counts: tuple[int, ...]) -> Iterator[tuple[Crossing, int, bool]]:
        """Yield each crossing with its occurrence number and whether it stops the run or changes the state."""
        numbers = list(counts)
        for crossing in found:
            event = self.events[crossing.index]
            numbers[crossing.index] += 1
            number = numbers[crossing.index]
            yield crossing, number, event.change is not None or event.ends(number)

    def _passed(self, state: State, output: HermiteOutput, found: Sequence[Crossing], watch: EventState) -> Accepted:
        counted, counts = list(self._counted(found, watch.counts)), list(watch.counts)
        for crossing, number, _ in counted:
            counts[crossing.index] = number
        events = tuple(Occurrence(c.index, self.events[c.index].name, c.t, *self._state_at(c.t, output)) for c in found)
        stopping = tuple(crossing for crossing, _, stops in counted if stops)
        return Accepted(state, replace(watch, counts=tuple(counts)), 1, events, stopping)

    def _state_at(self, t: float, output: HermiteOutput) -> tuple[Vector, Vector, str]:
        """q and v (n,) at ``t`` in one step's dense output, projected onto the constraints, and a warning if that failed."""
        q, v = (np.atleast_2d(x) for x in output(t))
        if t in output.t or not (self.engine.structure.constrained and self.engine.method.coefficients.both_levels):
            return q[0], v[0], ""
        missed = put_on_constraints(self.engine, np.array([t]), q, v, sizes_from(output.q, output.v))
        return q[0], v[0], str(missed)


def _with_cut(found: Sequence[Crossing], cut: Cut | None, end: float) -> list[Crossing]:
    """``found`` with the crossing that the step was shortened for moved to its end at ``end`` [s]."""
    if cut is None:
        return list(found)
    (_, located), result = cut, list(found)
    own = [crossing for crossing in result if crossing.index == located.index]
    if own:
        result.remove(own[-1])
    return [*result, replace(own[-1] if own else located, t=end)]


def failure_of(engine: Engine, plan: Plan, state: State, ended: int) -> Failure:
    """Failure for the step last tried from ``state``, which the loops left with code ``ended``."""
    numbers, by_error = engine.loops.section(mem.ATTEMPT), plan.by_error
    h, t = float(numbers[mem.H_TRIED]), state.t
    where = f"in the step from t = {exact(t)} with h = {h:g}"
    if ended == mem.NO_ADVANCE:
        text = f"t = {exact(t)} cannot be advanced by h = {h:g}; {Status.time_resolution.text}"
        return Failure(Status.time_resolution, text)
    if by_error is not None and ended in (mem.TOO_LARGE, mem.ROUNDOFF_REACHED):
        roundoff = ended == mem.ROUNDOFF_REACHED
        off = off_at_start(engine, state) if roundoff or by_times(by_error, t) else None
        return off or _too_large(by_error, state, numbers, roundoff)
    cause = engine.explain(state, float(numbers[mem.T_END])) if ended in (mem.NONFINITE, mem.SINGULAR) else None
    if ended == mem.NONFINITE or (cause is not None and cause.function != RESIDUAL):
        return Failure(Status.nonfinite_callback, f"{cause}, {where}")
    if ended == mem.SINGULAR:
        return Failure(Status.singular_iteration_matrix, f"the matrix of the step has a zero pivot, {where}")
    remedy = f"take a smaller step, or {JUMP}" if by_error is None else JUMP
    if leaping := int(numbers[mem.LEAPS]):
        remedy = f"q[{leaping - 1}] leaps to another position that the constraints allow; {remedy}"
    return Failure(Status.newton_failed, f"Newton's iteration did not converge, {where}; {remedy}")


def by_times(plan: ByError, t: float) -> bool:
    """True if the spacing of floating-point times at ``t`` [s], not ``min_step``, limits how short steps can be."""
    o = plan.options
    return o.min_step < o.spacings * float(np.spacing(abs(t)))


def off_at_start(engine: Engine, state: State) -> Failure | None:
    """Failure if ``state`` is a start whose constraint violation exceeds what the tolerances allow; else None."""
    if state.h is not None or not engine.structure.constrained:
        return None
    levels, place = of_dynamics(engine.dynamics).levels, PhasePoint(state.t, state.q, state.v)
    text = violations(levels.at(state.t, state.q, state.v), place, PROJECTED)
    if not text:
        return None
    message = f"the start violates {text}, which is more than these tolerances allow of a step's error"
    return Failure(Status.inconsistent_initial, f"{message}; {CORRECT}")


def _too_large(plan: ByError, before: State, numbers: np.ndarray, roundoff: bool) -> Failure:
    """Failure because the last step tried had an error above the tolerances."""
    t, h, error = before.t, abs(float(numbers[mem.H_TRIED])), float(numbers[mem.ERROR_SIZE])
    text = f"at t = {exact(t)} the error of a step of {h:.3g} s is {error:.3g} times what the tolerances allow"
    first = float(numbers[mem.FIRST_H])
    if roundoff and (remedy := plan.tolerances.reachable(before, first)):
        text += f", that of {abs(first):.3g} s was {numbers[mem.FIRST_ERROR]:.3g} times" if abs(first) != h else ""
        return Failure(Status.step_too_small, f"{text}: {remedy}")
    moved = h * max(before.size_v, h * float(np.abs(before.vdot).max()))
    nothing = moved <= SHORT * before.size_q  # steps become so short at a jump
    if by_times(plan, t) and not (roundoff or nothing):
        return Failure(Status.time_resolution, f"{text}; {Status.time_resolution.text}")
    return Failure(Status.step_too_small, f"{text}; {Status.step_too_small.text}")
