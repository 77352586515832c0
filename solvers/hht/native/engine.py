"""``NativeEngine``: a host engine that can also take many steps at once in compiled loops."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from solvers.hht.choose import Choice
from solvers.hht.coefficients import Method
from solvers.hht.control import Advance, ControlOptions, ErrorControlled, Prescribed
from solvers.hht.engine import HostEngine
from solvers.hht.history import History
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
    MAX_ITERATIONS,
    NEWTON_CONSTANTS,
    RESCALE_A,
    RTOL,
    TRAPEZOIDAL,
    Control,
    Memory,
    floats,
)
from solvers.hht.native.watching import Watched
from solvers.hht.newton import NewtonOptions
from solvers.hht.state import State

FIRST, MOST = 64, 65_536  # steps of a loop: few at first, so that one that is slow can be interrupted
SLOW = 0.05  # [s] of one loop, above which the next is no longer: budgets and the user's interrupt are looked at between
UNLIMITED = 2**62
FEW = 20  # output rows below which their multipliers are found one by one: no further code is needed for them


class NativeEngine(HostEngine):
    """Steps in compiled loops; one that Newton's plain iteration does not make is the host engine's, with its remedies."""

    def __init__(self, dynamics: Any, method: Method, work: Work, fallback: Any = None, *, kernel: Kernel) -> None:
        self.kernel = kernel
        self._memory: Memory | None = None
        super().__init__(dynamics, method, work, fallback, choice=Choice(kernel.analysis, None, None))
        self._most = FIRST

    def march(
        self, state: State, advance: Advance, stop: float, history: History, most: int | None, watched: Watched
    ) -> tuple[State, int]:
        """The state after as many steps towards ``stop`` [s] as the loops make, at most ``most``, and their number.

        None are made where the host engine has to look: after a failure, without a step's memory, under another rule.
        An event ends the loops before its step; ``watched.values`` are then those of its beginning.
        """
        count = self._most if most is None else min(self._most, most)
        lengths, ends, control = np.zeros(1), np.zeros(1), PRESCRIBED
        if isinstance(advance, Prescribed):
            lengths, ends = advance.ahead(count)
            count = lengths.size
        elif isinstance(advance, ErrorControlled) and state.memory is not None:
            control = _control(advance.options, stop)
        else:
            count = 0
        if self.distrusts or not count:
            return state, 0
        started = time.perf_counter()
        z, rows, tally = self._loaded(state, watched), history.room(count), np.zeros(len(COUNTS), dtype=np.int64)
        if control.controlled:
            tolerances = advance.estimator.tolerances  # type: ignore[attr-defined]
            floats(z, RTOL)[:], floats(z, ATOL)[:] = tolerances.rtol, tolerances.atol
        z.i[CODE : CODE + 2 * len(FUNCTIONS)] = self.kernel.code(controlled=control.controlled)
        made = march(z, control, lengths, ends, rows, tally, tally.copy())
        slow = time.perf_counter() - started > SLOW
        self._most = max(FIRST, self._most // 2) if slow else min(2 * self._most, MOST)
        if not made:
            return state, 0
        if isinstance(advance, Prescribed):
            advance.taken += made
        history.commit(made)
        for name, amount in zip(COUNTS, tally.tolist(), strict=True):
            self.work.add(name, amount)
        self.work.add("steps_accepted", made)
        watched.values = floats(z, EVENT_VALUES).copy()
        return self.kernel.store(z, state), made

    def _loaded(self, state: State, watched: Watched) -> Memory:
        """The loops' memory with state, budget and the values of the event functions."""
        if self._memory is None:
            self._memory = self.kernel.memory(watched.sections(), len(watched.events))
            z, c, o = self._memory, self.method.coefficients, NewtonOptions()
            floats(z, CONSTANTS)[:] = [c.alpha, c.beta, c.gamma, *(getattr(o, name) for name in NEWTON_CONSTANTS)]
            z.i[RESCALE_A], z.i[TRAPEZOIDAL] = self.method.rescale_a, self.method.start == "trapezoidal"
            z.i[MAX_ITERATIONS] = o.max_iterations
        z, limit = self._memory, self.work.max_evaluations
        z.i[EVALUATIONS] = UNLIMITED if limit is None else limit - self.work.tally["residual_evaluations"]
        self.kernel.load(z, state)
        floats(z, EVENT_VALUES)[:] = watched.values
        return z

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
        recover(code, at, (s.n, s.m + s.p), s.linear_reaction, place, x, terms, rows, done)
        lam[done], mu[done] = np.split(rows[done, 1 + 2 * s.n :], [s.m], axis=1)
        self.work.add("residual_evaluations", int(done.sum()))
        return done


def _control(o: ControlOptions, stop: float) -> Control:
    names = ("min_step", "max_step", "target", "integral", "proportional", "growth", "shrink", "least", "spacings")
    values = {name: float(getattr(o, name)) for name in names}
    return Control(controlled=True, stop=float(stop), keep=o.keep, **values)


PRESCRIBED = _control(ControlOptions(), 0.0)._replace(controlled=False)
