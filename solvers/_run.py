"""One solve by a foreign library: equations as guarded callbacks, accepted steps, and how the run ended."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector, all_finite
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Clock
from hhtbench.solution.request import Request, check_output_times
from hhtbench.solution.result import Ends, Solution, Status
from hhtbench.solution.times import unresolved
from solvers import forms
from solvers._dense import Kept, OnConstraints, Pieces
from solvers._ending import OwnMultipliers, empty_solution, solution_of, unrecovered
from solvers._finite import explain_nonfinite
from solvers._guard import Guard, Halt, LibraryWork
from solvers._start import Failure, PhasePoint, absolute_tolerances, budget_failure, of_dynamics, plain_start, tried_twice

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.kkt import AccelerationLevel
    from solvers._start import Begun

__all__ = ["Halt", "Run"]

SAME_ROOT = 1e-6  # relative difference of v' below which two roots of (F9) are the same
OTHER_ROOT = (
    "the form ode begins Newton's iteration for the multipliers without any, and finds others than those of the start, "
    "which lam_guess picks; take one of the dae forms"
)
Interpolate = Callable[[float], Any]  # time within the last step [s] -> y, or y' (size,)


class Run:
    """One solve: the equations as guarded callbacks (:class:`~solvers._guard.Guard`), and the rows that were reached.

    The library's clock starts at 0: far from the origin of time it would take steps other than its times show, or take the
    end as reached at once.  Values passed to and from the library, :attr:`t` and :attr:`wanted` are in that time;
    :meth:`time` converts to the problem's.
    """

    def __init__(self, name: str, problem: Problem, request: Request, form: str, clock: Clock) -> None:
        self.name, self.problem, self.request = name, problem, request
        self.t0, self.t1 = 0.0, problem.t_span[1] - problem.t_span[0]
        #: output times [s]; None: every step
        self.wanted = None if request.t_eval is None else request.t_eval - problem.t_span[0]
        self.direction = -1.0 if self.t1 < self.t0 else 1.0
        self.work = clock.work = LibraryWork(max_evaluations=request.max_evaluations, clock=clock)
        self.form_name = form
        self.t = self.t0
        self.y: Any = None  #: (size,) at t
        self.steps = 0
        self.note = ""  #: sentence added to the message of the solution
        self.guard = Guard(self.work, problem.t_span)
        self.pieces: Pieces | None = None  #: dense output, where it was asked for
        self._keeps_ends = request.t_eval is None or request.keep_steps

    def solution(self, drive: Callable[[Run], None]) -> Solution:
        """Run the library by ``drive`` and return the Solution."""
        if self.request.t_eval is not None:
            check_output_times(self.request.t_eval, *self.problem.t_span)
        failure = tried_twice(self._begin, self.work, self.now)
        if failure is not None:
            return self._nothing(failure)
        end = self._arrived(
            self._end(self._raised(drive))
        )  # held by no frame of its own traceback, so that the run is freed at once
        self.work.only_output_is_left()
        end = Failure(end.status, f"{end.message} {self.note}".strip())
        more: dict[str, Any] = {"ends": self._kept_ends(), "carried": self._rows.carried(self.dynamics)}
        if self.pieces is not None and self.steps:
            from solvers._projection import OneByOne  # runs without dense output do without it

            put = OneByOne(self.dynamics).project_all
            more["projection"] = OnConstraints(self.dynamics, put, self.pieces, held=False)
            more["interpolant"] = self.pieces
        return solution_of(self, end, self._rows.motion, self._own_multipliers(), **more)

    def left_over(self, end: Failure) -> Solution:
        """Solution of the steps accepted before an exception; calls no function of the system."""
        if not hasattr(self, "start"):
            return self._nothing(end)
        carried = self._rows.carried(self.dynamics)
        return unrecovered(self, end, self._rows.motion, self._own_multipliers(), carried=carried)

    @property
    def _rows(self) -> Kept:
        """Output rows so far: those at ``t_eval``, or at every step."""
        return self._ends if self.wanted is None else self._asked

    def _own_multipliers(self) -> OwnMultipliers:
        """The library's own multipliers of the rows, NaN where its form has none."""
        s, k, every = self.dynamics.structure, len(self._rows.times), "those of the form, NaN where it has none"
        lam, mu = self._rows.multipliers(s.m) or (np.full((k, s.m), np.nan), np.full((k, s.p), np.nan))
        some = "the values of the form or of the row before stand there"
        return OwnMultipliers(lam, mu, (self.first.lam, self.first.mu), every, f"the rest are {every}", some)

    def _nothing(self, failure: Failure) -> Solution:
        return empty_solution(self.problem.q0.size, failure, self.work.counters())

    def time(self, t: float) -> float:
        """The problem's time [s] at ``t`` of the library's clock."""
        return self.guard.time(t)

    @property
    def now(self) -> float:
        """The problem's time [s] at the end of the last step."""
        return self.time(self.t)

    # --- the start -------------------------------------------------------------------------------------------------

    def _begin(self) -> Failure | None:
        problem = self.problem
        place, guesses = PhasePoint(self.now, problem.q0, problem.v0), (problem.lam_guess, problem.mu_guess)
        self.atol = absolute_tolerances(problem, self.request)
        moves = self.request.calc_initcond
        start: Begun | Failure | None = None if moves else plain_start(problem.system, place, guesses, self.work)
        if start is None:
            from solvers._initcond import begun  # most starts of machine code are plainly good

            start = begun(problem.system, place, guesses, self.work, calc_initcond=moves)
        if isinstance(start, Failure):
            return start
        self.dynamics, place, self.first, self.note = start
        self.form = form = forms.make_form(self.form_name, self.dynamics)
        self._asked, self._ends = Kept(form), Kept(form)  # rows at t_eval, and ends of steps
        self.start = form.start(place.q, place.v, self.first.vdot, self.first.lam, self.first.mu)
        self.rtol, self.weights = float(self.request.rtol or 0.0), form.error_weights(self.atol)
        vector = (form.size,)
        matrix = (form.size, form.size) if form.pattern is None else (form.pattern.rows.size,)
        self.residual = self.guard.wrap(form.residual, vector, residuals=form.points)
        self.jacobian = self.guard.wrap(form.jacobian, matrix, jacobians=1)
        self.rhs = self.guard.wrap(form.rhs, vector, residuals=form.points)
        self.rhs_jacobian = self.guard.wrap(form.rhs_jacobian, matrix, jacobians=1)
        if not self._same_root():
            return Failure(Status.newton_failed, OTHER_ROOT)
        self.y = self.start.y
        self._output(self.t0, self.y, None, lambda _: self.start.yp)
        if self.request.dense_output:
            self.pieces = Pieces(np.array(self.y), (form.blocks["q"], form.blocks["v"]), self.now)
        return None

    def _same_root(self) -> bool:
        """True if the underlying ODE finds the multipliers of the start; where (F9) has several roots it may find others."""
        if self.form.kind != "ode" or self.dynamics.structure.linear_reaction:
            return True
        vdot, found = self.first.vdot, self.rhs(self.t0, self.start.y)[self.first.vdot.size :]
        return bool(np.max(np.abs(found - vdot)) <= SAME_ROOT * max(1.0, float(np.max(np.abs(vdot)))))

    @property
    def acceleration(self) -> AccelerationLevel:
        """Solver of the acceleration level of the equations in use."""
        return of_dynamics(self.dynamics).acceleration

    def tells_no_steps(self) -> None:
        """Declare that ends of steps are not kept: the library's loop gives rows only, or ends steps at output times."""
        self._keeps_ends = self.wanted is None

    # --- the steps -------------------------------------------------------------------------------------------------

    def unfinished(self) -> bool:
        """True until the end is reached; raises if a budget is spent or a callback has raised inside compiled code."""
        if self.guard.cause is not None:
            raise self.guard.cause
        if self.t == self.t1:
            return False
        most = self.request.max_num_steps
        if most is not None and self.steps >= most:
            raise Halt(
                Status.max_steps, f"{most} steps were taken and t = {exact(self.now)} reached; {Status.max_steps.text}"
            )
        self.work.check_time()
        return True

    def accept(self, t: float, y: Any, between: Interpolate, rate: Interpolate | None = None, dense: Any = None) -> None:
        """Record one accepted step ending at (t, y); ``between`` interpolates y inside it, ``rate`` y' up to its end.

        ``dense()`` makes the library's own interpolant of the step, to be kept.
        """
        t, y = float(t), np.array(y, dtype=np.float64)
        self._expect_good(t, y)
        self._output(t, y, between, rate)
        if self.pieces is not None and dense is not None:
            with self.work.for_output():
                self.pieces.append(t, self.time(t), y, dense())
        self._arrive(1, t, y)

    def accept_many(self, steps: int, t: float, y: Vector, rows: Matrix) -> None:
        """Record ``steps`` accepted steps, the last ending at (t, y), and the ``rows`` [t, y] that they reached."""
        if steps:
            self._expect_good(t, y)
        keep = self._keep_end if self.wanted is None else self._keep_asked
        for time, row in zip(rows[:, 0].tolist(), rows[:, 1:], strict=True):
            keep(time, row, None)
        if steps:
            self._arrive(steps, t, y.copy())

    def _expect_good(self, t: float, y: Vector) -> None:
        """Raise :class:`Halt` if steps reported as good do not advance time or end at a state that is not finite."""
        if not self.direction * self.t < self.direction * t:
            raise Halt(Status.step_too_small, f"A step did not advance t = {exact(self.now)}. {Status.step_too_small.text}")
        if not all_finite(y):
            text = f"the step to t = {exact(self.time(t))} was reported as good but its state is not finite"
            raise Halt(Status.unreliable, text)

    def _arrive(self, steps: int, t: float, y: Vector) -> None:
        """Move the run's position to (t, y) after so many more ``steps``."""
        self.t, self.y = t, y
        self.guard.step_taken()
        self.steps += steps
        self.work.add("steps_accepted", steps)

    def _output(self, t: float, y: Vector, between: Interpolate | None, rate: Interpolate | None) -> None:
        """Keep the rows reached by this step: its end, or the output times within it."""
        if self._keeps_ends:
            self._keep_end(t, y, rate)
        if self.wanted is None:
            return
        rest = self.wanted[len(self._asked.times) :]
        for time in rest[: np.searchsorted(self.direction * rest, self.direction * t, "right")].tolist():
            self.work.check_time()
            with self.work.for_output():
                self._keep_asked(time, y if time == t or between is None else between(time), rate)

    def _keep_end(self, t: float, y: Vector, rate: Interpolate | None) -> None:
        """Keep the row at a step's end; of two rows whose times round to one, the first is kept, but at t1 the last."""
        if self._ends.times and self.time(t) == self._ends.times[-1]:
            if t != self.t1:
                return
            self._ends.drop_last()
        self._ends.keep(self.time(t), y, partial(rate, t) if rate else None)

    def _keep_asked(self, time: float, y: Any, rate: Interpolate | None) -> None:
        """Keep the row at the next time of ``t_eval``, which is ``time`` on the library's clock."""
        asked: Any = self.request.t_eval
        self._asked.keep(float(asked[len(self._asked.times)]), y, partial(rate, time) if rate else None)

    # --- the end ---------------------------------------------------------------------------------------------------

    def _raised(self, drive: Callable[[Run], None]) -> BaseException | None:
        """Run ``drive``; returns the exception that ended it (a callback's own, if one raised), or None at the end."""
        try:
            drive(self)
        except Exception as raised:  # noqa: BLE001 - a library may raise anything; it costs this solve only
            return raised if self.guard.cause is None else self.guard.cause
        return self.guard.cause

    def _end(self, error: BaseException | None) -> Failure:
        """How the run ended; an exception of a callback is raised again unchanged."""
        if error is None:
            return Failure(Status.success, Status.success.text)
        if isinstance(error, BudgetSpent):
            return budget_failure(error, self.now)
        if isinstance(error, Halt):
            end = Failure(error.status, str(error))
        elif error is self.guard.cause:
            raise error
        else:
            message = f"the library raised {type(error).__name__} after t = {exact(self.now)}: {error}"
            end = Failure(Status.unreliable, message)
        blamed = self.guard.blamed
        return end if blamed is None or end.status is Status.max_steps else self._explained(end, blamed)

    def _arrived(self, end: Failure) -> Failure:
        """``end``, turned into a failure if the library stopped early or times do not resolve its steps."""
        if end.status is not Status.success:
            return end
        if self.t != self.t1:
            text = (
                f"end: It stopped at t = {exact(self.now)} and not at {exact(self.time(self.t1))}. {Status.unreliable.text}"
            )
            return Failure(Status.unreliable, text)
        coarse = unresolved(self.problem.t_span, self.steps, self.rtol, self.t - self.t0)
        return Failure(Status.time_resolution, coarse) if coarse else end

    def _explained(self, end: Failure, found: Any) -> Failure:
        """Failure ``nonfinite_callback`` that names the function by ``found``, the error or the (t, y) where to look."""
        if not isinstance(found, NonFiniteValue):
            t, y = found
            try:
                explain_nonfinite(self.dynamics, t, *self.form.state(y), f"the form {self.form_name}")
            except NonFiniteValue as named:
                found = named
        return Failure(Status.nonfinite_callback, f"{found}; {self.name}: {end.message}")

    def _kept_ends(self) -> Ends | None:
        """Ends of the steps, if they are kept in addition to the rows at ``t_eval``."""
        if not (self.request.keep_steps and self._keeps_ends):
            return None
        t, q, v = self._ends.motion
        return Ends(t=t, q=q, v=v, carried=self._ends.carried(self.dynamics))
