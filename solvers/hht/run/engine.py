"""``Engine``: the loops of one method for one system, seen from Python: a state in, a state after many steps out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import AccelerationLevel, Dynamics, compile_function
from hhtbench.lowering.dynamics.diagonal import Diagonal
from hhtbench.lowering.dynamics.foreign import Callbacks
from hhtbench.protocol import DERIVATIVES, declared
from solvers._finite import explain_nonfinite, inverse_mass_at
from solvers._start import points_of
from solvers.hht.equations.coefficients import Method
from solvers.hht.events.compiled import EventFunctions
from solvers.hht.loops import memory as mem
from solvers.hht.loops.memory import Memory, integer_view, view
from solvers.hht.run.functions import Functions, MachineCode
from solvers.hht.run.march import Control, look, march, remake, take, try_step
from solvers.hht.run.recover import recovered
from solvers.hht.run.shortest import Shortest
from solvers.hht.run.transfer import expect_fits, load, store
from solvers.hht.step.state import State

UNLIMITED = 2**62
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
        self.structure, self.points = dynamics.structure, points_of(dynamics)  # a NumPy system counts its calls itself
        self.functions, self.layout = functions, functions.layout
        self._force = work.counted(compile_function(force_and_inverse_mass, dynamics), residuals=self.points)
        self.acceleration = AccelerationLevel(dynamics)
        self.callbacks = functions.callbacks or Callbacks()
        self.callbacks.check = work.check_time
        self.events = EventFunctions((), functions, self.callbacks)
        self._fallback, self._plain = fallback, plain
        self.distrusts = False  #: whether the declared derivatives were given up
        self._z: Memory | None = None
        self._held: State | None = None  #: the state that is in the memory
        self._stopped: tuple[State, int] | None = None  #: the state after which no step was made, and how that ended
        self._not_suspect: State | None = None  #: a state from which derived derivatives have failed too
        self._outside = self.functions.analysis.outside()
        self.nonfinite: NonFiniteValue | None = (
            None  #: the last value that was not finite in the last call, where it is known
        )

    @property
    def why(self) -> str:
        """How the steps are made."""
        kind = "machine code" if isinstance(self.functions, MachineCode) else "functions in Python"
        return f"{'plain Python' if self._plain else 'compiled'} loops, {kind}, {self.functions.analysis.kind} matrix"

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

    def watch(self, events: Any) -> None:
        """Look at the functions of ``events`` in every step."""
        if events != self.events.events:
            self.events = EventFunctions(events, self.functions, self.callbacks)
            self._z = self._held = None

    def march(
        self, state: State, control: Control, lengths: Vector, ends: Vector, rows: Matrix, values: Vector | None
    ) -> tuple[State, int, int]:
        """(the state after, how many steps were made, how it ended) of at most ``len(rows)`` steps.

        ``values``: of the event functions at ``state``; None where the motion begins there.
        """
        self.raise_noted()
        if self._stopped is not None and self._stopped[0] is state:  # after the steps of the last call
            made, ended = 0, self._stopped[1]
        else:
            z = self._prepared(state, values, controlled=control.controlled)
            made = self._call(march, z, control, lengths, ends, rows, before_raising=lambda made: made == 0)
            ended = int(z.i[mem.ENDED])
            self.work.add("steps_accepted", made)
        self._stopped = None
        if made:
            state = self._held = store(z, controlled=state.memory is not None)
            self._stopped = None if ended == mem.CONVERGED else (state, ended)
            return state, made, mem.CONVERGED
        if ended not in (mem.CONVERGED, mem.EVENT_FOUND):
            self._held = None  # what a failed step leaves behind is not the state
        if ended == mem.SPENT:
            raise BudgetSpent("evaluations", self.work.max_evaluations or 0)
        return state, made, ended

    def try_step(self, h: float, t1: float) -> int:
        """How a trial of a step of h [s] to t1 ended, from the state that is in the memory, with the last trial's matrix."""
        self.work.check_time()
        self._held = None  # its factorisation gives way
        ended = self._call(try_step, self._memory(), float(h), float(t1))
        if ended == mem.SPENT:
            raise BudgetSpent("evaluations", self.work.max_evaluations or 0)
        return ended

    def look(self) -> int:
        """What the event functions do along the attempt."""
        return self._call(look, self._memory())

    def take(self, before: State, control: Control, values: Vector | None, *, located: bool) -> tuple[State, Vector]:
        """Accept the attempt from ``before`` with ``values`` of event functions: the state after it and its row.

        Of trials since then nothing stays but the one that ends where root location has ``located`` an event.
        """
        row, controlled = np.zeros((1, self.columns)), before.memory is not None
        if self._held is not before:
            attempt = self.attempted()
            self._prepared(before, values, controlled=controlled)
            self.put_back(attempt)
            if not located:  # the same bits again, with their matrix
                self.try_step(attempt[0][mem.H_TRIED], attempt[0][mem.T_END])
        z = self._memory()
        self._call(take, z, control, row, located)
        self.work.add("steps_accepted")
        self._held = store(z, controlled=controlled)
        return self._held, row[0]

    def attempted(self) -> tuple[Vector, ...]:
        """Copies of what the memory holds of the attempt: numbers, unknowns, end, inverse mass."""
        return tuple(view(self._memory(), section).copy() for section in ATTEMPTED)

    def put_back(self, attempt: tuple[Vector, ...]) -> None:
        """Make ``attempt``, of the same state, the one that the memory holds."""
        for section, values in zip(ATTEMPTED, attempt, strict=True):
            view(self._memory(), section)[:] = values

    @property
    def columns(self) -> int:
        """Of a row: t, h, q, v, a, lam at both ends, mu."""
        s = self.structure
        return 2 + 3 * s.n + 2 * s.m + s.p

    def numbers(self) -> Vector:
        """The ATTEMPT section of the memory."""
        return view(self._memory(), mem.ATTEMPT)

    def section(self, name: int) -> Vector:
        """A section of the memory."""
        return view(self._memory(), name)

    def event_values(self) -> Vector:
        """(k,) of the event functions at the state in the memory."""
        return view(self._memory(), mem.EVENT_VALUES).copy()

    def give_up_derivatives(self, state: State) -> bool:
        """Whether the step that was tried last is made without the declared derivatives, which then are given up."""
        if self._fallback is None:
            return False
        numbers = self.numbers().copy()
        declared_ones = self.functions, self._fallback, self._z, self._outside, self.callbacks, self.events
        names = self.distrust()
        self._prepared(replace(state, factorised=None), None, controlled=state.memory is not None)
        ended = self._call(try_step, self._memory(), float(numbers[mem.H_TRIED]), float(numbers[mem.T_END]))
        self._held = None
        if ended == mem.CONVERGED:
            warnings.warn(
                f"Newton's iteration failed with the declared {names} and converged without; derived ones are used "
                "from here on. `hhtbench check` shows the wrong entries.",
                UserWarning,
                stacklevel=2,
            )
            return True
        self.functions, self._fallback, self._z, self._outside, self.callbacks, self.events = declared_ones
        self.distrusts, self._not_suspect = False, state
        self.numbers()[:] = numbers
        return False

    def distrust(self) -> str:
        """Give up the declared derivatives in Newton's matrix for derived ones; returns their names."""
        if self._fallback is None:
            return ""
        self.functions = self._fallback()
        self.callbacks = self.functions.callbacks or Callbacks()
        self.callbacks.check = self.work.check_time
        self.events = EventFunctions(self.events.events, self.functions, self.callbacks)
        self._outside = self.functions.analysis.outside()
        self._fallback, self._z, self._held, self.distrusts = None, None, None, True
        system = self.functions.dynamics.system
        return ", ".join(name for name in DERIVATIVES if declared(system, name) is not None)

    def recovered(self, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
        """Which rows (k,) got their multipliers from the acceleration level, (H16), in ``lam`` and ``mu``."""
        if not isinstance(self.functions, MachineCode) or self._plain:
            return np.zeros(times.size, dtype=bool)
        done = recovered(self.functions.dynamics, self.callbacks, self.work, self.points, (times, q, v, lam, mu))
        self.raise_noted()
        return done

    def explain(self, state: State, t1: float) -> NonFiniteValue | None:
        """The value that was not finite in a step from ``state``, looked for near its end where machine code has met it."""
        if self.nonfinite is not None:
            return self.nonfinite
        n, end = self.structure.n, self.section(mem.END)
        q1, v1 = end[:n], end[n : 2 * n]
        if not np.isfinite(end[: 2 * n]).all():
            q1, v1 = state.q + (t1 - state.t) * state.v, state.v
        try:
            explain_nonfinite(self.dynamics, t1, q1, v1)
        except NonFiniteValue as error:
            return error
        return None

    def _memory(self) -> Memory:
        if self._z is None:
            self._z = self._made()
        return self._z

    def _made(self) -> Memory:
        """The loops' memory with constants and addresses, but for those of the error and the events."""
        z = self.functions.memory(len(self.events.events), self.events.samples)
        c, o = self.method.coefficients, self.functions.newton
        view(z, mem.CONSTANTS)[:] = [c.alpha, c.beta, c.gamma, *(getattr(o, name) for name in mem.NEWTON_CONSTANTS)]
        z.i[mem.RESCALE_A], z.i[mem.TRAPEZOIDAL] = self.method.rescale_a, self.method.start == "trapezoidal"
        z.i[mem.MAX_ITERATIONS], z.i[mem.MAX_DAMPED], z.i[mem.MAX_HALVINGS] = o.max_iterations, o.max_damped, o.max_halvings
        codes = self.functions.codes(self.callbacks) | Shortest(self).codes(self.callbacks)
        if z.i[mem.KIND] == mem.KIND_CALLBACK and self._outside is not None:
            codes |= self._outside.codes(self.callbacks, self.functions.analysis.rows.size)
        self._put(z, codes)
        self.events.fill(z)
        return z

    def _put(self, z: Memory, codes: dict[str, tuple[int, int]]) -> None:
        for name, pair in codes.items():
            at = mem.CODE + 2 * mem.FUNCTIONS.index(name)
            z.i[at : at + 2] = pair

    def _prepared(self, state: State, values: Vector | None, *, controlled: bool) -> Memory:
        """The memory with ``state`` in it."""
        self.raise_noted()
        z = self._memory()
        if controlled and not z.i[mem.CODE + 2 * mem.FUNCTIONS.index("raw")]:
            self._put(z, self.functions.error_codes(self.callbacks))
        if self._held is not state:
            expect_fits(z, state)
            self._held, ended = None, mem.CONVERGED
            if state.factorised is not None:
                before = self.work.tally.copy()
                ended = self._call(remake, z, state.factorised.at)
                self.work.tally.clear()  # that work was counted before
                self.work.tally.update(before)
            load(z, state if ended == mem.CONVERGED else replace(state, factorised=None))
            self._held = state
        z.i[mem.FALLBACK] = self._fallback is not None and self._not_suspect is not state
        z.i[mem.EVENTS_KNOWN] = values is not None
        if values is not None:
            view(z, mem.EVENT_VALUES)[:] = values
        integer_view(z, mem.EVENT_CODE)[:] = self.events.codes()
        return z

    def tolerate(self, rtol: Vector, atol: Vector) -> None:
        """The weights of the error norm, (2n,) each."""
        z = self._memory()
        view(z, mem.RTOL)[:], view(z, mem.ATOL)[:] = rtol, atol

    def _call(
        self,
        entry: Any,
        z: Memory,
        *arguments: Any,
        before_raising: Callable[[int], bool] = lambda made: True,
    ) -> int:
        """Call one of the loops; what a function in Python has raised in it is raised again."""
        tally, limit = np.zeros(len(mem.COUNTS), dtype=np.int64), self.work.max_evaluations
        z.i[mem.EVALUATIONS] = (
            UNLIMITED if limit is None or not self.points else limit - self.work.tally["residual_evaluations"]
        )
        with self.callbacks, np.errstate(all="ignore") if self._plain else nullcontext():
            result = int((entry.function if self._plain else entry)(z, *arguments, tally) or 0)
        told = self.callbacks.take_nonfinite()
        self.nonfinite = told[-1] if told else None
        tallied = dict(zip(mem.COUNTS, tally.tolist(), strict=True))
        if not self.points:  # a NumPy system's callbacks count themselves
            tallied |= {"residual_evaluations": 0, "nonfinite_evaluations": len(told)}
        for name, amount in tallied.items():
            if amount:
                self.work.add(name, amount)
        if before_raising(result):
            self.raise_noted()
        return result

    def raise_left_over(self) -> None:
        """The same where no step follows that would tell; a budget that was spent has ended the steps already."""
        cause = self.callbacks.take_cause()
        if cause is not None and not isinstance(cause, BudgetSpent):
            raise cause

    def raise_noted(self) -> None:
        """Raise again what a function in Python has raised in the loops, or an interrupt; the steps before it stand."""
        cause = self.callbacks.take_cause()
        if cause is not None:
            raise cause


def force_and_inverse_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """F (n,) and, where the mass varies, M^-1 (n*n,), packed into one vector."""
    force = dynamics.force(t, q, v)
    if dynamics.structure.mass != "variable":
        return force
    return dynamics.xp.concatenate([force, inverse_mass_at(dynamics, t, q).ravel()])
