"""``Engine``: steps of one method for one system, seen from Python: a state in, a state after many steps out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Dynamics, compile_function
from hhtbench.lowering.dynamics.foreign import Callbacks
from hhtbench.lowering.dynamics.mass import Diagonal
from hhtbench.protocol import DERIVATIVES, declared
from solvers._finite import explain_nonfinite, inverse_mass_at
from solvers._start import of_dynamics, points_of
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.formulas import EPS
from solvers.hht.events.event import Event
from solvers.hht.loops import memory as mem
from solvers.hht.run.functions import Functions, MachineCode
from solvers.hht.run.history import columns
from solvers.hht.run.loops import Codes, Loops
from solvers.hht.run.march import Control, march, take, try_step
from solvers.hht.run.recover import recovered
from solvers.hht.step.state import State

ATTEMPTED = (mem.ATTEMPT, mem.X, mem.END, mem.END_INVERSE_MASS, mem.STEP)  # sections that hold an attempt


class Engine:
    """Steps of one method for one system.

    Beside the loops' memory it keeps that declared derivatives were given up, for good, and counts what is evaluated.

    Parameters
    ----------
    fallback
        () -> functions with every declared derivative derived afresh; None where none is declared.
    plain
        Run the loops as plain Python: for debugging, and to compare with.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        method: Method,
        work: Work,
        functions: Functions,
        *,
        fallback: Callable[[], Functions] | None = None,
        plain: bool = False,
    ) -> None:
        self.dynamics, self.method, self.work = dynamics, method, work
        self.structure, self.points = dynamics.structure, points_of(dynamics)  # evaluations per call
        self.functions, self.layout = functions, functions.layout
        self._bare_force = compile_function(force_and_inverse_mass, dynamics)
        self._force = work.counted(self._bare_force, residuals=self.points)
        self.acceleration = of_dynamics(dynamics).acceleration
        self._fallback, self.plain = fallback, plain
        self.distrusts = False  #: whether the declared derivatives were given up
        self._loops: Loops | None = None
        self._events: tuple[Event, ...] = ()
        self._stopped: tuple[State, int] | None = None  #: the state after which no step was made, and how that ended
        self._not_suspect: State | None = None  #: a state from which derived derivatives have failed too

    @property
    def reusable(self) -> bool:
        """Whether another run may take this engine: nothing but :meth:`again` ties it to this one."""
        return self.runs_alone and not self.fallible and not self.distrusts

    def again(self, work: Work) -> Engine:
        """This engine for another run, as if it were new."""
        self.work, self._stopped, self._not_suspect = work, None, None
        self._force = work.counted(self._bare_force, residuals=self.points)
        if self._loops is not None:
            self._loops.again(work)
        return self

    @property
    def loops(self) -> Loops:
        """Made when they are first needed."""
        if self._loops is None:
            self._loops = Loops(self, self._events)
        return self._loops

    @property
    def why(self) -> str:
        """How the steps are made."""
        kind = "machine code" if isinstance(self.functions, MachineCode) else "functions in Python"
        return f"{'plain Python' if self.plain else 'compiled'} loops, {kind}, {self.functions.analysis.kind} matrix"

    @property
    def fallible(self) -> bool:
        """Whether a failure of Newton's iteration may be that of declared derivatives."""
        return self._fallback is not None

    @property
    def runs_alone(self) -> bool:
        """Whether steps are machine code that calls no function of the system in Python."""
        return isinstance(self.functions, MachineCode) and self.functions.callbacks is None and not self.plain

    def force(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Any]:
        """f = M^-1 F (n,) and the inverse mass (n, n) or None where it is constant, (H2).

        Raises
        ------
        NonFiniteValue
            F or M holds NaN or infinity.
        """
        n = self.structure.n
        packed = self._force(t, q, v)
        if not np.isfinite(packed).all():
            explain_nonfinite(self.dynamics, t, q, v)
        if self.structure.mass == "variable":
            inverse = packed[n:].reshape(n, n)
            return inverse @ packed[:n], inverse
        inverse = self.dynamics.inverse_mass
        if isinstance(inverse, Diagonal):
            return np.asarray(inverse.values) * packed, None
        return (packed if inverse is None else np.asarray(inverse) @ packed), None

    def with_multipliers(self, state: State) -> State:
        """``state`` with multipliers of the acceleration level: those of a very short last step are roundoff over h^2."""
        if not self.structure.constrained:
            return state
        found = self.acceleration.solve(state.t, state.q, state.v, state.lam, state.mu)
        self.work.add("residual_evaluations", self.points)
        return state if not found.converged else replace(state, lam=found.lam, mu=found.mu, vdot=found.vdot)

    def watch(self, events: tuple[Event, ...]) -> None:
        """Look at the functions of ``events`` in every step."""
        if events != self._events:
            self._events, self._loops = events, None

    def march(
        self, state: State, control: Control, lengths: Vector, ends: Vector, rows: Matrix, values: Vector | None
    ) -> tuple[State, int, int]:
        """(the state after, how many steps were made, how it ended) of at most ``len(rows)`` steps.

        ``values``: of the event functions at ``state``; None where the motion begins there.
        """
        loops = self.loops
        loops.raise_noted()
        if self._stopped is not None and self._stopped[0] is state:  # after the steps of the last call
            made, ended = 0, self._stopped[1]
        else:
            self._load(state, values, controlled=control.controlled)
            made = loops.call_noting(march, control, lengths, ends, rows)
            if not made:
                loops.raise_noted()
            ended = int(loops.z.i[mem.ENDED])
            self.work.add("steps_accepted", made)
        self._stopped = None
        if made:
            state = loops.store(controlled=state.memory is not None)
            self._stopped = None if ended == mem.CONVERGED else (state, ended)
            return state, made, mem.CONVERGED
        if ended not in (mem.CONVERGED, mem.EVENT_FOUND):
            loops.held = None  # what a failed step leaves behind is not the state
        return state, made, self._unless_spent(ended)

    def _load(self, state: State, values: Vector | None, *, controlled: bool) -> None:
        suspicious = self.fallible and self._not_suspect is not state
        self.loops.load(state, values, controlled=controlled, suspicious=suspicious)

    def try_step(self, h: float, t1: float) -> int:
        """How a trial of a step of h [s] to t1 ended, from the state that is in the memory, with the last trial's matrix."""
        self.work.check_time()
        self.loops.held = None  # its factorisation gives way
        return self._unless_spent(self.loops.call(try_step, float(h), float(t1)))

    def _unless_spent(self, ended: int) -> int:
        if ended == mem.SPENT:
            raise BudgetSpent("evaluations", self.work.max_evaluations or 0)
        return ended

    def take(self, before: State, control: Control, values: Vector | None, *, located: bool) -> tuple[State, Vector]:
        """Accept the attempt from ``before`` with ``values`` of event functions: the state after it and its row.

        Of trials since then nothing stays but the one that ends where root location has ``located`` an event.
        """
        loops, row, controlled = self.loops, np.zeros((1, columns(self.structure))), before.memory is not None
        if loops.held is not before:
            attempt = self.attempted()
            self._load(before, values, controlled=controlled)
            self.put_back(attempt)
            if not located:  # the same bits again, with their matrix
                self.try_step(attempt[0][mem.H_TRIED], attempt[0][mem.T_END])
        loops.held = None  # until it is stored: what a callback raises in here leaves neither state behind
        loops.call(take, control, row, located)
        self.work.add("steps_accepted")
        return loops.store(controlled=controlled), row[0]

    def attempted(self) -> tuple[Vector, ...]:
        """Copies of what the memory holds of the attempt: numbers, unknowns, end, inverse mass."""
        return tuple(self.loops.section(name).copy() for name in ATTEMPTED)

    def put_back(self, attempt: tuple[Vector, ...]) -> None:
        """Make ``attempt``, of the same state, the one that the memory holds."""
        for name, values in zip(ATTEMPTED, attempt, strict=True):
            self.loops.section(name)[:] = values

    def give_up_derivatives(self, state: State) -> bool:
        """Whether the step that was tried last is made without the declared derivatives, which then are given up."""
        if self._fallback is None:
            return False
        declared_ones = self.functions, self._fallback, self._loops
        h, t1 = self.loops.section(mem.ATTEMPT)[[mem.H_TRIED, mem.T_END]].tolist()
        names, controlled = self.distrust(), state.memory is not None
        self.loops.load(replace(state, factorised=None), None, controlled=controlled, suspicious=False)
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
        self.functions, self._fallback, self._loops = declared_ones
        self.distrusts, self._not_suspect = False, state
        return False

    def distrust(self) -> str:
        """Give up the declared derivatives in Newton's matrix for derived ones; returns their names."""
        if self._fallback is None:
            return ""
        self.functions = self._fallback()
        self._fallback, self._loops, self.distrusts = None, None, True
        system = self.functions.dynamics.system
        return ", ".join(name for name in DERIVATIVES if declared(system, name) is not None)

    def recovered(self, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
        """Which rows (k,) got their multipliers from the acceleration level, (H16), in ``lam`` and ``mu``."""
        if not isinstance(self.functions, MachineCode) or self.plain:
            return np.zeros(times.size, dtype=bool)
        done = recovered(self.functions, self.loops.callbacks, self.work, self.points, (times, q, v, lam, mu))
        self.loops.raise_noted()
        return done

    def explain(self, state: State, t1: float) -> NonFiniteValue | None:
        """The value that was not finite in a step from ``state``, looked for near its end where machine code has met it."""
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
        """Raise what was noted in the last steps, since none follows; a spent budget has ended the steps already."""
        cause = self.loops.callbacks.take_cause()
        if cause is not None and not isinstance(cause, BudgetSpent):
            raise cause

    def rare(self, callbacks: Callbacks) -> Codes:
        """What the loops ask Python for, seldom: the acceleration level, and steps shorter than roundoff."""
        s = self.structure
        n, m, p = s.n, s.m, s.p
        inverse = n * n if s.mass == "variable" else 0
        level = callbacks.entry(self._acceleration_level, 1 + n + m + p, ((), (n,), (n,), (m,), (p,)))
        shortest = callbacks.entry(self._shortest, 1 + 5 * n + m + p + inverse, ((6 + 5 * n + m + p,), (2,)))
        return {"acceleration": (level, 0), "shortest": (shortest, 0)}

    def _acceleration_level(self, t: float, q: Vector, v: Vector, lam: Vector, mu: Vector) -> Vector:
        """[1 where it is determined, else 0; lam (m,), mu (p,), v' (n,)], (H16)."""
        found = self.acceleration.solve(t, q, v, lam, mu)
        return np.concatenate([[found.converged], found.lam, found.mu, found.vdot])

    def _shortest(self, state: Vector, step: Vector) -> Any:
        """(H21): [1; q, v, a, f, lam, mu, v', M^-1] at the end of a ``step`` [h, t1] from ``state``; zero without one.

        q and v move along v and the acceleration, if both levels hold as before: a drive may start from rest.
        """
        s, h, t1 = self.structure, *step
        t, _, size_q, size_v = state[:4]
        _, q, v, _, _, lam, mu, _ = np.split(state, [6, *(6 + np.cumsum([s.n, s.n, s.n, s.n, s.m, s.p]))])
        found = self.acceleration.solve(t, q, v, lam, mu)
        q1, v1 = q + h * v, v + h * found.vdot
        if not found.converged or not _levels_hold(self.dynamics, (t, q, v), (t1, q1, v1), size_q, size_v):
            return 0.0
        f1, inverse = self.force(t1, q1, v1)
        end = [[1.0], q1, v1, f1, f1, found.lam, found.mu, found.vdot]
        return np.concatenate([*end, np.zeros(0) if inverse is None else inverse.ravel()])


def _levels_hold(dynamics: Dynamics, start: tuple[Any, ...], end: tuple[Any, ...], size_q: float, size_v: float) -> bool:
    """Whether neither constraint level is further from zero at the ``end`` (t, q, v) than at the ``start``."""
    levels = ConstraintLevels(dynamics)
    before, after = levels.at(*start), levels.at(*end)
    room = 8 * EPS * np.abs(after.position_jacobian).sum(axis=1) * size_q
    velocity_room = 8 * EPS * np.abs(after.rows).sum(axis=1) * max(size_v, float(np.abs(end[2]).max()))
    return bool(
        np.all(np.abs(after.position) <= np.abs(before.position) + room)
        and np.all(np.abs(after.velocity_drift) <= np.abs(before.velocity_drift) + velocity_room)
    )


def force_and_inverse_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """F (n,) and, where the mass varies, M^-1 (n*n,), packed into one vector."""
    force = dynamics.force(t, q, v)
    if dynamics.structure.mass != "variable":
        return force
    return dynamics.xp.concatenate([force, inverse_mass_at(dynamics, t, q).ravel()])
