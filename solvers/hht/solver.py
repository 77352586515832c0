"""``HHT``: the integrator's own face, and its adapter for the bench."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.arguments import real_number, real_vector
from hhtbench.counting import Work
from hhtbench.errors import ProblemError
from hhtbench.protocol import NumpySystem, Problem, System
from hhtbench.request import Request, StepPlan, check_output_times, make_request, plan_steps
from hhtbench.result import Counters, Solution, Status
from solvers._start import Failure, Guesses, Place, empty_solution
from solvers.hht.begin import Started, begin, make_engine
from solvers.hht.coefficients import Method, make_method
from solvers.hht.engine import HostEngine
from solvers.hht.history import History
from solvers.hht.integrate import assemble, integrate, unrecovered
from solvers.hht.state import State

OPTIONS = ("alpha", "b", "reaction", "rescale_a", "start", "calc_initcond")


class HHT:
    """The extended HHT-alpha method (Jay and Negrut, ETNA 26, 2007) for one system; THEORY.md states the formulas.

    Forces are seen at the ends of steps only: a step may pass over a shorter interval in which they jump or are not
    finite.

    Parameters
    ----------
    system
        A :class:`~hhtbench.protocol.System` or :class:`~hhtbench.protocol.NumpySystem`.
    alpha
        Damping parameter in [-1/3, 0]; 0 keeps the energy of fast vibrations, -1/3 damps them most.
    b
        Weight of the end reaction in the position, not 1/2.
    reaction
        Where the end reaction is taken: "implicit", "predictor", "midpoint" or "midpoint_predictor" (b = 0).
    rescale_a
        Adapt the auxiliary acceleration when the step changes; without it variable steps are of order one.
    start
        Auxiliary acceleration of the first step: "f0", "shifted" or "trapezoidal".
    calc_initcond
        Project an inconsistent start onto both constraint levels instead of refusing it.

    Raises
    ------
    ProblemError, TypeError
        An option is out of range or unknown; the text says what was expected.
    """

    def __init__(
        self,
        system: System | NumpySystem,
        *,
        alpha: float = -0.05,
        b: float = 0.0,
        reaction: str = "implicit",
        rescale_a: bool = True,
        start: str = "f0",
        calc_initcond: bool = False,
    ) -> None:
        if not isinstance(system, (System, NumpySystem)):
            raise TypeError(f"system must be a System or a NumpySystem; got {type(system).__name__}.")
        self.system = system
        self.method: Method = make_method(alpha=alpha, b=b, reaction=reaction, rescale_a=rescale_a, start=start)
        if not isinstance(calc_initcond, bool):
            raise TypeError(f"calc_initcond must be True or False; got {calc_initcond!r}.")
        self.calc_initcond = calc_initcond
        self._state: State | None = None
        self._step: float | None = None
        self._engine: HostEngine | None = None
        self._place: Place | None = None  # where stepping began: it selects the engine
        self._message = ""
        self._distrusted = False  # whether that engine has given up the declared derivatives
        self._busy = threading.Lock()

    def solve(
        self, tspan: Any, q0: Any, v0: Any, *, lam_guess: Any = None, mu_guess: Any = None, **request: Any
    ) -> Solution:
        """Integrate over ``tspan = (t0, t1)`` [s] from ``q0, v0`` (n,) with prescribed steps.

        ``lam_guess`` (m,) and ``mu_guess`` (p,) pick the root where the reaction is nonlinear.  The other keywords
        are those of :class:`~hhtbench.request.Request`; ``step``, or ``steps``, is required.

        Returns
        -------
        Solution
            With a :class:`~hhtbench.result.Status`; numerical failures keep the accepted steps.  An exception of
            the system's own functions is raised again as it is, with ``.partial_solution``.
        """
        asked = make_request(**request)
        if asked.options:
            raise TypeError(f"HHT takes its options when it is made: HHT(system, alpha=...); got options={asked.options}.")
        if not asked.fixed:
            raise ProblemError("HHT takes prescribed steps: give step=h, steps=N or steps=array of lengths [s].")
        if not isinstance(tspan, (tuple, list, np.ndarray)) or len(tspan) != 2:
            raise ProblemError(f"tspan must be two times (t0, t1) [s]; got {tspan!r}.")
        t0, t1 = (real_number(f"tspan[{i}]", t, unit=" [s]") for i, t in enumerate(tspan))
        place, guesses = self._start_values(t0, q0, v0, lam_guess, mu_guess)
        if asked.t_eval is not None:
            check_output_times(asked.t_eval, t0, t1)
        plan = plan_steps(asked, t0, t1)
        with self._alone():
            return _Run(self, asked, plan, place, guesses).solution()

    def init_step(self, t0: float, q0: Any, v0: Any, *, step: float, lam_guess: Any = None, mu_guess: Any = None) -> Status:
        """Prepare stepping by hand with a constant signed ``step`` [s]; returns the status of the start."""
        place, guesses = self._start_values(real_number("t0", t0, unit=" [s]"), q0, v0, lam_guess, mu_guess)
        h = real_number("step", step, unit=" [s]")
        if h == 0.0:
            raise ProblemError("step must not be zero.")
        with self._alone():
            started = self._begin(place, guesses, h, Work())
            self._step, self._engine, self._state = h, started.engine, started.state
            self._place, self._distrusted = place, False
            self._message = started.failure.message if started.failure else started.note
        return started.failure.status if started.failure else Status.success

    def step(self) -> Status:
        """Take one step from :attr:`state`; on a failure the state stays and the status says why."""
        with self._alone():
            if self._state is None or self._step is None:
                raise ProblemError("there is no state to step from; call init_step(t0, q0, v0, step=h) first.")
            if self._engine is None:
                self._engine = self._rebuild()
            t1 = self._state.t + self._step
            if t1 == self._state.t:
                self._message = Status.time_resolution.text
                return Status.time_resolution
            taken = self._engine.step(self._state, self._step, t1)
            self._distrusted = self._engine.distrusts
            self._message = taken.message if isinstance(taken, Failure) else ""
            if isinstance(taken, Failure):
                return taken.status
            self._state = taken.state
        return Status.success

    @property
    def state(self) -> State:
        """The frozen state after the last step taken by hand."""
        if self._state is None:
            raise ProblemError("there is no state; call init_step first.")
        return self._state

    @property
    def message(self) -> str:
        """What the last :meth:`init_step` or :meth:`step` had to say: a projection, or the cause of a failure."""
        return self._message

    @property
    def counters(self) -> Counters:
        """Work done by stepping by hand since :meth:`init_step`."""
        return self._engine.work.counters() if self._engine is not None else Counters()

    def restart(self, state: State, *, step: float | None = None) -> None:
        """Step on from ``state``, an earlier one or one that was saved, with ``step`` [s] or the step in use."""
        if not isinstance(state, State):
            raise TypeError(f"restart takes a State (HHT.state); got {type(state).__name__}.")
        if self._state is not None and state.q.shape != self._state.q.shape:
            raise ProblemError(f"restart takes a State with q of shape {self._state.q.shape}; got {state.q.shape}.")
        h = self._step if step is None else real_number("step", step, unit=" [s]")
        if not h:
            raise ProblemError("restart needs a step [s] other than zero; give step=h.")
        with self._alone():
            if self._place is None:
                self._place = Place(state.t, state.q, state.v)
            self._state, self._step = state, h

    def _begin(self, place: Place, guesses: Guesses, h: float, work: Work) -> Started:
        return begin(self.system, self.method, place, guesses, h, work, calc_initcond=self.calc_initcond)

    def _rebuild(self) -> HostEngine:
        """The engine of the first step again, for a state that came from a pickle; no start is computed again."""
        if self._place is None:
            raise ProblemError("there is no state; call init_step first.")
        engine = make_engine(self.system, self.method, self._place, Work())
        if self._distrusted:
            engine.distrust()
        return engine

    def _start_values(self, t0: float, q0: Any, v0: Any, lam_guess: Any, mu_guess: Any) -> tuple[Place, Guesses]:
        q = real_vector("q0", q0)
        if q.size == 0:
            raise ProblemError("q0 must hold at least one coordinate; got shape (0,).")
        v = real_vector("v0", v0, q.size)
        lam = None if lam_guess is None else real_vector("lam_guess", lam_guess)
        mu = None if mu_guess is None else real_vector("mu_guess", mu_guess)
        return Place(t0, q, v), (lam, mu)

    def _alone(self) -> _Alone:
        return _Alone(self._busy)

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_busy", "_engine")}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__dict__.update(saved, _busy=threading.Lock(), _engine=None)


class _Alone:
    """Holds the lock of one HHT object; a class, since a generator would write to the traceback of a frozen exception."""

    def __init__(self, busy: Any) -> None:
        self.busy = busy

    def __enter__(self) -> None:
        if not self.busy.acquire(blocking=False):
            where = "in another thread, or a call from its own callback"
            raise RuntimeError(f"this HHT object is already solving ({where}); make one per use.")

    def __exit__(self, *_: object) -> None:
        self.busy.release()


class _Run:
    """One call of ``HHT.solve``."""

    def __init__(self, solver: HHT, request: Request, plan: StepPlan, place: Place, guesses: Guesses) -> None:
        self.solver, self.request, self.plan, self.place, self.guesses = solver, request, plan, place, guesses
        self.work = Work(max_evaluations=request.max_evaluations, max_seconds=request.max_seconds)
        self.history: History | None = None
        self.engine: HostEngine | None = None

    def solution(self) -> Solution:
        try:
            return self._solution()
        except BaseException as error:
            BaseException.__setattr__(error, "partial_solution", self._partial(error))  # also where the class is frozen
            raise

    def _solution(self) -> Solution:
        started = self.solver._begin(self.place, self.guesses, self.plan.length(0), self.work)
        if started.engine is None or started.state is None:
            failure = started.failure
            return empty_solution(self.place.q.size, failure.status, failure.message, self.work.counters())  # type: ignore[union-attr]
        self.engine = started.engine
        self.history = History(started.engine.structure, started.state)
        plan = self.plan
        if plan.t0 == plan.t1:
            plan = StepPlan(t0=plan.t0, t1=plan.t1, count=0, lengths=None, ends=None)
        end = integrate(started.engine, started.state, plan, self.history, self.request.max_num_steps)
        return assemble(started.engine, self.history, self.request.t_eval, end, started.note)

    def _partial(self, error: BaseException) -> Solution:
        status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
        message = f"{type(error).__name__}: {error}."
        if self.engine is None or self.history is None:
            return empty_solution(self.place.q.size, status, message, self.work.counters())
        return unrecovered(self.engine, self.history, self.request.t_eval, message, status)


@dataclass(frozen=True)
class HHTSolver:
    """The adapter of :class:`HHT` for the bench: ``load_solver("hht(alpha=-0.1, b=0)")``."""

    name: str
    options: Mapping[str, Any]

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Declines error-controlled requests."""
        unknown = sorted(set(request.options) - set(OPTIONS))
        if unknown:
            return f"unknown option {', '.join(unknown)}; known: {', '.join(OPTIONS)}"
        if not request.fixed:
            return "hht takes prescribed steps: give step=h, steps=N or steps=array; it has no error control yet"
        return None

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate ``problem`` over its interval."""
        hht = HHT(problem.system, **{**self.options, **request.options})
        names = ("step", "steps", "t_eval", "max_num_steps", "max_evaluations", "max_seconds")
        asked = {name: getattr(request, name) for name in names}
        return hht.solve(
            problem.t_span, problem.q0, problem.v0, lam_guess=problem.lam_guess, mu_guess=problem.mu_guess, **asked
        )

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use, by one step without budgets; nothing is counted."""
        self.solve(problem, replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None))


def solver(**options: Any) -> HHTSolver:
    """The extended HHT-alpha method; options as in :class:`HHT`."""
    unknown = sorted(set(options) - set(OPTIONS))
    if unknown:
        raise TypeError(f"hht does not know {', '.join(unknown)}; known: {', '.join(OPTIONS)}.")
    checked = {k: v for k, v in options.items() if k != "calc_initcond"}
    make_method(**{"alpha": -0.05, "b": 0.0, "reaction": "implicit", "rescale_a": True, "start": "f0", **checked})
    return HHTSolver("hht", dict(options))
