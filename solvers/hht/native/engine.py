"""``NativeEngine``: a host engine that can also take many steps at once in compiled loops."""

from __future__ import annotations

import time
from contextlib import nullcontext
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering.dynamics.foreign import Callbacks
from solvers.hht.choose import Choice
from solvers.hht.coefficients import Method
from solvers.hht.control import Advance, ControlOptions, ErrorControlled, Planned
from solvers.hht.engine import HostEngine
from solvers.hht.history import History
from solvers.hht.linear import Dense
from solvers.hht.native.kernel import Kernel
from solvers.hht.native.march import march
from solvers.hht.native.recover import recover
from solvers.hht.native.tables import (
    ATOL,
    CODE,
    CONSTANTS,
    COUNTS,
    EVALUATIONS,
    EVENT_VALUES,
    FUNCTIONS,
    INTEGERS,
    MAX_DAMPED,
    MAX_HALVINGS,
    MAX_ITERATIONS,
    NEWTON_CONSTANTS,
    RESCALE_A,
    RTOL,
    TRAPEZOIDAL,
    Control,
    Memory,
    floats,
    integers,
)
from solvers.hht.native.watching import Watched
from solvers.hht.newton import NewtonOptions
from solvers.hht.state import State, Step

FIRST, MOST = 512, 65_536  # steps of a loop: fewer at first, so that one that is slow can be interrupted
SLOW = 0.05  # [s] of one loop, at most: budgets and the user's interrupt are looked at between
UNLIMITED = 2**62
FEW = 20  # output rows below which their multipliers are found one by one: no further code is needed for them


