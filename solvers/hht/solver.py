"""``HHT``: the integrator's own face."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from hhtbench.arguments import check_interval, real_number, real_vector
from hhtbench.counting import Work
from hhtbench.errors import ProblemError
from hhtbench.protocol import NumpySystem, System
from hhtbench.request import check_output_times, make_request, plan_steps
from hhtbench.result import Solution
from solvers._start import Guesses, Place
from solvers.hht.begin import Started, begin
from solvers.hht.by_hand import ByHand
from solvers.hht.choose import KINDS
from solvers.hht.coefficients import Method, make_method
from solvers.hht.control import RULES, make_control
from solvers.hht.engine import HostEngine
from solvers.hht.engines import ENGINES
from solvers.hht.events import make_events
from solvers.hht.run import Run, check_accuracy
from solvers.hht.stepping import Standing


class HHT(ByHand):
    """The extended HHT-alpha method (Jay and Negrut, ETNA 26, 2007) for one system; THEORY.md states the formulas.

    Forces are seen at the ends of steps only: a step may pass over a shorter interval in which they jump or are not
    finite.

    Parameters
    ----------
    system
        A :class:`~hhtbench.protocol.System` or :class:`~hhtbench.protocol.NumpySystem`.
    alpha
        Damping parameter in [-1/3, 0]; 0 keeps the energy of fast vibrations, -1/3 damps them most.  Default -0.05.
    rho_inf
        Instead of alpha: what a step leaves of the fastest vibrations, (1 + alpha)/(1 - alpha) in [1/2, 1].
    b
        Weight of the end reaction in the position, not 1/2.
    reaction
        Where the end reaction is taken: "implicit", "predictor", "midpoint" or "midpoint_predictor" (b = 0).
    rescale_a
        Adapt the auxiliary acceleration when the step changes; without it variable steps are of order one.
    start
        Auxiliary acceleration of the first step: "f0", "shifted" or "trapezoidal"; None takes "f0" for prescribed steps
        and "trapezoidal" under error control, whose first step would be short otherwise.
    first_step, min_step, max_step
        Bounds of the step under error control [s], positive also where time runs backward.
    control
        "error", or "chrono": double after five easy steps, halve where Newton has failed, whatever the error.
    linsolver
        "auto" picks by size and measured fill among "dense" (LAPACK), "band" (after reverse Cuthill-McKee) and "sparse"
        (SuperLU).
    engine
        "native" makes the steps in compiled loops with machine code of the system's functions, "host" in Python, whatever
        the system; "auto" takes native where it can.  Same formulas, same statuses, values equal to roundoff.
    calc_initcond
        Project an inconsistent start onto both constraint levels instead of refusing it.
    events
        :class:`~solvers.hht.events.Event` or plain callables ``(t, q, v)``, one or a list; without them nothing is looked
        for.  Times and states are in ``Solution.t_events``, ``q_events`` and ``v_events``, one entry per event.  Where an
        event changes the state the solution has two rows with one time, before and after; dense output gives the state
        after the change there, ``q_events`` and ``v_events`` the one before.

    Raises
    ------
    ProblemError, TypeError
        An option is out of range or unknown; the text says what was expected.
    """

    def __init__(
        self,
        system: System | NumpySystem,
        *,
        alpha: float | None = None,
        rho_inf: float | None = None,
        b: float = 0.0,
        reaction: str = "implicit",
        rescale_a: bool = True,
        start: str | None = None,
        first_step: float | None = None,
        min_step: float | None = None,
        max_step: float | None = None,
        control: str = "error",
        linsolver: str = "auto",
        engine: str = "auto",
        calc_initcond: bool = False,
        events: Any = None,
    ) -> None:
        if not isinstance(system, (System, NumpySystem)):
            raise TypeError(f"system must be a System or a NumpySystem; got {type(system).__name__}.")
        self.system = system
        self.method = make_method(
            alpha=alpha, rho_inf=rho_inf, b=b, reaction=reaction, rescale_a=rescale_a, start="f0" if start is None else start
        )
        self._default_start = start is None
        self.control = make_control(first_step=first_step, min_step=min_step, max_step=max_step)
        if control not in RULES:
            raise ProblemError(f"control must be one of {', '.join(RULES)}; got {control!r}.")
        self.rule = control
        if linsolver not in KINDS:
            raise ProblemError(f"linsolver must be one of {', '.join(KINDS)}; got {linsolver!r}.")
        self.linsolver = linsolver
        if engine not in ENGINES:
            raise ProblemError(f"engine must be one of {', '.join(ENGINES)}; got {engine!r}.")
        self.engine = engine
        self.engine_used = ""  #: by the last run: "native", or "host" and why
        if not isinstance(calc_initcond, bool):
            raise TypeError(f"calc_initcond must be True or False; got {calc_initcond!r}.")
        self.calc_initcond = calc_initcond
        self.events = make_events(events)
        self._standing: Standing | None = None  # of stepping by hand
        self._engine: HostEngine | None = None
        self._message = ""
        self._busy = threading.Lock()

    def solve(
        self, tspan: Any, q0: Any, v0: Any, *, lam_guess: Any = None, mu_guess: Any = None, **request: Any
    ) -> Solution:
        """Integrate over ``tspan = (t0, t1)`` [s] from ``q0, v0`` (n,) with prescribed steps or error control.

        ``lam_guess`` (m,) and ``mu_guess`` (p,) pick the root where the reaction is nonlinear.  The other keywords
        are those of :class:`~hhtbench.request.Request`: ``step`` or ``steps``, or ``rtol`` and ``atol``, which is a
        number, or (n,) for q and v alike, or (2n,); None takes ``rtol`` times what is typical of the start.

        Returns
        -------
        Solution
            With a :class:`~hhtbench.result.Status`; numerical failures keep the accepted steps.  An exception of
            the system's own functions is raised again as it is, with ``.partial_solution``.
        """
        began = time.perf_counter()
        asked = make_request(**request)
        if asked.options:
            raise TypeError(f"HHT takes its options when it is made: HHT(system, alpha=...); got options={asked.options}.")
        tspan = real_vector("tspan", tspan) if isinstance(tspan, jax.Array) else tspan
        if not isinstance(tspan, (tuple, list, np.ndarray)) or len(tspan) != 2:
            raise ProblemError(f"tspan must be two times (t0, t1) [s]; got {tspan!r}.")
        t0, t1 = (real_number(f"tspan[{i}]", t, unit=" [s]") for i, t in enumerate(tspan))
        place, guesses = self._start_values(t0, q0, v0, lam_guess, mu_guess)
        check_accuracy(asked, place.q.size)
        if asked.t_eval is not None:
            check_output_times(asked.t_eval, t0, t1)
        check_interval("tspan", t0, t1)
        if asked.fixed:
            plan_steps(asked, t0, t1)
        with self._alone(asked.max_seconds, began) as clock:
            return Run(self, asked, t1, place, guesses, clock).solution()

    def begin(self, place: Place, guesses: Guesses, h: float, work: Work, *, controlled: bool = False) -> Started:
        """The engine and its first state; ``h`` [s] is the first step, or the direction of time."""
        method = self.first_method(controlled=controlled)
        options = {"calc_initcond": self.calc_initcond, "linsolver": self.linsolver, "engine": self.engine}
        started = begin(self.system, method, place, guesses, h, work, **options)  # type: ignore[arg-type]
        self.engine_used = "" if started.engine is None else started.engine.why
        return started

    def first_method(self, *, controlled: bool) -> Method:
        """The method with the auxiliary acceleration of its first step: under error control the default differs."""
        return replace(self.method, start="trapezoidal") if controlled and self._default_start else self.method

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_busy", "_engine")}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        self.__dict__.update(saved, _busy=threading.Lock(), _engine=None)
