"""One call of ``HHT.solve``: start, steps, output rows, and the partial solution if something raises."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np

from hhtbench.lowering import padded
from hhtbench.protocol.arguments import check_interval, real_number, real_vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.counting import Clock, Work
from hhtbench.solution.request import ADDS_UP, Request, StepPlan, check_output_times, has_zero, plan_steps
from hhtbench.solution.result import Solution, Status
from hhtbench.solution.times import unresolved
from solvers._ending import OwnMultipliers, empty_solution, solution_of, unrecovered
from solvers._start import Failure, Guesses, PhasePoint
from solvers.hht.control.plan import ByError, Plan, Prescribed
from solvers.hht.control.tolerances import components, make_tolerances
from solvers.hht.run import engine_pool
from solvers.hht.run.causes import alternating_vibration, diagnosed, explained, unresolved_forces
from solvers.hht.run.crossing import Approach
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History, OutputRows
from solvers.hht.run.projecting import projection_of, put_on_constraints
from solvers.hht.run.rows import recovered
from solvers.hht.run.singular import LAST_ROWS, cause_of, ends_at, places_of
from solvers.hht.run.start import NOTHING
from solvers.hht.run.stepper import EventState, Stepper
from solvers.hht.run.stepping import MAX_STEPS
from solvers.hht.step.state import State
from solvers.kernel import memory as mem
from solvers.kernel.numbers import TINY

STAGES = "stage values (first order)"
IN_WORDS = {"every": STAGES, "rest": f"{STAGES} stand in the rest", "some": f"{STAGES} stand there"}
ARRIVED = Failure(Status.success, Status.success.text)
FIRST_CALL = 20  # steps of the first call of the loops, so that slow ones can be interrupted
FIRST_CALL_QUICK = 512  # steps of the first call where steps are quick
MAX_CALL = 65_536  # steps of one call
QUICK = 64  # unknowns up to which a step in machine code takes less than 0.1 ms: a call of FIRST_CALL costs as much
MAX_CROSSED, STEPS_PER_CROSSING = 10, 100  # singular positions crossed in a run: so many, and one more per so many steps
MAX_CALL_TIME = 0.05  # [s] of one call: budgets and the user's interrupt are checked between calls


class Integration:
    """One integration from ``place`` to ``t1`` [s] with the options of ``solver`` (an HHT)."""

    stepper: Stepper | None = None  #: None before the first state
    history: History

    def __init__(
        self,
        solver: Any,
        request: Request,
        steps: StepPlan | None,
        t1: float,
        place: PhasePoint,
        guesses: Guesses,
        clock: Clock,
    ) -> None:
        """Prepare the run; ``steps`` are those that ``request`` prescribes, None for error control."""
        self.solver, self.request, self.steps, self.t1 = solver, request, steps, t1
        self.place, self.guesses = place, guesses
        self.rtol = 0.0 if request.rtol is None else float(np.min(request.rtol))
        self.work = clock.work = Work(max_evaluations=request.max_evaluations, clock=clock)

    def solution(self) -> Solution:
        """Run the integration and return its Solution."""
        request, steps = self.request, self.steps
        h = self.t1 - self.place.t if steps is None else steps.length(0)
        how = {"controlled": steps is None, "calc_initcond": request.calc_initcond}
        started = self.solver.begin(self.place, self.guesses, h, self.work, **how)
        if isinstance(started, Failure):
            return self._nothing(started)
        engine, state, events = started.engine, started.state, self.solver.events
        start, asked = engine.loops.row(state), request.t_eval
        self.history = History(engine.structure, start, len(events), asked, every=request.keep_steps)
        if steps is None:
            tolerances = make_tolerances(request.rtol, request.atol, state, started.applied)
            plan: Plan = ByError(tolerances, self.solver.options.control)
        else:
            plan = Prescribed(steps)
        self.stepper = Stepper(engine=engine, plan=plan, events=events)
        end = integrate(self.stepper, state, self.t1, self.history, request.max_num_steps)
        engine.raise_left_over()
        note = f"{started.note} {self._warnings(plan, state.size_q)}".strip()
        solution = self._assembled(self.stepper, self._checked(end), note)
        engine_pool.put_back(started.purpose, engine)
        return solution

    def left_over(self, end: Failure) -> Solution:
        """Solution of the steps accepted before an exception; calls no function of the system."""
        if self.stepper is None:
            return self._nothing(end)
        rows, _ = self.history.output_rows(lambda: False)
        return unrecovered(self.stepper.engine, end, (rows.t, rows.q, rows.v), own_multipliers(rows), **self.history.kept())

    def _assembled(self, stepper: Stepper, end: Failure, note: str) -> Solution:
        """The Solution at the output times (or at every step) that were reached, with recovered multipliers."""
        engine = stepper.engine
        self.work.only_output_is_left()
        rows, asked = self.history.output_rows(lambda: self.work.clock.left() < 0.0)
        missed, own, carried = self._put_on_constraints(engine, rows), own_multipliers(rows), None
        if self.request.t_eval is None and engine.structure.constrained:
            carried = dict(zip(("lam", "mu"), padded(engine.dynamics, own.lam.copy(), own.mu.copy()), strict=True))
        note = " ".join(filter(None, (missed, *self.history.notes(), note)))
        if rows.t.size < asked:
            note = f"The time budget ended when {rows.t.size} of {asked} rows were interpolated; no more follow. {note}"
            end = replace(end, status=Status.deadline) if end.status is Status.success else end
        more = self.history.kept(projection_of(engine)) | self._diagnosis(end)
        motion, recover_many = (rows.t, rows.q, rows.v), lambda: recovered(engine, rows)
        return solution_of(engine, end, motion, own, recover_many, note, carried=carried, **more)

    def _warnings(self, plan: Plan, at_start: float) -> str:
        """Warning if prescribed steps do not resolve the forces, or ``atol`` exceeds max|q|, initially ``at_start``."""
        if plan.by_error is None:
            forced = self.history.forced()
            return unresolved_forces(*forced) or alternating_vibration(*forced[1:4])[0]
        if plan.by_error.tolerances.least <= at_start:
            return ""
        return str(plan.by_error.tolerances.warn(float(self.history.sizes()[: self.place.q.size].max())))

    def _diagnosis(self, end: Failure) -> dict[str, Any]:
        """Field ``diagnosis_of`` of a failed Solution: what :meth:`~hhtbench.Solution.diagnose` calls."""
        if self.stepper is None or end.status in (Status.success, Status.event):
            return {}
        t, q, v = (x[-1] for x in self.history.last(1))
        h = float(self.stepper.engine.loops.section(mem.ATTEMPT)[mem.H_TRIED])
        place, (of_q, of_v) = PhasePoint(float(t[0]), q.copy(), v.copy()), np.split(self.history.sizes(), 2)
        by_error, rate = self.stepper.plan.by_error, float(of_v.max() / max(of_q.max(), TINY))
        known = {"finest": 0.0 if by_error is None else by_error.tolerances.finest, "rate": rate}
        return {"diagnosis_of": partial(diagnosed, self.solver.system, self.solver.options, end.status, place, h, **known)}

    def _put_on_constraints(self, engine: Engine, rows: OutputRows) -> str:
        """Project rows between steps onto both constraint levels, (H47); returns a warning where that failed, or ""."""
        which = rows.between
        if which is None or not np.count_nonzero(which):  # in a fifth of the time of any()
            return ""
        q, v = rows.q[which], rows.v[which]
        missed = put_on_constraints(engine, rows.t[which], q, v, self.history.sizes())
        rows.q[which], rows.v[which] = q, v
        return str(missed)

    def _checked(self, end: Failure) -> Failure:
        """``end``, turned into a failure if times do not resolve the steps or prescribed steps were unstable."""
        if end.status not in (Status.success, Status.event):
            return end
        made, elapsed = self.history.steps
        coarse = unresolved(self.history.span, made, ADDS_UP if self.request.rtol is None else self.rtol, elapsed)
        if coarse:
            return Failure(Status.time_resolution, coarse)
        text, grown = ("", False) if self.steps is None else alternating_vibration(*self.history.forced()[1:4])
        return Failure(Status.unreliable, text) if grown else end

    def _nothing(self, failure: Failure) -> Solution:
        n = self.place.q.size
        count, rows = len(self.solver.events), np.zeros((0, n))
        empty = empty_solution(n, failure, self.work.counters())
        return replace(empty, t_events=(np.zeros(0),) * count, q_events=(rows,) * count, v_events=(rows,) * count)


def integrate(stepper: Stepper, state: State, stop: float, history: History, max_num_steps: int | None) -> Failure:
    """Take steps until ``stop`` [s], a terminal event, a failure or a budget; append accepted steps to ``history``.

    Under error control ``max_num_steps=None`` means ``MAX_STEPS``.  Where the run ends at that limit or a step fails, the
    message names a cause if one is found.  Returns how the run ended.
    """
    most = max_num_steps or (MAX_STEPS if stepper.plan.by_error else None)
    watch, taken, clock = EventState((0,) * len(stepper.events)), 0, stepper.engine.work.clock
    crossed, stepping = 0, 0.0
    count = FIRST_CALL_QUICK if clock.limit is None and is_quick(stepper.engine) else FIRST_CALL
    while state.t != stop:
        if most is not None and taken >= most:
            text = f"{taken} steps were taken and t = {exact(state.t)} reached; {Status.max_steps.text}"
            ended = Failure(Status.max_steps, text)
            by_error = stepper.plan.by_error
            if max_num_steps or by_error is None:
                return ended
            return explained(stepper.engine, ended, state, state.h or 0.0, by_error.tolerances.finest)
        room = count if most is None else min(count, most - taken)
        began = time.perf_counter()
        accepted = stepper.advance(state, watch, stop, history.room(room))
        taken += accepted.made
        history.commit(accepted.made)
        taking = time.perf_counter() - began
        stepping += taking
        clock.kept_back = history.handing_over(stepping)
        each = taking / max(accepted.made, 1)
        count = int(min(8 * count, MAX_CALL, max(min(MAX_CALL_TIME, clock.left()) / each, 1.0)))
        history.note(accepted.occurrences)
        after = stepper.after_events(accepted)
        if after.state is not accepted.state:
            history.restart(stepper.engine.loops.row(after.state))
        state, watch = after.state, after.watch
        if after.ended is not None:
            beyond = go_beyond(
                stepper, after.ended, state, stop, history, often=crossed > MAX_CROSSED + taken / STEPS_PER_CROSSING
            )
            if isinstance(beyond, Failure):
                return beyond
            state, taken, crossed = beyond, taken + 1, crossed + 1
    return ARRIVED


def is_quick(engine: Engine) -> bool:
    """True if a step takes less time than the call of the compiled loops around it."""
    return engine.functions.alone and not engine.plain and engine.layout.size <= QUICK


def go_beyond(
    stepper: Stepper, ended: Failure, state: State, stop: float, history: History, *, often: bool
) -> State | Failure:
    """Step across the singular position that ended the run at ``state``; returns the state behind it, or the failure.

    ``often``: the run has crossed so many already that it is ended here.
    """
    engine, by_error, places = stepper.engine, stepper.plan.by_error, places_of(*history.last(LAST_ROWS))
    position = cause_of(engine, ended, places)
    if isinstance(position, Failure):
        tried = float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED])
        return position if by_error is None else explained(engine, position, state, tried, by_error.tolerances.finest)
    if by_error is None:
        return ends_at(position, "the steps are prescribed")
    if stepper.events:
        return ends_at(position, "events would not be seen there")
    if often:
        return ends_at(
            position,
            f"the run has stepped over {MAX_CROSSED} and more already, one every {STEPS_PER_CROSSING} steps or less",
        )
    found = Approach(engine, by_error.tolerances, position, places, state, stop).crossing()
    if isinstance(found, str):
        return ends_at(position, found)
    row = engine.loops.row(found.state)
    row[1] = found.h
    place = f", in the place of the last {found.steps}" if found.steps else ""
    history.replace_last(found.steps, row, f"At t = {position.t:.10g} s a step across a singular position was made{place}.")
    engine.work.add("steps_accepted", 1 - found.steps)
    return found.state


def own_multipliers(rows: OutputRows) -> OwnMultipliers:
    """Multipliers stored by the steps: lam1 (k, m), and mu (k, p) of the step's midpoint."""
    return OwnMultipliers(rows.lam, rows.mu, (NOTHING, NOTHING), **IN_WORDS)


