"""``cvode(form=ode, method=bdf|adams)``: SUNDIALS' CVODE through scikit-sundae on the underlying ODE.

Multipliers are eliminated at the acceleration level, so the constraints drift with the error.
"""

from __future__ import annotations

from typing import Any, ClassVar

from solvers._adapter import Adapter, choose
from solvers._run import Run
from solvers._sundials import SundialsMatrix, step_sundials

try:
    from sksundae.cvode import CVODE  # type: ignore[import-untyped, import-not-found, unused-ignore]
except ImportError:
    CVODE = None

KNOWN = {"form": ("ode",), "method": ("bdf", "adams")}


class CVODESolver(Adapter):
    """CVODE with Newton's iteration and the form's exact Jacobian, for both methods."""

    library: ClassVar[str] = "scikit-sundae"
    installed: ClassVar[bool] = CVODE is not None

    def drive(self, run: Run) -> None:
        """Step one CVODE to the end of the run."""

        def rhs(t: float, y: Any, result: Any) -> None:
            result[:] = run.rhs(t, y)

        matrix = SundialsMatrix(run.form)

        def jacobian(t: float, y: Any, _: Any, result: Any) -> None:
            result[:] = matrix.values(run.rhs_jacobian(t, y))

        options = {"method": self.method, "rtol": run.rtol, "atol": run.weights}
        solver = matrix.solver(CVODE, rhs, jacfn=jacobian, **options)
        solver.init_step(run.t0, run.start.y)
        step_sundials(run, solver)


def solver(**options: Any) -> CVODESolver:
    """CVODE; options ``method``: bdf (default) or adams, ``form``: ode."""
    chosen = choose("cvode", options, KNOWN)
    return CVODESolver(f"cvode(method={chosen['method']})", chosen["form"], chosen["method"])
