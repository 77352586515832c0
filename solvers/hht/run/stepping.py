"""Stepping by hand: where it stands, and one call of ``HHT.step``."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hhtbench.arguments import real_number
from hhtbench.errors import BudgetSpent, ProblemError
from hhtbench.result import Status
from solvers._start import Failure, Place
from solvers.hht.control.first_step import prepared
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.run.stepper import Accepted, EventState, Stepper
from solvers.hht.step.state import State

MAX_STEPS = 1_000_000  # under error control, unless max_num_steps says otherwise: every loop ends
METHODS = ("onestep", "normal")
HORIZON = 1.0  # [s]: where neither t nor tstop says how far to go, the first step is no longer


@dataclass(frozen=True, kw_only=True)
class IntegratorState:
    """Where stepping by hand stands: all that the next step depends on."""

    place: Place  #: where it began: it selects the engine
    state: State
    step: float | None  #: constant signed step [s]; None: error control
    tolerances: Tolerances | None  #: under error control
    watch: EventState
    last: HermiteOutput  #: the last step; one row before the first
    direction: float = 0.0  #: of time, 1 or -1; 0: not known before the first step
    distrusts: bool = False  #: whether the engine has given up the declared derivatives
    message: str = ""
    occurrences: tuple[Occurrence, ...] = ()  #: of the last call
    tally: Counter[str] = field(default_factory=Counter)  #: work since the start


@dataclass(frozen=True)
class Goal:
    """What one call of ``HHT.step`` is to do."""

    t: float | None
    normal: bool  #: step until ``t`` is reached or passed
    tstop: float | None


def begun(place: Place, state: State, step: float | None, tolerances: Tolerances | None, events: int) -> IntegratorState:
    """Before the first step."""
    return IntegratorState(
        place=place,
        state=state,
        step=step,
        tolerances=tolerances,
        watch=EventState(counts=(0,) * events),
        last=at_rest(state),
        direction=0.0 if step is None else math.copysign(1.0, step),
    )


def at_rest(state: State) -> HermiteOutput:
    """Dense output before any step: the state alone."""
    return HermiteOutput(np.array([state.t]), state.q[None], state.v[None])


def make_goal(t: Any, method: Any, tstop: Any, integrator: IntegratorState) -> Goal:
    """The arguments of ``HHT.step``, checked.

    Raises
    ------
    ProblemError, TypeError
        An unknown method, or a time that lies behind.
    """
    if method not in METHODS:
        raise ProblemError(f"method must be one of {', '.join(METHODS)}; got {method!r}.")
    if method == "normal" and t is None:
        raise ProblemError('method="normal" steps until t is reached; give t [s].')
    goal = Goal(
        None if t is None else real_number("t", t, unit=" [s]"),
        method == "normal",
        None if tstop is None else real_number("tstop", tstop, unit=" [s]"),
    )
    now, ahead = integrator.state.t, direction_to(goal, integrator)
    if goal.tstop is not None and (goal.tstop - now) * ahead <= 0:
        raise ProblemError(f"tstop must lie ahead of t = {now:.17g}; got {goal.tstop:.17g}. init_step begins anew.")
    if goal.t is not None and (goal.t - integrator.last.t[0]) * ahead < 0:
        raise ProblemError(f"t = {goal.t:.17g} lies behind the last step, which ended at {now:.17g}; init_step begins anew.")
    return goal


def direction_to(goal: Goal, integrator: IntegratorState) -> float:
    """Of time: the one in use, or towards what the first call names."""
    target = next((x for x in (goal.tstop, goal.t) if x is not None), math.inf)
    return integrator.direction or (-1.0 if target < integrator.state.t else 1.0)


def take(stepper: Stepper, integrator: IntegratorState, goal: Goal) -> tuple[IntegratorState, Status]:
    """One step, or steps until ``goal.t`` is reached; on a failure the steps before it count."""
    ahead = direction_to(goal, integrator)
    integrator = replace(integrator, direction=ahead, message="", occurrences=())
    for _ in range(MAX_STEPS):
        if goal.normal and (goal.t - integrator.state.t) * ahead <= 0:  # type: ignore[operator]
            return integrator, Status.success
        integrator, status = _one(stepper, integrator, goal)
        if status is not Status.success or not goal.normal or integrator.state.t == goal.tstop:
            return integrator, status
    return replace(integrator, message=Status.max_steps.text), Status.max_steps


def _one(stepper: Stepper, integrator: IntegratorState, goal: Goal) -> tuple[IntegratorState, Status]:
    state, engine, by_error = integrator.state, stepper.engine, stepper.plan.by_error
    if by_error is not None and state.memory is None:
        try:
            state = prepared(engine, state, by_error.tolerances, by_error.options, _horizon(integrator, goal))
        except BudgetSpent as spent:
            return replace(integrator, message=str(spent)), Status.deadline
    stop = integrator.direction * math.inf if goal.tstop is None else goal.tstop
    accepted = stepper.advance(state, integrator.watch, stop, np.zeros((1, engine.columns)))
    if accepted.failure is not None:
        return replace(integrator, message=accepted.failure.message), accepted.failure.status
    changed = stepper.changed(accepted)
    if isinstance(changed, Failure):
        return replace(integrator, message=changed.message), changed.status
    last_words = stepper.terminal(accepted)
    moved = replace(
        integrator,
        state=changed,
        watch=stepper.watch_after(accepted, changed),
        last=_output(state, accepted, changed),
        occurrences=integrator.occurrences + accepted.occurrences,
        message=last_words or "",
    )
    return moved, Status.event if last_words is not None else Status.success


def _horizon(integrator: IntegratorState, goal: Goal) -> float:
    """[s] which the first step, or the first after a change, does not pass.

    t counts at the start only: later on, where output is asked for changes no step.
    """
    t = goal.t if integrator.last.t.size == 1 else None
    return next((x for x in (goal.tstop, t) if x is not None), integrator.state.t + integrator.direction * HORIZON)


def _output(before: State, accepted: Accepted, after: State) -> HermiteOutput:
    """Dense output of one step, with the state after a change as its last row."""
    end = accepted.state
    step = HermiteOutput(np.array([before.t, end.t]), np.stack([before.q, end.q]), np.stack([before.v, end.v]))
    if after is end:
        return step
    return HermiteOutput(np.append(step.t, after.t), np.vstack([step.q, after.q]), np.vstack([step.v, after.v]))
