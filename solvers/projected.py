"""``projected(method=DOP853|Tsit5|RK45|RK23)``: explicit methods on the underlying ODE, projected after every step.

Integration of the underlying ODE drifts off the constraints; here every accepted state is projected onto both levels, by the
smallest change in the norm of the mass matrix: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II,
Springer 1996, section VII.2.  Steps are SciPy's, by its classes or, for systems in machine code, in an equal compiled loop;
but a step that the projection moves as far as only a jump of a prescribed velocity does is rejected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hhtbench.lowering import NotNative
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers._adapter import choose
from solvers._projection import PROJECTED, Projection
from solvers._run import Halt, Run
from solvers.explicit.march import FAR, NOISE, SHRINK, SPACINGS, TENTH
from solvers.explicit.steps import CompiledSteps
from solvers.explicit.tableaux import CLASSES
from solvers.scipy_ivp import SciPySolver, _step

KNOWN = {"method": tuple(CLASSES), "form": ("ode",), "engine": ("compiled", "python")}


@dataclass(frozen=True)
class ProjectedSolver(SciPySolver):
    """An explicit Runge-Kutta method whose states satisfy both levels of the constraints."""

    library: ClassVar[str] = "scipy"
    interpolates: ClassVar[bool] = False  # SciPy's interpolant ends at the step before its projection
    engine: str = "compiled"

    def drive(self, run: Run) -> None:
        """Run the compiled loop, or SciPy's steps in Python if these are asked for or the system cannot be machine code."""
        if self.engine == "compiled":
            try:
                steps = CompiledSteps(run, self.method)
            except NotNative as error:
                run.note = f"{run.note} The steps are made in Python: {error.reason}.".strip()
            else:
                return steps.drive()
        return self._in_python(run)

    def _in_python(self, run: Run) -> None:
        """Step one SciPy solver to the end, replacing its state by the projected one."""
        projection = Onto(run)
        solver = self._stepper(run, run.t0, projection.of(run.t0, run.start.y), run.t1)
        while run.unfinished():
            solver.y = _projected_step(run, solver, projection)
            solver.f = run.rhs(solver.t, solver.y)
            run.accept(solver.t, solver.y, lambda t: projection.of(t, self._between(run, solver, t)))

    def _stepper(self, run: Run, t0: float, y0: Any, t1: float, **options: Any) -> Any:
        return CLASSES[self.method](run.rhs, t0, y0, t1, rtol=max(run.rtol, 3e-14), atol=run.weights, **options)


class Onto:
    """Projection of states (2n,) onto both constraint levels in a run."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self._projection = Projection(run.dynamics) if run.dynamics.structure.constrained else None

    def of(self, t: float, y: Vector) -> Vector:
        """The nearest consistent state, (2n,)."""
        if self._projection is None:
            return y
        scales, t = self.run.problem.scales, self.run.time(t)
        q, v = self._projection.nearest(t, *self.run.form.state(y))
        sizes = np.maximum(scales.q, np.abs(q))  # constraints carry the roundoff of q
        if not np.max(self._projection.levels.at(t, q, v).scaled_position(sizes), initial=0.0) <= PROJECTED:
            raise Halt(Status.newton_failed, f"the projection does not converge at t = {exact(t)}")
        return np.concatenate([q, v])


def _projected_step(run: Run, solver: Any, projection: Onto) -> Vector:
    """The state (2n,) after the next step whose projection is not a jump; same rule as in the compiled loop."""
    rejected = False
    while True:
        slope = solver.f
        _step(run, solver)
        h, y = abs(solver.t - solver.t_old), projection.of(solver.t, solver.y)
        if not _moved_far(solver, y, h):
            solver.h_abs = min(solver.h_abs, h) if rejected else solver.h_abs
            return y
        solver.t, solver.y, solver.f, solver.status = solver.t_old, solver.y_old, slope, "running"
        solver.h_abs, rejected = SHRINK * h, True
        if solver.h_abs < SPACINGS * np.spacing(abs(solver.t)):
            status = Status.step_too_small
            raise Halt(status, f"{solver.TOO_SMALL_STEP} {status.text} t = {exact(run.now)} was reached.")


def _moved_far(solver: Any, y: Vector, h: float) -> bool:
    """:func:`~solvers.explicit.march.moved_far` for the step to ``solver.y`` and its projection ``y``."""
    moved, n, rtol = np.abs(y - solver.y), y.size // 2, solver.rtol
    scale = solver.atol + rtol * np.maximum(np.abs(solver.y_old), np.abs(solver.y))
    far = np.any(moved > min(max(FAR, NOISE / rtol), TENTH / rtol) * scale)
    return bool(far and np.any(np.maximum(moved[:n], h * moved[n:]) > scale[:n]))


def solver(**options: Any) -> ProjectedSolver:
    """A projected method; options ``method``: DOP853 (default), Tsit5, RK45 or RK23, ``engine``: compiled or python."""
    chosen = choose("projected", options, KNOWN)
    engine = ", engine=python" if chosen["engine"] == "python" else ""
    return ProjectedSolver(
        f"projected(method={chosen['method']}{engine})", chosen["form"], chosen["method"], chosen["engine"]
    )
