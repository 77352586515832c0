"""``projected(method=DOP853|Tsit5|RK45|RK23)``: explicit methods on the underlying ODE, projected after every step.

The integration of the underlying ODE drifts off the constraints; here every accepted state is moved back onto both levels,
by the smallest change in the metric of the mass matrix, as E. Hairer, G. Wanner, Solving Ordinary Differential Equations II,
Springer 1996, section VII.2, describes.  The steps are SciPy's, by its classes or, where the system's functions are machine
code, the same in a compiled loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import NotNative, compile_function, mass_at
from hhtbench.result import Status
from solvers._adapter import choose
from solvers._projection import closest
from solvers._run import Halt, Run
from solvers.explicit.steps import CompiledSteps
from solvers.explicit.tableaux import CLASSES
from solvers.scipy_ivp import SciPySolver, _step

KNOWN = {"method": tuple(CLASSES), "form": ("ode",), "engine": ("compiled", "python")}
MOST_ITERATIONS = 5  # of the position level; a step leaves the constraints by its error, so two are enough
ROUNDOFF = 1e-15  # scaled violation that cannot be made smaller


@dataclass(frozen=True)
class ProjectedSolver(SciPySolver):
    """An explicit Runge-Kutta method whose states satisfy both levels of the constraints."""

    library: ClassVar[str] = "scipy"
    engine: str = "compiled"

    def drive(self, run: Run) -> None:
        """The compiled loop, or SciPy's steps in Python: those that were asked for, or where the former cannot be."""
        if self.engine == "compiled":
            try:
                steps = CompiledSteps(run, self.method)
            except NotNative as error:
                run.note = f"The steps are made in Python: {error.reason}."
            else:
                return steps.drive()
        return self._in_python(run)

    def _in_python(self, run: Run) -> None:
        """One solver object, stepped to the end, its state replaced by the projected one."""
        projection = Projection(run)
        solver = self._stepper(run, run.t0, run.start.y, run.t1)
        while run.unfinished():
            _step(run, solver)
            shorter = partial(self._shorter, run, solver.t_old, solver.y_old)
            solver.y = projection.of(solver.t, solver.y)
            solver.f = run.rhs(solver.t, solver.y)
            run.accept(solver.t, solver.y, partial(projection.of_step, shorter))

    def _stepper(self, run: Run, t0: float, y0: Any, t1: float, **options: Any) -> Any:
        return CLASSES[self.method](run.rhs, t0, y0, t1, rtol=max(run.rtol, 3e-14), atol=run.weights, **options)

    def _shorter(self, run: Run, t0: float, y0: Any, time: float) -> Vector:
        """y at ``time`` by a shorter step from the same start: the interpolant is less accurate than the step."""
        shorter = self._stepper(run, t0, y0, time, first_step=abs(time - t0))
        while shorter.status == "running":
            _step(run, shorter)
        return np.asarray(shorter.y)


class Projection:
    """Moves states onto both levels of the constraints."""

    def __init__(self, run: Run) -> None:
        self.run, self.scales = run, run.problem.scales
        self._mass = compile_function(mass_at, run.dynamics)

    def of_step(self, step: Callable[[float], Vector], t: float) -> Vector:
        """The nearest consistent state to what ``step`` leads to at ``t``."""
        return self.of(t, step(t))

    def of(self, t: float, y: Vector) -> Vector:
        """The nearest consistent state, (2n,)."""
        if not self.run.dynamics.structure.constrained:
            return y
        q, v = (part.copy() for part in self.run.form.state(y))
        t = self.run.time(t)
        mass = np.asarray(self._mass(t, q))
        for _ in range(MOST_ITERATIONS):
            at = self.run.levels.at(t, q, v)
            if not at.position.size or np.max(at.scaled_position(self.scales.q)) <= ROUNDOFF:
                break
            q = q + closest(mass, at.position_jacobian, np.zeros(q.size), at.position)
        else:
            at = self.run.levels.at(t, q, v)
            if np.max(at.scaled_position(self.scales.q)) > 1e3 * ROUNDOFF:
                raise Halt(Status.newton_failed, f"the projection does not converge at t = {t:.17g}")
        return np.concatenate([q, v + closest(mass, at.rows, np.zeros(v.size), at.velocity_drift)])


def solver(**options: Any) -> ProjectedSolver:
    """A projected method; options ``method``: DOP853 (default), Tsit5, RK45 or RK23, ``engine``: compiled or python."""
    chosen = choose("projected", options, KNOWN)
    engine = ", engine=python" if chosen["engine"] == "python" else ""
    return ProjectedSolver(
        f"projected(method={chosen['method']}{engine})", chosen["form"], chosen["method"], chosen["engine"]
    )