class NativeEngine(HostEngine):
    """Steps in compiled loops; one that Newton's iteration does not make there is the host engine's, with its remedies."""

    why = "native"

    def __init__(self, dynamics: Any, method: Method, work: Work, fallback: Any = None, *, kernel: Kernel) -> None:
        self.kernel = kernel
        self._memory: Memory | None = None
        self._callbacks: Callbacks | None = getattr(kernel.dynamics, "callbacks", None)
        super().__init__(dynamics, method, work, fallback, choice=Choice(kernel.analysis, None, None))
        self._most = FIRST if work.clock.limit is None else FEW

    def distrust(self) -> str:
        """Give up the declared derivatives: what they leave out is missing in the pattern of the machine code too."""
        size = self.layout.size
        self.choice = Choice(Dense(size, "the declared derivatives were given up"), None, None)
        return super().distrust()

    def march(
        self, state: State, advance: Advance, stop: float, history: History, most: int | None, watched: Watched
    ) -> tuple[State, int]:
        """The state after as many steps towards ``stop`` [s] as the loops make, at most ``most``, and their number.

        They end before a step with an event, or one that Newton's iteration does not make there: :meth:`one` is for those,
        or the host engine.  ``watched.values`` are then those at the end of the last step.
        """
        count = self._most if most is None else min(self._most, most)
        started = time.perf_counter()
        state, made = self._marched(state, advance, stop, history.room(count), watched)
        if made:
            history.commit(made)
            self.work.add("steps_accepted", made)
            self.work.clock.kept_back = history.handing_over()
        each = (time.perf_counter() - started) / max(made, 1)
        self._most = int(min(8 * self._most, MOST, max(SLOW / each, 1.0)))
        return state, made

    def one(self, state: State, advance: Advance, stop: float, watched: Watched) -> Step | None:
        """The next step, whatever events it has; None where it is the host engine's."""
        s = self.structure
        rows = np.zeros((1, 2 + 3 * s.n + 2 * s.m + s.p))
        after, made = self._marched(state, advance, stop, rows, watched, watching=False)
        if not made:
            return None
        lam_start, lam_end, mu = np.split(rows[0, 2 + 3 * s.n :], [s.m, 2 * s.m])
        return Step(state=after, lam_start=lam_start, lam_end=lam_end, mu_half=mu)

    def _marched(
        self, state: State, advance: Advance, stop: float, rows: Matrix, watched: Watched, *, watching: bool = True
    ) -> tuple[State, int]:
        """The state after as many steps as fit into ``rows``, or fewer; none by a rule that the loops do not know."""
        self._raise_cause()
        count, lengths, ends, control = len(rows), np.zeros(1), np.zeros(1), PRESCRIBED
        planned = advance if isinstance(advance, Planned) else None
        if planned is not None:
            lengths, ends = planned.ahead(state, stop, count)
            count = lengths.size
        elif isinstance(advance, ErrorControlled) and state.memory is not None:
            control = _control(advance.options, stop)
        else:
            count = 0
        if self.distrusts or not count:
            return state, 0
        z, tally = self._loaded(state, watched), np.zeros(len(COUNTS), dtype=np.int64)
        if control.controlled:
            tolerances = advance.estimator.tolerances  # type: ignore[attr-defined]
            floats(z, RTOL)[:], floats(z, ATOL)[:] = tolerances.rtol, tolerances.atol
        z.i[CODE : CODE + 2 * len(FUNCTIONS)] = self.kernel.code(controlled=control.controlled)
        with self._callbacks or nullcontext():
            made = march(z, control._replace(watching=watching), lengths, ends, rows[:count], tally, tally.copy())
        if not made:
            self._raise_cause()
            return state, 0
        if planned is not None:
            planned.made(made)
        for name, amount in zip(COUNTS, tally.tolist(), strict=True):
            if self.points or name != "residual_evaluations":  # callbacks count themselves
                self.work.add(name, amount)
        watched.values = floats(z, EVENT_VALUES).copy()
        return self.kernel.store(z, state), made

    def _loaded(self, state: State, watched: Watched) -> Memory:
        """The loops' memory with state, budget and the values of the event functions."""
        if self._memory is None or floats(self._memory, EVENT_VALUES).size != len(watched.events):
            self._memory = self.kernel.memory(watched.sections(), len(watched.events))
            z, c, o = self._memory, self.method.coefficients, NewtonOptions()
            floats(z, CONSTANTS)[:] = [c.alpha, c.beta, c.gamma, *(getattr(o, name) for name in NEWTON_CONSTANTS)]
            z.i[RESCALE_A], z.i[TRAPEZOIDAL] = self.method.rescale_a, self.method.start == "trapezoidal"
            z.i[MAX_ITERATIONS], z.i[MAX_DAMPED], z.i[MAX_HALVINGS] = o.max_iterations, o.max_damped, o.max_halvings
        z, limit = self._memory, self.work.max_evaluations
        z.i[EVALUATIONS] = UNLIMITED if limit is None or not self.points else limit - self.work.tally["residual_evaluations"]
        self.kernel.load(z, state)
        floats(z, EVENT_VALUES)[:] = watched.values
        for name, values in watched.sections().items():
            integers(z, INTEGERS.index(name))[:] = values
        return z

    def _raise_cause(self) -> None:
        """Raise again what a function in Python has raised in the loops, whose steps before it stand.

        A value that is not finite is not raised: the host engine makes the step again and tells.
        """
        cause = None if self._callbacks is None else self._callbacks.take_cause()
        if isinstance(cause, NonFiniteValue):
            self.work.add("nonfinite_evaluations")
        elif cause is not None:
            raise cause

    def recovered(self, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
        """Which rows (k,) got their multipliers from the acceleration level, (H16), in ``lam`` and ``mu``."""
        s, done = self.structure, np.zeros(times.size, dtype=bool)
        if times.size < FEW:
            return done
        kkt = self.kernel.kkt()
        place, x, terms = np.zeros(1 + 2 * s.n), np.zeros(s.n + s.m + s.p), np.zeros(kkt.size)
        rows = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
        at = tuple(int(array.ctypes.data) for array in (place, x, terms))
        code = kkt.address, int(kkt.parameters.ctypes.data)
        work = np.empty((x.size, x.size)), np.empty(x.size), np.empty(x.size)
        first, block = 0, FIRST if self.points else FEW
        while first < times.size and self.work.clock.left() >= 0.0:
            part, began = slice(first, first + block), time.perf_counter()
            with self._callbacks or nullcontext():
                recover(code, at, s.linear_reaction, place, x, terms, work, rows[part], done[part])
            self._raise_cause()
            first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
        lam[done], mu[done] = np.split(rows[done, 1 + 2 * s.n :], [s.m], axis=1)
        self.work.add("residual_evaluations", self.points * int(done.sum()))
        return done


def _control(o: ControlOptions, stop: float) -> Control:
    names = ("min_step", "max_step", "target", "integral", "proportional", "growth", "shrink", "least", "spacings")
    values = {name: float(getattr(o, name)) for name in names}
    return Control(controlled=True, watching=True, stop=float(stop), keep=o.keep, **values)


PRESCRIBED = _control(ControlOptions(), 0.0)._replace(controlled=False)
