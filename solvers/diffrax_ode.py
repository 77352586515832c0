"""``diffrax(method=Tsit5|Dopri8|Kvaerno5)``: diffrax on the underlying ODE, compiled as a whole.

The loop over steps is compiled too (:mod:`solvers._diffrax_loop`); it returns to Python after every SEGMENT attempts, so
that budgets hold.  Evaluations inside compiled code cannot be counted.  Those of an explicit method follow from its
stages and attempts; those of an implicit one from :meth:`DiffraxSolver.count`, which repeats the solve, untimed, with
Python functions that count; ``max_evaluations`` selects that code.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from hhtbench.lowering import compile_function
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Status
from solvers._adapter import Adapter, choose
from solvers._dense import NODES, Polynomial
from solvers._run import Halt, Run
from solvers._xla_call import functions

try:
    from solvers import _diffrax_loop as loop
except ImportError:
    loop = None  # type: ignore[assignment]

MAX_SEGMENT_TIME = 0.05  # [s] of one segment under a time budget
KNOWN = {"method": ("Tsit5", "Dopri8", "Kvaerno5"), "form": ("ode",)}

_tickets = itertools.count()


class DiffraxSolver(Adapter):
    """One of diffrax's Runge-Kutta methods with its default step-size controller."""

    library: ClassVar[str] = "diffrax"
    installed: ClassVar[bool] = loop is not None

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """As every adapter; declines systems that JAX cannot trace."""
        if self.installed and isinstance(problem.system, NumpySystem):
            return "diffrax compiles the system, and plain callables cannot be compiled; write it as a System in jax.numpy"
        return super().accepts(problem, request)

    def warm_up(self, problem: Problem, request: Request) -> None:
        """As every adapter; also compiles output within a step."""
        one = replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None)
        t = self.solve(problem, replace(one, t_eval=None)).t
        if request.t_eval is not None and t.size == 2:
            self.solve(problem, replace(one, t_eval=t[:1] + np.diff(t) / 2))

    def count(self, problem: Problem, request: Request) -> Counters:
        """The counters of :meth:`solve` including evaluations, from a second run."""
        counters = self.solve(problem, replace(request, max_evaluations=request.max_evaluations or 2**62)).counters
        return replace(counters, provenance=f"in a second run: {counters.provenance}")

    def drive(self, run: Run) -> None:
        """Run compiled segments until the end."""
        implicit = loop.evaluations_per_step(self.method) is None
        outside = run.form.outside(implicit) or (implicit and run.request.max_evaluations is not None)
        if implicit and not outside:
            run.work.unseen = ["residual_evaluations", "output_evaluations", "jacobian_evaluations"]
        ticket, called = next(_tickets), _Called(run)
        functions[ticket] = called
        try:
            self._segments(run, outside, ticket, called)
        finally:
            del functions[ticket]

    def _segments(self, run: Run, outside: bool, ticket: int, called: _Called) -> None:
        parts = loop.start_steps, loop.take_steps, loop.step_to, loop.inside
        start, segment, step_to, interpolate = (
            called.watched(compile_function(part, run.dynamics, self.method, outside, route="xla")) for part in parts
        )
        s1, most = run.direction * run.t1, run.request.max_num_steps  # time runs forward in s = +-(t - t0)
        per_step = 0 if outside else loop.evaluations_per_step(self.method) or 0  # functions of Python count themselves
        fixed = np.array([run.direction, ticket, run.time(run.t0), s1, run.rtol]), run.weights
        state, lost, rejected = start(*fixed, run.start.y), np.nan, 0
        room = loop.SEGMENT if run.request.max_seconds is None else 1
        _book(run, loop.AT_START if per_step else 0)
        while run.unfinished():
            began = time.perf_counter()
            packed = segment(*fixed, state, room if most is None else min(room, most - run.steps))
            state, numbers, rows = np.split(packed, [state.size, state.size + 3])
            accepted, attempted = int(numbers[0]), int(numbers[1])
            rejected += attempted - accepted
            if run.request.max_seconds is not None:
                each = (time.perf_counter() - began) / max(attempted, 1)
                room = int(min(8 * room, loop.SEGMENT, max(MAX_SEGMENT_TIME / each, 1.0)))
            lost = numbers[2] if accepted or np.isnan(lost) else lost
            run.work.library = {"steps_rejected_error": rejected}
            _book(run, per_step * attempted)
            for row in rows.reshape(loop.SEGMENT, -1)[:accepted]:
                t = run.t1 if row[1] == s1 else run.direction * row[1]
                between = partial(_between, run, step_to, fixed, row, per_step)
                dense = partial(_sampled, run, interpolate, fixed, row, per_step)
                run.accept(t, row[2 : 2 + run.form.size], between, dense=dense)
            if not accepted:
                _check_ahead(run, run.direction * lost)
                status = Status.step_too_small
                raise Halt(status, f"diffrax accepts no step from t = {exact(run.now)}. {status.text}")


