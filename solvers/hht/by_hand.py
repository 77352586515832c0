"""The stepwise half of ``HHT``: start, step, interpolate, save, resume."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import replace
from typing import Any

from hhtbench.arguments import real_number, real_vector
from hhtbench.counting import Clock, Work, timed
from hhtbench.errors import ProblemError
from hhtbench.lowering.compile.fingerprint import NoFingerprint, fingerprint
from hhtbench.protocol import NumpySystem, System
from hhtbench.request import make_request
from hhtbench.result import Counters, DenseOutput, Status
from solvers._start import Guesses, Place
from solvers.hht.begin import Started
from solvers.hht.checkpoint import pack, unpack
from solvers.hht.coefficients import Method
from solvers.hht.control import ControlOptions
from solvers.hht.engine import HostEngine
from solvers.hht.engines import make_engine
from solvers.hht.error import make_tolerances
from solvers.hht.events import Event, Occurrence
from solvers.hht.legal_state import check, check_factor
from solvers.hht.run import check_accuracy, controlled_course
from solvers.hht.state import State
from solvers.hht.stepping import Constant, Standing, begun, make_goal, take
from solvers.hht.watch import Course


class ByHand:
    """Stepping by hand, as SUNDIALS offers it.  It holds one frozen :class:`~solvers.hht.stepping.Standing`."""

    system: System | NumpySystem
    method: Method
    control: ControlOptions
    rule: str
    linsolver: str
    engine: str
    events: tuple[Event, ...]
    _standing: Standing | None
    _engine: HostEngine | None
    _message: str
    _busy: Any

    def begin(self, place: Place, guesses: Guesses, h: float, work: Work, *, controlled: bool = False) -> Started:
        """The engine and its first state."""
        raise NotImplementedError

    def first_method(self, *, controlled: bool) -> Method:
        """The method with the first step's start."""
        raise NotImplementedError

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
    ) -> Status:
        """Prepare stepping by hand with a constant signed ``step`` [s], or with tolerances as in :meth:`solve`.

        Returns the status of the start; :attr:`message` says more.
        """
        place, guesses = self._start_values(real_number("t0", t0, unit=" [s]"), q0, v0, lam_guess, mu_guess)
        h = None if step is None else real_number("step", step, unit=" [s]")
        if h == 0.0:
            raise ProblemError("step must not be zero.")
        asked = make_request(step=None if h is None else abs(h), rtol=rtol, atol=atol)
        check_accuracy(asked, place.q.size)
        with self._alone():
            started = self.begin(place, guesses, h or self.control.first_step, Work(), controlled=h is None)
            self._engine, self._standing = started.engine, None
            self._message = started.failure.message if started.failure else started.note
            if started.engine is not None and started.state is not None:
                tolerances = None if h is not None else make_tolerances(asked.rtol, asked.atol, started.state)
                standing = begun(place, started.state, h, tolerances, len(self.events))
                self._standing = replace(standing, tally=Counter(started.engine.work.tally))
        return started.failure.status if started.failure else Status.success

    def step(self, t: float | None = None, method: str = "onestep", tstop: float | None = None) -> Status:
        """Step on from :attr:`state` as CVODE and IDA do; on a failure the state stays and the status says why.

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
            ``event`` after a terminal event, with the state at it; a further call goes on from there.
        """
        with self._alone():
            standing = self._stands()
            goal = make_goal(t, method, tstop, standing)
            self._engine = self._engine or self._rebuild(standing)
            standing, status = take(self._course(self._engine, standing), standing, goal)
            tally = Counter(self._engine.work.tally)
            self._standing = replace(standing, distrusts=self._engine.distrusts, tally=tally)
            self._message = standing.message
        return status

    def interpolate(self, t: Any) -> DenseOutput:
        """q and v at ``t`` [s] (scalar or (k,)) within the last step; at an event that changed the state: after it."""
        return self._stands().last(t)

    @property
    def state(self) -> State:
        """The frozen state after the last step taken by hand."""
        return self._stands().state

    @property
    def occurrences(self) -> tuple[Occurrence, ...]:
        """The events of the last :meth:`step` call, in order of time."""
        return self._stands().occurrences

    @property
    def message(self) -> str:
        """What the last :meth:`init_step` or :meth:`step` had to say: a projection, an event, or the cause of a failure."""
        return self._message

    @property
    def counters(self) -> Counters:
        """Work done by stepping by hand since :meth:`init_step`, that before a checkpoint included."""
        if self._engine is not None:
            return self._engine.work.counters()
        counted: dict[str, Any] = {} if self._standing is None else dict(self._standing.tally)
        return Counters(**counted)

    def checkpoint(self) -> bytes:
        """Where stepping by hand stands, for :meth:`resume` in another process.

        Neither system nor options are in it, only a fingerprint of the system with its parameter values, and the options'
        text.  A NumpySystem has none, as its functions hide their numbers, nor has a System with a function in a field:
        that it is the same is up to you.
        """
        return pack(replace(self._stands(), message=self._message), self._setup())

    def resume(self, data: bytes) -> None:
        """Step on from a :meth:`checkpoint` of a solver with the same system, options and events, to the same bits.

        Raises
        ------
        ProblemError, TypeError
            The bytes are no checkpoint, damaged, of another version, of another system or solver, or no legal state.
        """
        setup = self._setup()
        standing = unpack(data, setup)
        if setup["fingerprint"] is None:
            text = f"the system {self._named()[1]}, which has no fingerprint: that it is the checkpoint's system, with the"
            warnings.warn(f"{text} same numbers, is not checked.", UserWarning, stacklevel=2)
        with self._alone():
            try:
                engine = self._rebuild(standing)
            except (ArithmeticError, LookupError, TypeError, ValueError) as error:
                raise ProblemError(f"the checkpoint does not fit this system, whose functions fail: {error}") from error
            check(standing, engine, len(self.events))
            if standing.state.factor is not None:
                check_factor(standing.state, self._rebuild(standing))  # an engine of its own: the trial leaves no trace
            self._standing, self._engine, self._message = standing, engine, standing.message

    def restart(self, state: State, *, step: float | None = None) -> None:
        """Step on from ``state``, an earlier one or one that was saved, with ``step`` [s] or the step control in use."""
        if not isinstance(state, State):
            raise TypeError(f"restart takes a State (HHT.state); got {type(state).__name__}.")
        old = self._standing
        if old is not None and state.q.shape != old.state.q.shape:
            raise ProblemError(f"restart takes a State with q of shape {old.state.q.shape}; got {state.q.shape}.")
        h = (old.step if old else None) if step is None else real_number("step", step, unit=" [s]")
        if h == 0.0 or (h is None and (old is None or old.tolerances is None)):
            raise ProblemError("restart needs a step [s] other than zero; give step=h.")
        with self._alone():
            place = Place(state.t, state.q, state.v) if old is None else old.place
            standing = begun(place, state, h, old.tolerances if old and h is None else None, len(self.events))
            self._standing = standing if old is None else replace(standing, distrusts=old.distrusts, tally=old.tally)

    def _rebuild(self, standing: Standing) -> HostEngine:
        """The engine of the first step again, for a state that was saved; no start is computed again."""
        method = self.first_method(controlled=standing.tolerances is not None)
        work = Work(tally=Counter(standing.tally))
        engine = make_engine(self.system, method, standing.place, work, linsolver=self.linsolver, engine=self.engine)
        if standing.distrusts:
            engine.distrust()
        return engine

    def _course(self, engine: HostEngine, standing: Standing) -> Course:
        if standing.step is not None:
            return Course(engine=engine, advance=Constant(engine, standing.step), events=self.events)
        if standing.tolerances is None:
            raise ValueError("neither a step nor tolerances.")
        return controlled_course(engine, standing.tolerances, self.control, self.rule, self.events)

    def _setup(self) -> dict[str, Any]:
        """What a checkpoint and the solver that resumes it must share, as texts."""
        options = {name: str(getattr(self, name)) for name in ("method", "control", "rule", "linsolver", "engine")}
        events = ", ".join(event.name for event in self.events)
        return {"system": type(self.system).__name__, "fingerprint": self._named()[0], **options, "events": events}

    def _named(self) -> tuple[str | None, str]:
        """The system's fingerprint; None where it has none, and then why."""
        try:
            return fingerprint(self.system), ""
        except NoFingerprint as error:
            return None, str(error)

    def _stands(self) -> Standing:
        if self._standing is None:
            raise ProblemError("there is no state to step from; call init_step(t0, q0, v0, step=h) first.")
        return self._standing

    def _start_values(self, t0: float, q0: Any, v0: Any, lam_guess: Any, mu_guess: Any) -> tuple[Place, Guesses]:
        q = real_vector("q0", q0)
        if q.size == 0:
            raise ProblemError("q0 must hold at least one coordinate; got shape (0,).")
        v = real_vector("v0", v0, q.size)
        lam = None if lam_guess is None else real_vector("lam_guess", lam_guess)
        mu = None if mu_guess is None else real_vector("mu_guess", mu_guess)
        return Place(t0, q, v), (lam, mu)

    def _alone(self, max_seconds: float | None = None, began: float | None = None) -> _Alone:
        return _Alone(self._busy, max_seconds, began)


class _Alone(timed):
    """Holds the lock of one HHT object, with the clock of what it does."""

    def __init__(self, busy: Any, max_seconds: float | None, began: float | None) -> None:
        super().__init__(max_seconds, began)
        self.busy = busy

    def __enter__(self) -> Clock:
        if not self.busy.acquire(blocking=False):
            where = "in another thread, or a call from its own callback"
            raise RuntimeError(f"this HHT object is already solving ({where}); make one per use.")
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self.busy.release()
