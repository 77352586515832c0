"""The class ``HHT``: integration over an interval, stepping by hand, checkpoints."""

from __future__ import annotations

import threading
import time
import warnings
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import make_events
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.counting import Work, timed
from hhtbench.solution.request import Request, make_request, with_tolerance
from hhtbench.solution.result import Counters, DenseOutput, Solution, Status
from solvers._ending import solved
from solvers._start import Failure, Guesses, PhasePoint
from solvers.hht.control.tolerances import make_tolerances
from solvers.hht.events.event import Occurrence
from solvers.hht.options import HHTOptions, make_options
from solvers.hht.run.checkpoint import check, named, pack, setup_of, unpack
from solvers.hht.run.engine import Engine, not_extrapolated
from solvers.hht.run.solve import Integration, check_accuracy, end_times, planned
from solvers.hht.run.start import Started, begin, make_engine, start_values
from solvers.hht.run.stepping import IntegratorState, Onward, begun, make_goal, onward, stepper_of, take
from solvers.hht.step.state import State

NOT_SAVED = {"_solving", "_settling", "_engine", "_onward"}  # attributes of an HHT object that a pickle leaves out


class HHT:
    """The extended HHT-alpha method (Jay and Negrut, ETNA 26, 2007) for one system; THEORY.md states the formulas.

    Forces are evaluated at the ends of steps only: a jump or a value that is not finite between two ends can go unnoticed.
    :meth:`solve` integrates over an interval; :meth:`init_step` and :meth:`step` go step by step, as SUNDIALS does.

    Parameters
    ----------
    system
        A :class:`~hhtbench.System` or :class:`~hhtbench.protocol.system.NumpySystem`.
    events
        :class:`~solvers.hht.events.Event` or plain callables ``(t, q, v)``, one or a list.  Times and states of the events
        are in ``Solution.t_events``, ``q_events`` and ``v_events``, one entry per event.  Where an event changes the state
        the solution has two rows with one time, before and after; there dense output gives the state after the change,
        ``q_events`` and ``v_events`` the one before.
    **options
        ``alpha`` or ``rho_inf`` (damping), ``b``, ``reaction``, ``extrapolate_reaction``, ``rescale_a``, ``start`` (the
        method's variant),
        ``first_step``, ``min_step``, ``max_step`` [s], ``linsolver``, ``without`` and ``engine``:
        ``help(HHTOptions)`` describes each with its default.

    Raises
    ------
    ProblemError, TypeError
        An option is out of range or unknown; the message says what was expected.
    """

    name: ClassVar[str] = "hht"  #: the solver's name in messages
    kind: ClassVar[Any] = HHTOptions  #: class of its options

    def __init__(self, system: System | NumpySystem, *, events: Any = None, **options: Any) -> None:
        if not issubclass(type(system), (System, NumpySystem)):  # isinstance is slow: it asks equinox
            raise TypeError(f"system must be a System or a NumpySystem; got {type(system).__name__}.")
        self.system = system
        self.options = make_options(self.kind, self.name, **options)
        if reason := refused(system, self.options):
            raise ProblemError(f"{reason}.")
        self.events = make_events(events)
        if any(event.period for event in self.events):
            raise ProblemError("Event.every is for hhtbench.solve, which takes it with every solver.")
        self.engine_used = ""  #: loops, functions and linear algebra of the last run, as text
        self._integrator: IntegratorState | None = None  # where stepping by hand stands
        self._engine: Engine | None = None
        self._onward: Onward | None = None  # steps by hand made since then
        self._message = ""
        self._locks()

    @classmethod
    def declined(cls, problem: Problem, request: Request, options: Mapping[str, Any]) -> str | None:
        """Reason why this method with ``options`` cannot solve ``problem`` with ``request``; None if it can."""
        return refused(problem.system, make_options(cls.kind, cls.name, **options))

    def solve(
        self, tspan: Any, q0: Any, v0: Any, *, lam_guess: Any = None, mu_guess: Any = None, **request: Any
    ) -> Solution:
        """Integrate over ``tspan = (t0, t1)`` [s] from ``q0, v0`` (n,) with prescribed steps or error control.

        ``lam_guess`` (m,) and ``mu_guess`` (p,) pick the root where the reaction is nonlinear.  The other keywords
        are those of :class:`~hhtbench.Request`: ``step``, ``steps`` (also those of an earlier solution), or ``rtol`` and
        ``atol``.  ``atol`` is a number, (n,) for q and v alike, or (2n,); None takes ``rtol`` times typical sizes at the
        start.  Without any of them ``rtol = 1e-4``, and the solution's message says so.

        Returns
        -------
        Solution
            With a :class:`~hhtbench.Status`; numerical failures keep the accepted steps.  An exception of
            the system's own functions is raised again as it is, with ``.partial_solution``.  With ``t_eval``, steps that
            fill more than 24 MB are not kept: ``steps_data`` and dense output are None.  Rows at ``t_eval`` between steps
            are projected onto both levels of the constraints, (H47); where that fails, ``message`` says so.
        """
        began = time.perf_counter()
        asked, note = with_tolerance(make_request(**request))
        t0, t1 = end_times(tspan)
        place, guesses = start_values(t0, q0, v0, lam_guess, mu_guess)
        found = self.solve_from(place, t1, guesses, asked, began)
        return found.but(message=f"{found.message.rstrip('.')}. {note}") if note else found

    def solve_from(
        self, place: PhasePoint, t1: float, guesses: Guesses, request: Request, began: float | None = None
    ) -> Solution:
        """Solve from ``place`` to ``t1`` [s] with checked arguments; ``began``: clock reading at the call [s]."""
        steps = planned(request, place.q.size, place.t, t1)
        with self._alone(), timed(request.max_seconds, began) as clock:
            integration = Integration(self, request, steps, t1, place, guesses, clock)
            return solved(integration.solution, integration.left_over)

    def begin(
        self,
        place: PhasePoint,
        guesses: Guesses,
        h: float,
        work: Work,
        *,
        controlled: bool = False,
        calc_initcond: bool = False,
    ) -> Started | Failure:
        """Build the engine and its first state; ``h`` [s] is the first step, or only the direction of time."""
        how: dict[str, Any] = {"controlled": controlled, "calc_initcond": calc_initcond, "events": self.events}
        started = begin(self.system, self.options, place, guesses, h, work, **how)
        self.engine_used = "" if isinstance(started, Failure) else started.engine.why
        return started

    def init_step(
        self,
        t0: float,
        q0: Any,
        v0: Any,
        *,
        step: float | None = None,
        rtol: Any = None,
        atol: Any = None,
        lam_guess: Any = None,
        mu_guess: Any = None,
        calc_initcond: bool = False,
    ) -> Status:
        """Prepare stepping by hand with a constant signed ``step`` [s], or with tolerances as in :meth:`solve`.

        ``calc_initcond`` projects an inconsistent start onto both constraint levels.
        Returns the status of the start; :attr:`message` gives details.
        """
        place, guesses = start_values(t0, q0, v0, lam_guess, mu_guess)
        h = None if step is None else real_number("step", step, unit=" [s]")
        if h == 0.0:
            raise ProblemError("step must not be zero.")
        given = {"step": None if h is None else abs(h), "rtol": rtol, "atol": atol, "calc_initcond": calc_initcond}
        asked, note = with_tolerance(make_request(**given))
        check_accuracy(asked, place.q.size)
        with self._alone(), timed(None) as clock:
            first, work = h or self.options.control.first_step, Work(clock=clock)
            clock.work = work
            started = self.begin(place, guesses, first, work, controlled=h is None, calc_initcond=asked.calc_initcond)
            self._engine = self._integrator = self._onward = None
            if isinstance(started, Failure):
                self._message = started.message
                return started.status
            self._engine = started.engine
            tolerances, state = None, started.state
            if h is None:
                tolerances = make_tolerances(asked.rtol, asked.atol, state, started.applied)
            unseen = "" if tolerances is None else tolerances.warn(state.size_q)
            self._message = " ".join(filter(None, (started.note, note, unseen)))
            self._integrator = begun(place, state, h, tolerances, len(self.events))
        return Status.success

    def step(self, t: float | None = None, method: str = "onestep", tstop: float | None = None) -> Status:
        """Take steps from :attr:`state` as CVODE and IDA do; a failed step leaves the state and returns the reason.

        Parameters
        ----------
        t
            [s].  With ``method="normal"`` steps are taken until it is reached or passed, and :meth:`interpolate` then
            gives the state there.  With "onestep" the first call takes the direction of time from it.
        method
            "onestep" takes one step.
        tstop
            No step goes past this time [s]; one ends there exactly.

        Returns
        -------
        Status
            ``event`` after a terminal event, with the state at it; the next call steps on from there.
        """
        with self._alone():
            if method == "onestep" and t is None and tstop is None and self._goes_onward():
                self._message = ""
                return Status.success
            return self._step(t, method, tstop)

    def _goes_onward(self) -> bool:
        """Try to take one step inside the compiled loops without building a State; False if it needs :meth:`_step`."""
        with self._settling:
            integrator = self._integrator
            if integrator is None or self._engine is None:
                return False
            if self._onward is None or not self._onward.goes_on(integrator):
                stepper = stepper_of(self._engine, integrator, self.options.control, self.events)
                self._onward = onward(stepper, integrator)
            return self._onward is not None and self._onward.step()

    def _step(self, t: float | None, method: str, tstop: float | None) -> Status:
        with timed(None) as clock:
            integrator = self._current()
            self._onward = None
            goal = make_goal(t, method, tstop, integrator)
            self._engine = self._engine or self._rebuild(integrator)
            clock.work = self._engine.work
            self._integrator, status = take(
                stepper_of(self._engine, integrator, self.options.control, self.events), integrator, goal
            )
            self._message = self._integrator.message
            self._engine.loops.raise_noted()  # an interrupt in a step that was made
        return status

    def interpolate(self, t: Any) -> DenseOutput:
        """q and v at ``t`` [s] (scalar or (k,)) within the last step; after the change where an event changed the state."""
        return self._current().last(t)

    @property
    def state(self) -> State:
        """State after the last step taken by hand; immutable."""
        return self._current().state

    @property
    def occurrences(self) -> tuple[Occurrence, ...]:
        """Events found by the last :meth:`step` call, in order of time."""
        return self._current().occurrences

    @property
    def message(self) -> str:
        """Message of the last :meth:`init_step` or :meth:`step`: a projection, an event, or the cause of a failure."""
        return self._message

    @property
    def counters(self) -> Counters:
        """Work done by stepping by hand since :meth:`init_step`, including work before a checkpoint."""
        if self._engine is not None and self._integrator is not None:
            self._current()
            return self._engine.work.counters()
        return Counters() if self._integrator is None else _work_of(self._integrator).counters()

    def checkpoint(self) -> bytes:
        """Serialise the progress of stepping by hand, for :meth:`resume` in another process.

        System and options are not saved, only a fingerprint of the system with its parameter values and the options as text.
        A NumpySystem has no fingerprint, since its functions hide their numbers, nor has a System with a function in a
        field; for these the caller must see to it that the system is the same.
        """
        return pack(self._saved(), setup_of(self.system, self.options, self.events))

    def resume(self, data: bytes) -> None:
        """Continue from a :meth:`checkpoint` with the same system, options and events; results agree bit for bit.

        Raises
        ------
        ProblemError, TypeError
            The bytes are no checkpoint, damaged, of another version, of another system or solver, or no legal state.
        """
        setup = setup_of(self.system, self.options, self.events)
        integrator = unpack(data, setup)
        if why := named(self.system)[1]:
            text = "which has no fingerprint: that it is the checkpoint's system, with the same numbers, is not checked."
            warnings.warn(f"the system {why}, {text}", UserWarning, stacklevel=2)
        with self._alone(), timed(None):
            try:
                engine = self._rebuild(integrator)
            except (ArithmeticError, LookupError, TypeError, ValueError) as error:
                raise ProblemError(f"the checkpoint does not fit this system, whose functions fail: {error}") from error
            check(integrator, engine, len(self.events))
            self._integrator, self._engine, self._message = integrator, engine, integrator.message
            self._onward = None

    def restart(self, state: State, *, step: float | None = None) -> None:
        """Continue from ``state``, an earlier or a saved one, with a constant ``step`` [s] or the step control in use."""
        if not isinstance(state, State):
            raise TypeError(f"restart takes a State (HHT.state); got {type(state).__name__}.")
        old = None if self._integrator is None else self._current()
        if old is not None and state.q.shape != old.state.q.shape:
            raise ProblemError(f"restart takes a State with q of shape {old.state.q.shape}; got {state.q.shape}.")
        h = (old.step if old else None) if step is None else real_number("step", step, unit=" [s]")
        if h == 0.0 or (h is None and (old is None or old.tolerances is None)):
            raise ProblemError("restart needs a step [s] other than zero; give step=h.")
        with self._alone(), timed(None):
            place = PhasePoint(state.t, state.q, state.v) if old is None else old.place
            integrator = begun(place, state, h, old.tolerances if old and h is None else None, len(self.events))
            self._integrator = (
                integrator
                if old is None
                else replace(integrator, fell_back=old.fell_back, tally=old.tally, output=old.output)
            )
            self._onward = None

    def _rebuild(self, integrator: IntegratorState) -> Engine:
        """Build the engine again for a saved state, as it was at the first step, without computing a start."""
        work, controlled = _work_of(integrator), integrator.tolerances is not None
        engine = make_engine(self.system, self.options, integrator.place, work, controlled=controlled)
        if integrator.fell_back:
            engine.fall_back()
        return engine

    def _current(self) -> IntegratorState:
        if self._integrator is None:
            raise ProblemError("there is no state to step from; call init_step(t0, q0, v0, step=h) first.")
        with self._settling:
            if self._onward is not None:
                self._integrator = self._onward.settled(self._integrator)
            return self._integrator

    def _saved(self) -> IntegratorState:
        """The integrator state completed by the engine's counters and fallback, so that another engine can continue."""
        now, engine = replace(self._current(), message=self._message), self._engine
        if engine is None:
            return now
        tally, output = Counter(engine.work.tally), Counter(engine.work.output)
        return replace(now, fell_back=engine.fell_back, tally=tally, output=output)

    def __getstate__(self) -> dict[str, Any]:
        saved = {**self.__dict__, "_integrator": self._integrator and self._saved()}
        return {name: value for name, value in saved.items() if name not in NOT_SAVED}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__dict__.update(saved, _engine=None, _onward=None)
        self._locks()

    def _locks(self) -> None:
        self._solving = threading.Lock()
        self._settling = threading.RLock()  # another thread may read the state while this one steps

    def _alone(self) -> threading.Lock:
        """The lock that allows one solve at a time; raises at once if it is taken.

        Taken by ``with`` alone, since an interrupt may come at any line.
        """
        if self._solving.locked():
            where = "in another thread, or a call from its own callback"
            raise RuntimeError(f"this HHT object is already solving ({where}); make one per use.")
        return self._solving


def refused(system: System | NumpySystem, options: Any) -> str | None:
    """Reason why ``options`` cannot be used with ``system``; None if they can."""
    if not getattr(options, "extrapolate_reaction", False):
        return None
    names = not_extrapolated(system)
    if not names:
        return None
    return (
        "extrapolate_reaction takes position constraints with the reactions -g_q^T lam (H55); "
        f"{type(system).__name__} declares {' and '.join(names)}"
    )


def _work_of(integrator: IntegratorState) -> Work:
    """Work counters as they stood at a saved state."""
    return Work(tally=defaultdict(int, integrator.tally), output=defaultdict(int, integrator.output))
