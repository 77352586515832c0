"""Stepping by hand: where it stands, and one call of ``HHT.step``."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hhtbench.arguments import Vector, real_number
from hhtbench.errors import ProblemError
from hhtbench.result import Status
from solvers._start import Failure, Place
from solvers.hht.control import no_advance
from solvers.hht.dense import HermiteOutput
from solvers.hht.engine import HostEngine
from solvers.hht.error import Tolerances
from solvers.hht.laws import representable
from solvers.hht.run import MAX_STEPS
from solvers.hht.state import State, Step
from solvers.hht.watch import Course, Occurrence, Passage, Watch, along

METHODS = ("onestep", "normal")
HORIZON = 1.0  # [s]: where neither t nor tstop says how far to go, the first step is no longer
CRUMB = 1e-9  # of a constant step: less than that before tstop is no step of its own


@dataclass(frozen=True, kw_only=True)
class Standing:
    """Where stepping by hand stands: all that the next step depends on."""

    place: Place  #: where it began: it selects the engine
    state: State
    step: float | None  #: constant signed step [s]; None: error control
    tolerances: Tolerances | None  #: under error control
    watch: Watch
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


@dataclass(frozen=True)
class Constant:
    """Steps of one length; the last before ``stop`` is cut to end there."""

    engine: HostEngine
    h: float  #: signed [s]

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Length and end [s] of the next step, (1,) each."""
        h, t1 = self._next(state, stop)
        return np.array([h]), np.array([t1])

    def made(self, count: int) -> None:
        """Nothing is kept of them."""

    def _next(self, state: State, stop: float) -> tuple[float, float]:
        h = representable(state.t, self.h)
        t1 = state.t + h
        if t1 != stop and (t1 - stop) * math.copysign(1.0, h) > -CRUMB * abs(h):
            return stop - state.t, stop
        return h, t1

    def __call__(self, state: State, stop: float) -> Step | Failure:
        """The next step."""
        h, t1 = self._next(state, stop)
        if state.t + h == state.t:
            return no_advance(state.t, h)
        self.engine.work.check_time()
        return self.engine.step(state, h, t1)


def begun(place: Place, state: State, step: float | None, tolerances: Tolerances | None, events: int) -> Standing:
    """Before the first step."""
    return Standing(
        place=place,
        state=state,
        step=step,
        tolerances=tolerances,
        watch=Watch(counts=(0,) * events),
        last=at_rest(state),
        direction=0.0 if step is None else math.copysign(1.0, step),
    )


def at_rest(state: State) -> HermiteOutput:
    """Dense output before any step: the state alone."""
    return HermiteOutput(np.array([state.t]), state.q[None], state.v[None])


def make_goal(t: Any, method: Any, tstop: Any, standing: Standing) -> Goal:
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
    now, ahead = standing.state.t, direction_to(goal, standing)
    if goal.tstop is not None and (goal.tstop - now) * ahead <= 0:
        raise ProblemError(f"tstop must lie ahead of t = {now:.17g}; got {goal.tstop:.17g}. init_step begins anew.")
    if goal.t is not None and (goal.t - standing.last.t[0]) * ahead < 0:
        raise ProblemError(f"t = {goal.t:.17g} lies behind the last step, which ended at {now:.17g}; init_step begins anew.")
    return goal


def direction_to(goal: Goal, standing: Standing) -> float:
    """Of time: the one in use, or towards what the first call names."""
    target = next((x for x in (goal.tstop, goal.t) if x is not None), math.inf)
    return standing.direction or (-1.0 if target < standing.state.t else 1.0)


def take(course: Course, standing: Standing, goal: Goal) -> tuple[Standing, Status]:
    """One step, or steps until ``goal.t`` is reached; on a failure the steps before it count."""
    ahead = direction_to(goal, standing)
    standing = replace(standing, direction=ahead, message="", occurrences=())
    for _ in range(MAX_STEPS):
        if goal.normal and (goal.t - standing.state.t) * ahead <= 0:  # type: ignore[operator]
            return standing, Status.success
        standing, status = _one(course, standing, goal)
        if status is not Status.success or not goal.normal or standing.state.t == goal.tstop:
            return standing, status
    return replace(standing, message=Status.max_steps.text), Status.max_steps


def _one(course: Course, standing: Standing, goal: Goal) -> tuple[Standing, Status]:
    state = standing.state
    if course.prepare is not None and state.memory is None:
        state = course.prepare(state, _horizon(standing, goal))
    stop = standing.direction * math.inf if goal.tstop is None else goal.tstop
    passage = course.next(state, standing.watch, stop)
    if isinstance(passage, Failure):
        return replace(standing, message=passage.message), passage.status
    changed = course.changed(passage)
    if isinstance(changed, Failure):
        return replace(standing, message=changed.message), changed.status
    course.engine.work.add("steps_accepted")
    last_words = course.terminal(passage)
    moved = replace(
        standing,
        state=changed,
        watch=course.watch_after(passage, changed),
        last=_output(state, passage, changed),
        occurrences=standing.occurrences + passage.occurrences,
        message=last_words or "",
    )
    return moved, Status.event if last_words is not None else Status.success


def _horizon(standing: Standing, goal: Goal) -> float:
    """[s] which the first step, or the first after a change, does not pass.

    t counts at the start only: later on, where output is asked for changes no step.
    """
    t = goal.t if standing.last.t.size == 1 else None
    return next((x for x in (goal.tstop, t) if x is not None), standing.state.t + standing.direction * HORIZON)


def _output(before: State, passage: Passage, after: State) -> HermiteOutput:
    """Dense output of one step, with the state after a change as its last row."""
    step = along(before, passage.step)
    if after is passage.step.state:
        return step
    return HermiteOutput(np.append(step.t, after.t), np.vstack([step.q, after.q]), np.vstack([step.v, after.v]))
