"""``CompiledSteps``: one solve by the compiled explicit loop: its memory, calls, and rows."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from hhtbench.lowering import Dynamics, NotNative, route_of
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers._run import Halt, Run
from solvers._start import typical_sizes
from solvers.explicit.march import OF_TIMES, OUTPUTS, ROWS, STEPS, Room, march
from solvers.explicit.tableaux import coefficients
from solvers.kernel import memory as mem
from solvers.kernel.full import Places
from solvers.kernel.kkt import acceleration_level, places_of
from solvers.kernel.memory import copied, integer_view, view

FIRST_CALL, MAX_CALL = 64, 65_536  # steps or rows of one call: few at first, so that slow ones can be interrupted
MAX_CALL_TIME = 0.05  # [s] of one call: budgets and the user's interrupt are checked between calls
UNLIMITED = 2**62
MIN_RTOL = 3e-14  # as in SciPy's methods
NOTHING = np.zeros(0)

_known = Cache(16)


class CompiledSteps:
    """Integrate ``run`` in the compiled loop by the explicit Runge-Kutta method ``name``.

    Raises
    ------
    NotNative
        The functions cannot be machine code.
    """

    def __init__(self, run: Run, name: str) -> None:
        dynamics, method = run.dynamics, coefficients(name)
        blank, mass, self._codes = _known.find(by_id(dynamics), lambda: _places(dynamics))
        s, size = dynamics.structure, run.form.size
        self.run, self.method = run, method
        run.work.library["steps_rejected_error"] = 0
        self.z = z = copied(blank)
        self.callbacks = Callbacks()
        self.callbacks.check = run.work.check_time
        shapes = (), (s.n,), (s.n,), (s.m,), (s.p,)
        looked_at = self.callbacks.entry(partial(acceleration_level, run), 1 + s.n + s.m + s.p, shapes)
        z.i[mem.C_ACCELERATION] = looked_at
        view(z, mem.RTOL)[:], view(z, mem.ATOL)[:] = max(run.rtol, MIN_RTOL), run.weights
        self.room = Room(
            slopes=np.zeros((method.b.size + 1, size)),
            stage=np.zeros(size),
            end=np.zeros(size),
            mass=mass.copy(),
            sizes=typical_sizes(run.problem),
            times=np.array([run.time(run.t0), run.time(run.t1)]),
            progress=np.zeros(6, dtype=np.int64),
        )
        self._march, self._counts = march.following(z, method, self.room, run.t1), integer_view(z, mem.COUNTED)
        self.y = z.w[z.i[2 * mem.Q] : z.i[2 * mem.Q] + size]
        self.y[:] = run.start.y

    def drive(self) -> None:
        """Take steps from the start to the end of the interval."""
        run, count = self.run, FIRST_CALL
        run.tells_no_steps()
        asked = NOTHING if run.wanted is None else run.wanted[run.wanted != run.t0]  # those of the start are there
        self.room.progress[OF_TIMES] = run.wanted is not None
        while run.unfinished():
            began, most = time.perf_counter(), run.request.max_num_steps
            steps = count if most is None else min(count, most - run.steps)
            rows = np.empty((steps if run.wanted is None else min(count, asked.size), 1 + self.y.size))
            ended = self.advance(steps, asked, rows)
            made, found = self.room.progress[[STEPS, ROWS]].tolist()
            t, asked = float(view(self.z, mem.NUMBER)[mem.T]), asked[found:]
            run.accept_many(made, t, self.y, rows[:found])
            self._checked(ended)
            each = (time.perf_counter() - began) / max(made, found, 1)
            count = int(min(8 * count, MAX_CALL, max(MAX_CALL_TIME / each, 1.0)))

    def advance(self, steps: int, asked: Vector, rows: Matrix) -> int:
        """Call :func:`~solvers.explicit.march.march` once and count its work; returns the ending code."""
        work = self.run.work
        limit = work.max_evaluations
        self.z.i[mem.EVALUATIONS] = UNLIMITED if limit is None else limit - work.tally["residual_evaluations"]
        with self.callbacks:
            ended = self._march(steps, asked, rows)
        self._count()
        work.output["residual_evaluations"] += int(self.room.progress[OUTPUTS])
        return ended

    def _count(self) -> None:
        """Add the loops' counts since the last call to the run's."""
        work, counts = self.run.work, self._counts
        work.add("residual_evaluations", int(counts[mem.RESIDUALS]))
        work.add("nonfinite_evaluations", int(counts[mem.NONFINITES]))
        work.library["steps_rejected_error"] += int(counts[mem.REJECTED])
        counts[:] = 0

    def _checked(self, ended: int) -> None:
        """Raise an exception noted during a call, or the failure with ending code ``ended``."""
        cause = self.callbacks.take_cause()
        if cause is not None:
            raise cause
        run = self.run
        if ended == mem.CONVERGED:
            return
        if ended == mem.SPENT:
            raise BudgetSpent("evaluations", run.work.max_evaluations or 0)
        if ended == mem.DIVERGED:
            raise Halt(Status.newton_failed, f"the projection does not converge after t = {exact(run.now)}")
        if ended in (mem.NONFINITE, mem.SINGULAR):
            place = view(self.z, mem.PLACE)
            run.guard.nonfinite = float(place[0]), place[1:].copy()
        status = Status.step_too_small
        raise Halt(status, f"Required step size is less than spacing between numbers. {status.text} t = {exact(run.now)}.")


def _places(dynamics: Dynamics) -> Places:
    """Compiled projection of states onto the constraints.

    Raises
    ------
    NotNative
        The functions cannot be machine code.
    """
    if route_of(dynamics) == "numpy":
        raise NotNative("the functions are plain callables")
    return places_of(dynamics)
