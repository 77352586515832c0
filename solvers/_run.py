"""One solve by a foreign library: the equations as guarded callbacks, the accepted steps, the final check."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue, ProblemError, Stop
from hhtbench.lowering import AccelerationLevel, ConstraintLevels
from hhtbench.protocol import Problem
from hhtbench.request import Request, check_output_times
from hhtbench.result import Counters, Solution, Status
from solvers import forms
from solvers._start import (
    Failure,
    Place,
    acceleration_at,
    budget_failure,
    check_guesses,
    counted_dynamics,
    dynamics_for,
    empty_solution,
    explain_nonfinite,
    inconsistency,
    start_acceleration,
    undetermined,
)

MOST_STRAYS = 100  # values that are not finite within one step: a library shrinks its step tenfold long before
BELIEVABLE = 0.05  # constraint violation in units of the typical size: beyond it the rows show another mechanism
CHECKED_ROWS = 200  # rows looked at by that check, the last one included: more would cost more than the steps
Interpolate = Callable[[float], Any]  # time within the last step [s] -> y (size,)


class Halt(Stop):
    """The integration ends here; never seen by the caller of ``solve``."""

    def __init__(self, status: Status, message: str) -> None:
        self.status = status
        super().__init__(message)


class Run:
    """One solve: the equations as guarded callbacks, and the rows that were reached.

    A callback that has raised is not called again, and its exception is raised again after the library has returned,
    whatever the library made of it.  Values that are not finite go to the library as they are, since most shrink
    their step then; the function that gave them is named if the library fails.
    """

    def __init__(self, name: str, problem: Problem, request: Request, form: str) -> None:
        self.name, self.problem, self.request = name, problem, request
        self.t0, self.t1 = problem.t_span
        self.direction = -1.0 if self.t1 < self.t0 else 1.0
        self.work = Work(max_evaluations=request.max_evaluations, max_seconds=request.max_seconds)
        self.form_name = form
        self.t = self.t0
        self.y: Any = None  #: (size,) at t
        self.steps = 0
        self.output_evaluations = 0  #: residual evaluations that recovered multipliers at output rows
        self.unseen: list[str] = []  #: Counters of work inside compiled code
        self.library_counters: dict[str, int] = {}  #: Counters that only the library knows
        self.cause: BaseException | None = None  #: what a callback has raised
        self.stray: Any = None  #: first value of this step that is not finite: the error, or (t, y)
        self._stray_before: Any = None  # the same of the step before: Radau fails one step late
        self._strays = 0
        self._times: list[float] = []
        self._rows: list[Vector] = []

    def solution(self, drive: Callable[[Run], None]) -> Solution:
        """The whole solve."""
        if self.request.t_eval is not None:
            check_output_times(self.request.t_eval, self.t0, self.t1)
        failure = self._prepare()
        if failure is not None:
            return empty_solution(self.problem.q0.size, failure.status, failure.message, self.counters())
        end = self._end(drive)
        self.work.lift_budgets()
        return self._assemble(end)

    # --- the start -------------------------------------------------------------------------------------------------

    def _prepare(self) -> Failure | None:
        failure = None
        for _ in range(2):  # one stray value is not the cause
            try:
                return self._begin()
            except NonFiniteValue as error:
                self.work.add("nonfinite_evaluations")
                failure = Failure(Status.nonfinite_callback, f"{error}, at the start")
            except BudgetSpent as spent:
                return budget_failure(spent, self.t0)
        return failure

    def _begin(self) -> Failure | None:
        problem = self.problem
        place = Place(self.t0, problem.q0, problem.v0)
        guesses = problem.lam_guess, problem.mu_guess
        self.atol = self._tolerances()
        self.dynamics = counted_dynamics(dynamics_for(problem.system, place), self.work)
        self.levels, self.level = ConstraintLevels(self.dynamics), AccelerationLevel(self.dynamics)
        failure = undetermined(self.dynamics, place)
        if failure is None and self.dynamics.structure.constrained:
            failure = inconsistency(self.levels, place)
        if failure is not None:
            return failure
        check_guesses(self.dynamics.structure, guesses)
        found = start_acceleration(self.level, self.dynamics, self.work, place, guesses)
        if isinstance(found, Failure):
            return found
        self.form = form = forms.make_form(self.form_name, self.dynamics)
        self.first = found
        self.start = form.start(place.q, place.v, found.vdot, found.lam, found.mu)
        self.rtol, self.weights = float(self.request.rtol or 0.0), form.error_weights(self.atol)
        vector, matrix = (form.size,), (form.size, form.size)
        self.residual = self._guard(form.residual, vector, residuals=form.points)
        self.jacobian = self._guard(form.jacobian, matrix, jacobians=1)
        self.rhs = self._guard(form.rhs, vector, residuals=form.points)
        self.rhs_jacobian = self._guard(form.rhs_jacobian, matrix, jacobians=1)
        self.y = self.start.y
        self._output(self.t0, self.y, None)
        return None

    def _tolerances(self) -> Vector:
        """Absolute tolerances of q and v, (2n,)."""
        n, scales, atol = self.problem.q0.size, self.problem.scales, self.request.atol
        if atol is None:
            return float(self.request.rtol or 0.0) * np.concatenate([np.broadcast_to(s, n) for s in (scales.q, scales.v)])
        if np.shape(atol) not in ((), (n,), (2 * n,)):
            raise ProblemError(f"atol must be a number, ({n},) or ({2 * n},) for q and v; got shape {np.shape(atol)}.")
        return np.broadcast_to(atol, 2 * n) if np.ndim(atol) == 0 else np.resize(atol, 2 * n)

    def _guard(self, function: Callable[..., Any], shape: tuple[int, ...], **points: int) -> Callable[..., Any]:
        """``function(t, y, ...)`` counted, on private copies: libraries reuse and free what they pass."""
        counted = self.work.counted(function, **points)

        def call(t: float, y: Any, *more: Any) -> Any:
            if self.cause is not None:
                raise self.cause
            y = np.array(y)
            try:
                try:
                    value = np.array(counted(float(t), y, *(np.array(x) for x in more)))
                except NonFiniteValue as error:
                    value = np.full(shape, np.nan)
                    self._note_stray(y, error)
                else:
                    if not np.isfinite(value).all():
                        self._note_stray(y, (float(t), y))
            except BaseException as error:
                self.cause = error
                raise
            return value

        return call

    def _note_stray(self, y: Vector, where: Any) -> None:
        self._strays += 1
        if np.isfinite(y).all():  # else the library passes on what it was given before
            self.work.add("nonfinite_evaluations")
            self.stray = where if self.stray is None else self.stray
        if self._strays >= MOST_STRAYS:
            raise Halt(Status.nonfinite_callback, f"{MOST_STRAYS} values were not finite after t = {self.t:.17g}")

    def look_ahead(self, lost: float) -> None:
        """Find a value that is not finite on the way, by Euler's step, to the end ``lost`` of a failed step (or NaN: none).

        For an ODE whose steps are taken inside compiled code, where nobody watches.
        """
        if np.isfinite(lost):
            t, y, h = self.t, self.y, lost - self.t
            slope = self.rhs(t, y)
            for part in (1.0, 0.5, 0.25, 0.125, 0.0):
                if self.stray is None:
                    self.rhs(t + part * h, y + part * h * slope)

    # --- the steps -------------------------------------------------------------------------------------------------

    def unfinished(self) -> bool:
        """Whether the end is not reached; a spent budget ends the run here, as does an exception that was swallowed."""
        if self.cause is not None:
            raise self.cause
        if self.t == self.t1:
            return False
        most = self.request.max_num_steps
        if most is not None and self.steps >= most:
            raise Halt(Status.max_steps, f"{most} steps were taken and t = {self.t:.17g} reached; {Status.max_steps.text}")
        self.work.check_time()
        return True

    def accept(self, t: float, y: Any, between: Interpolate) -> None:
        """Take one accepted step that ended at (t, y); ``between`` interpolates inside it."""
        t, y = float(t), np.array(y, dtype=np.float64)
        if t == self.t:
            raise Halt(Status.time_resolution, f"t = {t:.17g} was not advanced by a step; {Status.time_resolution.text}")
        if not self.direction * self.t < self.direction * t <= self.direction * self.t1:
            raise Halt(Status.unreliable, f"a step from t = {self.t:.17g} towards {self.t1:.17g} led to t = {t:.17g}")
        if y.shape != (self.form.size,) or not np.isfinite(y).all():
            raise Halt(Status.unreliable, f"the step to t = {t:.17g} was reported as good but its state is not finite")
        self._output(t, y, between)
        self.t, self.y, self._strays = t, y, 0
        self.stray, self._stray_before = None, self.stray
        self.steps += 1
        self.work.add("steps_accepted")

    def _output(self, t: float, y: Vector, between: Interpolate | None) -> None:
        """Keep the rows that this step reaches: its end, or the output times within it."""
        wanted = self.request.t_eval
        if wanted is None:
            self._times.append(t)
            self._rows.append(y)
            return
        while len(self._times) < wanted.size and self.direction * wanted[len(self._times)] <= self.direction * t:
            time = float(wanted[len(self._times)])
            self._rows.append(y if time == t or between is None else np.array(between(time), dtype=np.float64))
            self._times.append(time)

    # --- the end ---------------------------------------------------------------------------------------------------

    def _end(self, drive: Callable[[Run], None]) -> Failure:
        """Drive the library and say how it ended; exceptions of callbacks are raised again as they are."""
        error: BaseException | None
        try:
            drive(self)
            error = self.cause
        except Exception as raised:  # noqa: BLE001 - a library may raise anything; it costs this solve only
            error = raised if self.cause is None else self.cause
        if error is None:
            return Failure(Status.success, Status.success.text)
        if isinstance(error, BudgetSpent):
            return budget_failure(error, self.t)
        if isinstance(error, Halt):
            end = Failure(error.status, str(error))
        elif error is self.cause:
            raise error
        else:
            message = f"the library raised {type(error).__name__} after t = {self.t:.17g}: {error}"
            end = Failure(Status.unreliable, message)
        stray = self._stray_before if self.stray is None else self.stray
        return end if stray is None or end.status is Status.max_steps else self._explained(end, stray)

    def _explained(self, end: Failure, found: Any) -> Failure:
        """A failure after values that were not finite: the function that gave them is its cause."""
        if not isinstance(found, NonFiniteValue):
            t, y = found
            try:
                explain_nonfinite(self.dynamics, t, *self.form.state(y), f"the form {self.form_name}")
            except NonFiniteValue as named:
                found = named
        return Failure(Status.nonfinite_callback, f"{found}; {self.name}: {end.message}")

    def _assemble(self, end: Failure) -> Solution:
        """The Solution: rows believed, multipliers from the acceleration level."""
        times, rows = np.array(self._times), np.array(self._rows).reshape(-1, self.form.size)
        q, v = (part.copy() for part in self.form.state(rows))
        status, message = end.status, end.message
        if status is Status.success:
            doubt = self._doubt(times, rows, q, v)
            if doubt:
                status, message = Status.unreliable, f"{Status.unreliable.text} {doubt}"
        before = self.work.tally["residual_evaluations"]
        lam, mu, note = self._multipliers(times, rows, q, v)
        self.output_evaluations = self.work.tally["residual_evaluations"] - before
        if len(lam) < len(times) and status is Status.success:
            status = Status.nonfinite_callback
        kept = len(lam)
        return Solution(
            t=times[:kept],
            q=q[:kept],
            v=v[:kept],
            lam=lam,
            mu=mu,
            status=status,
            message=f"{message} {note}".strip(),
            counters=self.counters(),
        )

    def _doubt(self, times: Vector, rows: Matrix, q: Matrix, v: Matrix) -> str:
        """What speaks against the rows of a success, in words; empty when nothing does."""
        wanted = self.request.t_eval
        if self.t != self.t1:
            return f"It stopped at t = {self.t:.17g} and not at {self.t1:.17g}."
        if wanted is not None and not np.array_equal(times, wanted):
            return f"It gave {times.size} of {wanted.size} rows."
        if not np.isfinite(rows).all():
            return f"The row at t = {times[np.argmin(np.isfinite(rows).all(axis=1))]:.17g} is not finite."
        if not self.dynamics.structure.constrained or not times.size:
            return ""
        scales = self.problem.scales
        for i in np.unique(np.linspace(0, times.size - 1, CHECKED_ROWS).astype(int)):
            try:
                at = self.levels.at(float(times[i]), q[i], v[i])
            except NonFiniteValue as error:
                return f"{error}."
            velocity = at.scaled_velocity(scales.v)[at.position.size :]
            worst = np.max(np.concatenate([at.scaled_position(scales.q), velocity]))
            if not worst <= BELIEVABLE:
                return f"At t = {times[i]:.17g} a constraint is violated by {worst:.2g} of its size."
        return ""

    def _multipliers(self, times: Vector, rows: Matrix, q: Matrix, v: Matrix) -> tuple[Matrix, Matrix, str]:
        """lam (k, m) and mu (k, p) from the acceleration level; rows end before a time where it is not finite."""
        s = self.dynamics.structure
        lam, mu = np.zeros((times.size, s.m)), np.zeros((times.size, s.p))
        if not s.constrained:
            return lam, mu, ""
        guesses, undetermined_at = (self.first.lam, self.first.mu), []
        for i, t in enumerate(times):
            guesses = self._own_multipliers(rows[i], guesses)
            try:
                found = acceleration_at(self.level, self.dynamics, self.work, float(t), q[i], v[i], guesses)
            except NonFiniteValue as error:
                return lam[:i], mu[:i], f"{error}, when the multipliers were recovered."
            if found.singular or found.residual > 0:
                undetermined_at.append(float(t))
            else:
                guesses = found.lam, found.mu
            lam[i], mu[i] = guesses
        if not undetermined_at:
            return lam, mu, ""
        note = f"The acceleration level determines no multipliers at {len(undetermined_at)} times, first at t = "
        return lam, mu, f"{note}{undetermined_at[0]:.17g}; the values of the form or of the row before stand there."

    def _own_multipliers(self, y: Vector, otherwise: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        """The multipliers that the form carries in ``y``, else ``otherwise``: they pick the root of a nonlinear reaction."""
        blocks = self.form.blocks
        lam, mu = (
            y[blocks[name]] if name in blocks else other for name, other in zip(("lam", "mu"), otherwise, strict=True)
        )
        return lam, mu

    def counters(self) -> Counters:
        """The work done so far; what nobody reports is None."""
        counted = dict.fromkeys(("steps_accepted", "residual_evaluations", "jacobian_evaluations", "event_evaluations"), 0)
        counted |= {"nonfinite_evaluations": 0} | dict(self.work.tally)
        unknown = ("steps_rejected_error", "steps_rejected_newton", "newton_iterations", "factorisations", "linear_solves")
        values: dict[str, Any] = dict.fromkeys(unknown) | counted | self.library_counters
        values |= dict.fromkeys(self.unseen)
        told = f"; library: {', '.join(self.library_counters)}" if self.library_counters else ""
        told += f"; of the residual evaluations {self.output_evaluations} for multipliers at output rows"
        return Counters(**values, provenance=f"counted{told}; None: not reported")

    def partial(self, error: BaseException) -> Solution:
        """What was accepted before an exception; no function of the system is called for it."""
        status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
        message = f"{type(error).__name__}: {error}."
        if not hasattr(self, "start"):
            return empty_solution(self.problem.q0.size, status, message, self.counters())
        times, rows = np.array(self._times), np.array(self._rows).reshape(-1, self.form.size)
        q, v = (part.copy() for part in self.form.state(rows))
        none = np.full(self.dynamics.structure.m, np.nan), np.full(self.dynamics.structure.p, np.nan)
        own = [self._own_multipliers(y, none) for y in rows]
        lam, mu = (np.array([pair[i] for pair in own]).reshape(len(rows), none[i].size) for i in range(2))
        message = f"{message} The multipliers are those of the form, NaN where it has none."
        return Solution(t=times, q=q, v=v, lam=lam, mu=mu, status=status, message=message, counters=self.counters())