def end_times(tspan: Any) -> tuple[float, float]:
    """Parse ``tspan`` into its two times [s]."""
    if not isinstance(tspan, (tuple, list, np.ndarray)) and isinstance(tspan, jax.Array):
        tspan = real_vector("tspan", tspan)
    if not isinstance(tspan, (tuple, list, np.ndarray)) or len(tspan) != 2:
        raise ProblemError(f"tspan must be two times (t0, t1) [s]; got {tspan!r}.")
    return real_number("tspan[0]", tspan[0], unit=" [s]"), real_number("tspan[1]", tspan[1], unit=" [s]")


def planned(request: Request, n: int, t0: float, t1: float) -> StepPlan | None:
    """Prescribed steps of ``request`` (None under error control), checked against ``n`` coordinates and [t0, t1] [s]."""
    if request.options:
        raise TypeError(f"HHT takes its options when it is made: HHT(system, alpha=...); got options={request.options}.")
    check_accuracy(request, n)
    if request.t_eval is not None:
        check_output_times(request.t_eval, t0, t1)
    check_interval("tspan", t0, t1)
    return plan_steps(request, t0, t1) if request.fixed else None


def check_accuracy(request: Request, n: int) -> None:
    """Check that the tolerances of ``request``, if given, fit a system with ``n`` coordinates.

    Raises
    ------
    ProblemError
        A tolerance has the wrong shape, or both are zero.
    """
    if request.atol is None and request.rtol is not None and has_zero(request.rtol):
        raise ProblemError("rtol = 0 leaves no tolerance; give atol too.")
    for name, value in (("rtol", request.rtol), ("atol", request.atol)):
        if value is not None and type(value) is not float:
            components(name, value, n)
