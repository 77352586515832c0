"""Stepping by hand: its state, and one call of ``HHT.step``."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers._start import Failure, PhasePoint
from solvers.hht.control.controller import ControlOptions
from solvers.hht.control.plan import ByError, Constant, Plan
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.formulas import representable
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.run.causes import explained
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import row_layout
from solvers.hht.run.march import march
from solvers.hht.run.singular import cause_of, ends_at, places_of
from solvers.hht.run.stepper import Accepted, EventState, Stepper
from solvers.hht.step.state import State
from solvers.kernel import memory as mem
from solvers.kernel.memory import Memory, integer_view, view

MAX_STEPS = 1_000_000  # under error control, unless max_num_steps says otherwise: every loop ends
METHODS = ("onestep", "normal")
MAX_COPIED = 20_000  # numbers of the loops' memory that are copied faster than a State is built
HORIZON = 1.0  # [s] bound on the first step where neither t nor tstop is given


@dataclass(frozen=True, kw_only=True)
class IntegratorState:
    """State of stepping by hand: all that the next step depends on."""

    place: PhasePoint  #: initial point; selects the engine
    state: State
    step: float | None  #: constant signed step [s]; None: error control
    tolerances: Tolerances | None  #: under error control
    watch: EventState
    last: HermiteOutput  #: the last step; one row before the first
    direction: float = 0.0  #: direction of time, 1 or -1; 0: not known before the first step
    fell_back: bool = False  #: whether the engine has replaced the declared derivatives
    message: str = ""
    occurrences: tuple[Occurrence, ...] = ()  #: events of the last call
    tally: Counter[str] = field(default_factory=Counter)  #: work since the start
    output: Counter[str] = field(default_factory=Counter)  #: part of it spent on states at events


@dataclass(frozen=True)
class Goal:
    """Checked arguments of one call of ``HHT.step``."""

    t: float | None
    normal: bool  #: step until ``t`` is reached or passed
    tstop: float | None
    ahead: float  #: direction of time, 1 or -1


def begun(
    place: PhasePoint, state: State, step: float | None, tolerances: Tolerances | None, events: int
) -> IntegratorState:
    """The integrator state before the first step."""
    return IntegratorState(
        place=place,
        state=state,
        step=step,
        tolerances=tolerances,
        watch=EventState(counts=(0,) * events),
        last=HermiteOutput(np.array([state.t]), state.q[None], state.v[None]),
        direction=0.0 if step is None else math.copysign(1.0, step),
    )


def stepper_of(engine: Engine, integrator: IntegratorState, options: ControlOptions, events: tuple[Event, ...]) -> Stepper:
    """The stepper that continues ``integrator``."""
    plan: Plan = Constant(integrator.step or 0.0)
    if integrator.tolerances is not None:
        plan = ByError(integrator.tolerances, options)
    return Stepper(engine=engine, plan=plan, events=events)


def make_goal(t: Any, method: Any, tstop: Any, integrator: IntegratorState) -> Goal:
    """Check the arguments of ``HHT.step``.

    Raises
    ------
    ProblemError, TypeError
        An unknown method, or a time that lies behind.
    """
    if method not in METHODS:
        raise ProblemError(f"method must be one of {', '.join(METHODS)}; got {method!r}.")
    if method == "normal" and t is None:
        raise ProblemError('method="normal" steps until t is reached; give t [s].')
    t = None if t is None else real_number("t", t, unit=" [s]")
    tstop = None if tstop is None else real_number("tstop", tstop, unit=" [s]")
    now, target = integrator.state.t, next((x for x in (tstop, t) if x is not None), math.inf)
    ahead = integrator.direction or (-1.0 if target < now else 1.0)
    if tstop is not None and (tstop - now) * ahead <= 0:
        raise ProblemError(f"tstop must lie ahead of t = {exact(now)}; got {exact(tstop)}. init_step begins anew.")
    if t is not None and (t - integrator.last.t[0]) * ahead < 0:
        raise ProblemError(f"t = {exact(t)} lies behind the last step, which ended at {exact(now)}; init_step begins anew.")
    return Goal(t, method == "normal", tstop, ahead)


def take(stepper: Stepper, integrator: IntegratorState, goal: Goal) -> tuple[IntegratorState, Status]:
    """Take one step, or steps until ``goal.t`` is reached; on a failure the steps before it are kept."""
    integrator = replace(integrator, direction=goal.ahead, message="", occurrences=())
    for _ in range(MAX_STEPS):
        if goal.normal and (goal.t - integrator.state.t) * goal.ahead <= 0:  # type: ignore[operator]
            return integrator, Status.success
        integrator, status = _one(stepper, integrator, goal)
        if status is not Status.success or not goal.normal or integrator.state.t == goal.tstop:
            return integrator, status
    return replace(integrator, message=Status.max_steps.text), Status.max_steps


def _one(stepper: Stepper, integrator: IntegratorState, goal: Goal) -> tuple[IntegratorState, Status]:
    before, stop = integrator.state, goal.ahead * math.inf if goal.tstop is None else goal.tstop
    rows = np.zeros((1, row_layout(stepper.engine.structure).columns))
    accepted = stepper.advance(before, integrator.watch, stop, rows, _horizon(integrator, goal))
    after = stepper.after_events(accepted)
    status, message = (Status.success, "") if after.ended is None else (after.ended.status, after.ended.message)
    if after.ended is not None and status is not Status.event:
        ended = _with_cause(stepper.engine, after.ended, before, integrator)
        return replace(integrator, message=ended.message), ended.status
    moved = replace(
        integrator,
        state=after.state,
        watch=after.watch,
        last=_output(before, accepted, after.state),
        occurrences=integrator.occurrences + accepted.occurrences,
        message=message,
    )
    return moved, status


def _with_cause(engine: Engine, ended: Failure, state: State, integrator: IntegratorState) -> Failure:
    """``ended`` with its cause, if that is found."""
    last, tolerances = integrator.last, integrator.tolerances
    position = cause_of(engine, ended, places_of(last.t[:, None], last.q, last.v))
    if not isinstance(position, Failure):
        return ends_at(position, "steps are made one by one")
    tried = float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED])
    return explained(engine, position, state, tried, 0.0 if tolerances is None else tolerances.finest)


def _horizon(integrator: IntegratorState, goal: Goal) -> float:
    """Time [s] that the first step, or the first after a change of state, does not pass.

    t is used at the start only; later, output times change no step.
    """
    t = goal.t if integrator.last.t.size == 1 else None
    return next((x for x in (goal.tstop, t) if x is not None), integrator.state.t + goal.ahead * HORIZON)


def _output(before: State, accepted: Accepted, after: State) -> HermiteOutput:
    """Dense output of one step, with the state after a change as last row, or that alone if no step was made."""
    rows: tuple[State, ...] = (before, accepted.state, after) if accepted.made else (after,)
    rows = rows[:2] if after is accepted.state else rows
    return HermiteOutput(*(np.array([getattr(row, name) for row in rows]) for name in ("t", "q", "v")))


def onward(stepper: Stepper, integrator: IntegratorState) -> Onward | None:
    """Fast stepping inside the loops, or None where each step must return to Python.

    It must in a first step, with events, functions in Python, or a state that is not the one in the loops' memory, for large
    systems, and at tolerances near roundoff.
    """
    engine, plan, state = stepper.engine, stepper.plan, integrator.state
    if stepper.events or state.h is None or engine.loops.held is not state or engine.loops.call_python:
        return None
    if plan.by_error is not None and (not state.controlled or not plan.by_error.tolerances.above_roundoff):
        return None
    return Onward(engine, plan, integrator.direction) if engine.loops.z.w.size <= MAX_COPIED else None


class Onward:
    """Steps by the loops alone, from the state in their memory, which becomes a State only when it is read.

    For machine code that calls no Python, without events: building a State and the next step's arguments takes twenty
    times as long as the step of a pendulum.
    """

    def __init__(self, engine: Engine, plan: Plan, direction: float) -> None:
        self._loops, self._work, self._plan = engine.loops, engine.work, plan
        z, self._row = engine.loops.z, np.zeros((1, row_layout(engine.structure).columns))
        self._length, self._end = np.zeros(1), np.zeros(1)
        self._counts = integer_view(z, mem.COUNTED)  # counts since the last State
        stop = math.copysign(math.inf, direction)
        self._call = march.following(z, engine.control, stop, self._length, self._end, self._row)
        self._number, self._all = engine.loops.section(mem.NUMBER), (z.w, z.i)
        self._starts = [
            tuple(array.copy() for array in self._all) for _ in range(2)
        ]  # copies of the memory before the last two steps
        engine.loops.ready(controlled=plan.by_error is not None, fallback=engine.fallible)

    def goes_on(self, integrator: IntegratorState) -> bool:
        """True if the memory holds the state of ``integrator``, or one that followed from it."""
        return self._made() > 0 or self._loops.held is integrator.state

    def _made(self) -> int:
        """Number of steps since the last State; a step followed by an interrupt counts."""
        return int(self._counts[mem.ACCEPTED])

    def step(self) -> bool:
        """Take a step; True if it was accepted, else the memory is as before."""
        if isinstance(self._plan, Constant):
            t = float(self._number[mem.T])
            h = representable(t, self._plan.h)
            self._length[0], self._end[0] = h, t + h
        now = self._starts[self._counts[mem.ACCEPTED] % 2]
        for saved, array in zip(now, self._all, strict=True):
            np.copyto(saved, array)
        if self._call():
            self._loops.raise_noted()
            return True
        for saved, array in zip(now, self._all, strict=True):
            np.copyto(array, saved)
        return False

    def settled(self, integrator: IntegratorState) -> IntegratorState:
        """``integrator`` advanced by the steps made since the last State, with their work counted."""
        if not self._made():
            return integrator
        before = Memory(*self._starts[(self._made() - 1) % 2])
        self._loops.count()
        state = self._loops.store(controlled=self._plan.by_error is not None)
        start = float(view(before, mem.NUMBER)[mem.T]), view(before, mem.Q).copy(), view(before, mem.V).copy()
        rows = (np.array(pair) for pair in zip(start, (state.t, state.q, state.v), strict=True))
        return replace(integrator, state=state, last=HermiteOutput(*rows), message="", occurrences=())
