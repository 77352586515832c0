"""One call of ``HHT.solve``: start, steps, rows, and what is left of it when something raises."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from hhtbench.arguments import check_interval, real_number, real_vector
from hhtbench.counting import Clock, Work
from hhtbench.errors import ProblemError
from hhtbench.request import ADDS_UP, Request, check_output_times, plan_steps
from hhtbench.result import Solution, Status
from solvers._start import Failure, Guesses, Place, empty_solution
from solvers.hht.control.plan import ByError, Prescribed
from solvers.hht.control.tolerances import components, make_tolerances
from solvers.hht.run.begin import Started
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.integrate import assemble, checked, integrate, unrecovered
from solvers.hht.run.stepper import Stepper
from solvers.hht.run.stepping import MAX_STEPS


class Integration:
    """One integration from ``place`` to ``t1`` [s] with the options of ``solver`` (an HHT)."""

    def __init__(self, solver: Any, request: Request, t1: float, place: Place, guesses: Guesses, clock: Clock) -> None:
        self.solver, self.request, self.t1, self.place, self.guesses = solver, request, t1, place, guesses
        self.work = Work(max_evaluations=request.max_evaluations, clock=clock)
        self.history: History | None = None
        self.engine: Engine | None = None

    def solution(self) -> Solution:
        """Integrate; what is raised carries ``.partial_solution``."""
        try:
            return self._solution()
        except BaseException as error:
            BaseException.__setattr__(error, "partial_solution", self._partial(error))  # also where the class is frozen
            raise

    def _solution(self) -> Solution:
        request, t0 = self.request, self.place.t
        plan = plan_steps(request, t0, self.t1) if request.fixed else None
        h = self.t1 - t0 if plan is None else plan.length(0)
        started: Started = self.solver.begin(self.place, self.guesses, h, self.work, controlled=plan is None)
        if started.engine is None or started.state is None:
            return self._nothing(started.failure or Failure(Status.declined, ""))
        engine, state, most = started.engine, started.state, request.max_num_steps
        events = self.solver.events
        self.engine, self.history = engine, History(engine.structure, state, len(events))
        if plan is None:
            tolerances = make_tolerances(request.rtol, request.atol, state)
            stepper = Stepper(engine=engine, plan=ByError(tolerances, self.solver.options.control), events=events)
            most = most or MAX_STEPS
        else:
            stepper = Stepper(engine=engine, plan=Prescribed(plan), events=events)
        end = integrate(stepper, state, self.t1, self.history, most)
        engine.raise_left_over()
        rtol = ADDS_UP if request.rtol is None else float(np.min(request.rtol))
        end = checked(end, self.history, rtol)
        return assemble(engine, self.history, request.t_eval, end, started.note)

    def _nothing(self, failure: Failure) -> Solution:
        n = self.place.q.size
        empty = empty_solution(n, failure.status, failure.message, self.work.counters())
        count, rows = len(self.solver.events), np.zeros((0, n))
        return replace(empty, t_events=(np.zeros(0),) * count, q_events=(rows,) * count, v_events=(rows,) * count)

    def _partial(self, error: BaseException) -> Solution:
        status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
        message = f"{type(error).__name__}: {error}."
        if self.engine is None or self.history is None:
            return self._nothing(Failure(status, message))
        return unrecovered(self.engine, self.history, self.request.t_eval, message, status)


def end_times(tspan: Any) -> tuple[float, float]:
    """The two times [s] of ``tspan``."""
    tspan = real_vector("tspan", tspan) if isinstance(tspan, jax.Array) else tspan
    if not isinstance(tspan, (tuple, list, np.ndarray)) or len(tspan) != 2:
        raise ProblemError(f"tspan must be two times (t0, t1) [s]; got {tspan!r}.")
    t0, t1 = (real_number(f"tspan[{i}]", t, unit=" [s]") for i, t in enumerate(tspan))
    return t0, t1


def check_request(request: Request, n: int, t0: float, t1: float) -> None:
    """Raise unless ``request`` fits HHT, ``n`` coordinates and the interval from ``t0`` to ``t1`` [s]."""
    if request.options:
        raise TypeError(f"HHT takes its options when it is made: HHT(system, alpha=...); got options={request.options}.")
    check_accuracy(request, n)
    if request.t_eval is not None:
        check_output_times(request.t_eval, t0, t1)
    check_interval("tspan", t0, t1)
    if request.fixed:
        plan_steps(request, t0, t1)


def check_accuracy(request: Request, n: int) -> None:
    """Raise unless ``request`` says how the steps of a system with ``n`` coordinates are found.

    Raises
    ------
    ProblemError
        It has neither steps nor tolerances, or those are of a wrong shape.
    """
    if not request.fixed and request.rtol is None and request.atol is None:
        raise ProblemError("HHT takes step=h, steps=N or steps=array of lengths [s], or tolerances: rtol=1e-4.")
    if request.atol is None and request.rtol is not None and np.any(np.asarray(request.rtol) == 0):
        raise ProblemError("rtol = 0 leaves no tolerance; give atol too.")
    for name, value in (("rtol", request.rtol), ("atol", request.atol)):
        components(name, 0.0 if value is None else value, n)