class _Called:
    """y' and dy'/dy called from compiled code; NaN after the first exception."""

    def __init__(self, run: Run) -> None:
        self._run, self._interrupts = run, Callbacks()
        form, counted = run.form, run.work.counted
        self._functions = {1: counted(form.rhs, residuals=form.points), 2: counted(form.rhs_jacobian, jacobians=1)}

    def __call__(self, shape: tuple[int, ...], t: Any, y: Any) -> Any:
        guard = self._run.guard
        if guard.cause is None and self._interrupts.cause is None:
            try:
                return self._functions[len(shape)](self._run.time(float(t)), y)
            except BaseException as error:  # noqa: BLE001 - it is raised again after the compiled code has returned
                guard.cause = error
        return np.nan

    def watched(self, compiled: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap ``compiled`` code that calls these: an interrupt during a call is raised after it."""

        def call(*arguments: Any) -> Any:
            with self._interrupts:
                found = compiled(*arguments)
            cause = self._interrupts.take_cause()
            if cause is not None:
                raise cause
            return found

        return call


def _check_ahead(run: Run, lost: float) -> None:
    """Make the guard note a value that is not finite on Euler's step to a failed step's end ``lost`` (NaN: skip)."""
    if np.isfinite(lost):
        t, y, h = run.t, run.y, lost - run.t
        slope = run.rhs(t, y)
        for part in (1.0, 0.5, 0.25, 0.125, 0.0):
            if run.guard.nonfinite is None:
                run.rhs(t + part * h, y + part * h * slope)


def _between(run: Run, step_to: Any, fixed: Any, row: Any, per_step: int, at: float) -> Any:
    _book(run, per_step + 1 if per_step else 0)
    return step_to(*fixed, row, fixed[0][0] * at)


def _sampled(run: Run, inside: Any, fixed: Any, row: Any, per_step: int) -> Polynomial:
    """The method's polynomial over the step in ``row``, from samples, so that no compiled code is needed later."""
    _book(run, per_step + 1 if per_step else 0)
    times = row[0] + (row[1] - row[0]) * NODES
    return Polynomial(fixed[0][0] * times, np.asarray(inside(*fixed, row, times)))


def _book(run: Run, evaluations: int) -> None:
    """Count ``evaluations`` done inside compiled code; raises if the budget is spent."""
    run.work.add("residual_evaluations", evaluations)
    most = run.work.max_evaluations
    if most is not None and run.work.tally["residual_evaluations"] > most:
        raise BudgetSpent("evaluations", most)


def solver(**options: Any) -> DiffraxSolver:
    """A method of diffrax; options ``method``: Tsit5 (default), Dopri8 or Kvaerno5, ``form``: ode."""
    chosen = choose("diffrax", options, KNOWN)
    return DiffraxSolver(f"diffrax(method={chosen['method']})", chosen["form"], chosen["method"])
