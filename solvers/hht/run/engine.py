"""``Engine``: Python's interface to the compiled steps of one method for one system."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, compile_function, derive
from hhtbench.lowering.dynamics.mass import plain_mass
from hhtbench.lowering.dynamics.matrix_free import VariableMass
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System, declared
from hhtbench.solution.counting import Work
from solvers._finite import explain_nonfinite
from solvers._start import Guesses, PhasePoint, of_dynamics, points_of, usable
from solvers.hht.control.first_step import plan_first_step
from solvers.hht.control.plan import Plan
from solvers.hht.options import HHTOptions
from solvers.hht.run.functions import MachineCode, functions_for
from solvers.hht.run.history import row_layout
from solvers.hht.run.loops import Loops
from solvers.hht.run.march import march, take, try_step
from solvers.hht.step.state import State
from solvers.kernel import memory as mem
from solvers.kernel.full import force_and_inverse_mass, force_over_mass

ATTEMPTED = (mem.ATTEMPT, mem.X, mem.END, mem.END_INVERSE_MASS, mem.STEP)  # memory sections of an attempt
SHIFTED = ("shifted", "corrected")  # starts whose a0 is evaluated at another time


class NotTaken(ProblemError):
    """Options that do not fit a system, as only its derived dynamics show; the bench then declines the problem."""


def not_extrapolated(system: System | NumpySystem) -> list[str]:
    """Names of declared functions of ``system`` whose reactions (H55) cannot extrapolate."""
    return [name for name in ("velocity_constraint", "reaction") if declared(system, name) is not None]


class Engine:
    """Steps of one method for one system.

    Beside the loops' memory it counts evaluations and remembers whether declared derivatives were replaced.
    """

    def __init__(self, dynamics: Dynamics, place: PhasePoint, work: Work, options: HHTOptions, *, controlled: bool) -> None:
        """``place``: start of the run; ``controlled``: under error control."""
        self.dynamics, self.place, self.work = dynamics, place, work
        self.method, self.control, self.linsolver = options.method(controlled=controlled), options.control, options.linsolver
        self._without = options.without
        self.functions = functions = functions_for(dynamics, self.method, self.linsolver)
        self.layout, self.points = functions.layout, points_of(dynamics)  # evaluations per call
        self.structure = self.layout.structure  #: structure that the steps use: the mass may be known by its entries
        self._applied = self.structure.m if self.layout.extrapolated else 0  # multipliers of (H55)
        if self.layout.extrapolated and self.structure.mass == "sparse":
            raise NotTaken(
                "extrapolate_reaction needs M^-1, which is full for this mass of few entries (H56). Take b = 1, or "
                'without="zeros", with full matrices.'
            )
        source = functions.dynamics if isinstance(functions.dynamics, VariableMass) else dynamics
        force = force_over_mass if self.structure.mass == "sparse" else force_and_inverse_mass
        self.bare_force = compile_function(force, source)  #: not counted
        known = of_dynamics(dynamics)
        self.acceleration, self.compared = known.acceleration, bool(known.compared)
        self.declared = known.declared  #: derivatives
        #: whether a failure of Newton's iteration may be due to declared derivatives
        self.fallible = bool(known.declared) and not (functions.newton.matrix_cost and functions.alone)
        self.plain = options.engine == "python"  #: the loops run as plain Python
        self._starts_alone = bool(functions.level_codes()) and self.method.start not in SHIFTED and plain_mass(dynamics)
        self.fell_back = False  #: whether the declared derivatives were replaced
        self._events: tuple[Event, ...] = ()
        self._stopped: tuple[State, int] | None = None  #: the state from which the next step failed, and the ending code
        self._failed_derived: State | None = None  #: a state from which derived derivatives failed too

    @property
    def reusable(self) -> bool:
        """True if another run may use this engine after :meth:`again`."""
        return not (self.plain or self.fell_back)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays kept between runs."""
        return self.loops.nbytes if "loops" in self.__dict__ else 0

    def again(self, place: PhasePoint, work: Work) -> Engine:
        """Reset this engine for another run from ``place``."""
        self.place, self.work, self._stopped, self._failed_derived = place, work, None, None
        if "loops" in self.__dict__:
            self.loops.again(work)
        return self

    @cached_property
    def loops(self) -> Loops:
        """The compiled loops, made on first use."""
        return Loops(self, self._events)

    @cached_property
    def why(self) -> str:
        """Text on how the steps are made: loops, functions, matrix."""
        kind = "machine code" if isinstance(self.functions, MachineCode) else "functions in Python"
        return f"{'plain Python' if self.plain else 'compiled'} loops, {kind}, {self.functions.analysis.kind} matrix"

    def force(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Any]:
        """f = M^-1 F (n,) and the inverse mass (n, n), or None where it is constant, (H2).

        Raises
        ------
        NonFiniteValue
            F or M holds NaN or infinity.
        """
        n = self.structure.n
        packed = self.work.counted(self.bare_force, residuals=self.points)(t, q, v)
        if not np.isfinite(packed).all():
            explain_nonfinite(self.dynamics, t, q, v)
        return packed[:n], packed[n:].reshape(n, n) if self.structure.mass == "variable" else None

    def applied(self, state: State) -> Vector:
        """M^-1 F (n,) at ``state``."""
        return self.force(state.t, state.q, state.v)[0] if self.method.total else state.f

    def near(self, t: float, q: Vector, v: Vector, found: Any) -> Vector:
        """Acceleration (n,) that ``a`` approximates: f, or v' if a includes reactions, with multipliers near ``found``."""
        if not self.method.total or not self.structure.constrained:
            return self.force(t, q, v)[0]
        self.work.add("residual_evaluations", self.points)
        there = self.acceleration.solve(t, q, v, found.lam, found.mu)
        return there.vdot if there.converged else found.vdot

    def with_multipliers(self, state: State) -> State:
        """``state`` with multipliers of the acceleration level, since those of a very short step are roundoff over h^2."""
        if not self.structure.constrained:
            return state
        found = self.acceleration.solve(state.t, state.q, state.v, state.lam, state.mu)
        self.work.add("residual_evaluations", self.points)
        return state if not found.converged else replace(state, lam=found.lam, mu=found.mu, vdot=found.vdot)

    def watch(self, events: tuple[Event, ...]) -> None:
        """Evaluate the functions of ``events`` in every step from now on."""
        if events != self._events:
            self._events = events
            self.__dict__.pop("loops", None)

    def march(
        self, state: State, plan: Plan, stop: float, lengths: Vector, ends: Vector, rows: Matrix, values: Vector | None
    ) -> tuple[State, int, int]:
        """Take at most ``len(rows)`` steps; returns (state after them, number of steps, ending code).

        ``values``: event functions at ``state``; None at the begin of a motion.
        """
        loops = self.loops
        loops.raise_noted()
        if self._stopped is not None and self._stopped[0] is state:  # after the steps of the last call
            made, ended = 0, self._stopped[1]
        else:
            self._load(state, values, controlled=plan.by_error is not None)
            loops.held = None  # until it is stored: an interrupt may come before
            made = loops.call_noting(march, stop, lengths, ends, rows)
            if not made:
                loops.raise_noted()
            ended = int(loops.z.i[mem.ENDED])
        self._stopped = None
        if made:
            state = loops.store(controlled=state.controlled)
            if ended != mem.CONVERGED:
                self._stopped = state, ended
            return state, made, mem.CONVERGED
        if ended in (mem.CONVERGED, mem.EVENT_FOUND):  # what a failed step leaves behind is not the state
            loops.held = state
        return state, made, self._unless_spent(ended)

    def started(self, place: PhasePoint, guesses: Guesses) -> State | None:
        """First state by machine code, if ``place`` is plainly a good start; None where full checks are needed."""
        work, count, s, (lam, mu) = self.work, self.points * (1 + self.structure.constrained), self.structure, guesses
        work.check_time()
        if not self._starts_alone or (work.max_evaluations is not None and work.max_evaluations < count):
            return None
        if (lam is not None and lam.size != s.m) or (mu is not None and mu.size != s.p):
            return None
        state = self.loops.start(place, guesses)
        if state is not None:
            work.tally["residual_evaluations"] += count
            if self.method.total:
                applied = state.lam[: self._applied]
                return state.but(a=state.vdot, f=state.vdot, lam_applied=applied, lam_before=applied)
        return state

    def prepared(self, state: State, stop: float) -> State:
        """``state`` with the quantities that step control needs to begin or restart there, (H27)."""
        if state.h is not None:  # stepping began without control: v' of a step belongs to its middle
            state = self.with_multipliers(state) if self.structure.constrained else replace(state, vdot=state.f)
        loops, start = self.loops, self.method.start
        loops.load(state, None, controlled=True, fallback=False)
        loops.held = None  # until it is stored
        loops.call(plan_first_step, stop, start == "f0")
        state = loops.store(controlled=True)
        if start != "shifted" or state.memory is None:
            return state
        shift = self.method.coefficients.alpha * math.copysign(state.memory.h_next, stop - state.t)
        a = self.force(state.t + shift, state.q + shift * state.v, state.v + shift * state.vdot)[0]  # (H12)
        return replace(state, a=a)

    def _load(self, state: State, values: Vector | None, *, controlled: bool) -> None:
        fallback = self.fallible and self._failed_derived is not state
        self.loops.load(state, values, controlled=controlled, fallback=fallback)

    def try_step(self, h: float, t1: float) -> int:
        """Attempt a step of h [s] to t1 from the state in memory, with the last trial's matrix; returns the ending code."""
        self.work.check_time()
        self.loops.held = None  # its factorisation gives way
        return self._unless_spent(self.loops.call(try_step, float(h), float(t1)))

    def _unless_spent(self, ended: int) -> int:
        if ended == mem.SPENT:
            raise BudgetSpent("evaluations", self.work.max_evaluations or 0)
        return ended

    def take(self, before: State, values: Vector | None, *, located: bool) -> tuple[State, Vector]:
        """Accept the attempt from ``before`` with ``values`` of event functions; returns the state after it and its row.

        ``located``: the attempt ends at an event found by root location; all other trials since are discarded.
        """
        loops, row, controlled = self.loops, np.zeros((1, row_layout(self.structure).columns)), before.controlled
        if loops.held is not before:
            attempt = self.attempted()
            self._load(before, values, controlled=controlled)
            self.put_back(attempt)
            if not located:  # the same bits again, with their matrix
                self.try_step(attempt[0][mem.H_TRIED], attempt[0][mem.T_END])
        loops.held = None  # until it is stored: what a callback raises in here leaves neither state behind
        loops.call(take, row, located)
        return loops.store(controlled=controlled), row[0]

    def attempted(self) -> tuple[Vector, ...]:
        """Copies of the attempt in memory: numbers, unknowns, end, inverse mass."""
        return tuple(self.loops.section(name).copy() for name in ATTEMPTED)

    def put_back(self, attempt: tuple[Vector, ...]) -> None:
        """Restore ``attempt``, from the same state, in memory."""
        for name, values in zip(ATTEMPTED, attempt, strict=True):
            self.loops.section(name)[:] = values

    def retry_without_declared(self, state: State) -> bool:
        """Retry the last step with derived instead of declared derivatives; True if it succeeds, and these are kept."""
        if not self.fallible:
            self._failed_derived = state
            return False
        declared_ones = self.functions, self.loops
        h, t1 = self.loops.section(mem.ATTEMPT)[[mem.H_TRIED, mem.T_END]].tolist()
        names, controlled = self.fall_back(), state.controlled
        self.loops.load(replace(state, factorised=None), None, controlled=controlled, fallback=False)
        ended = self.loops.call(try_step, h, t1)
        self.loops.held = None
        if ended == mem.CONVERGED:
            warnings.warn(
                f"Newton's iteration failed with the declared {names} and converged without; derived ones are used "
                "from here on. `hhtbench check` shows the wrong entries.",
                UserWarning,
                stacklevel=2,
            )
            return True
        self.functions, self.loops = declared_ones
        self.fallible, self.fell_back, self._failed_derived = True, False, state
        return False

    def fall_back(self) -> str:
        """Replace the declared derivatives in Newton's matrix by derived ones; returns their names."""
        if not self.fallible:
            return ""
        at = self.place
        derived = derive(self.dynamics.system, at.t, at.q, at.v, ignored=self.declared, without=self._without)
        self.functions = functions_for(usable(derived, at), self.method, self.linsolver)
        for name in ("loops", "why"):
            self.__dict__.pop(name, None)
        self.fallible, self.fell_back = False, True
        return ", ".join(self.declared)

    def explain(self, state: State, t1: float) -> NonFiniteValue | None:
        """The value that was not finite in a step from ``state``; searched near its end if machine code met it."""
        if self.loops.nonfinite is not None:
            return self.loops.nonfinite
        n, end = self.structure.n, self.loops.section(mem.END)
        q1, v1 = end[:n], end[n : 2 * n]
        if not np.isfinite(end[: 2 * n]).all():
            q1, v1 = state.q + (t1 - state.t) * state.v, state.v
        try:
            explain_nonfinite(self.dynamics, t1, q1, v1)
        except NonFiniteValue as error:
            return error
        return None

    def raise_left_over(self) -> None:
        """Raise an exception noted in the last steps of a run; a spent budget has ended it already."""
        cause = self.loops.callbacks.take_cause()
        if cause is not None and not isinstance(cause, BudgetSpent):
            raise cause
