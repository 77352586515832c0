"""``ida(form=ggl|index1|integrated|index2|index3)``: SUNDIALS' IDA through scikit-sundae, variable-order BDF for DAEs.

scikit-sundae has no switch to leave algebraic variables out of the error test: multipliers get a huge absolute tolerance
(:data:`solvers.forms.MASKED`) or, in the form integrated, are replaced by their integrals.  Velocities stay in the test, so
index3 fails or takes tiny steps except at loose tolerances.  IDA is driven one internal step at a time, since a two-point
solve loses all steps when it fails and ignores ``max_num_steps``.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from solvers._adapter import Adapter, choose
from solvers._run import Run
from solvers._sundials import SundialsMatrix, step_sundials

try:
    from sksundae.ida import IDA  # type: ignore[import-untyped, import-not-found, unused-ignore]
except ImportError:
    IDA = None

KNOWN = {"form": ("ggl", "index1", "integrated", "index2", "index3")}


class IDASolver(Adapter):
    """IDA for one DAE form, with the form's exact Jacobian."""

    library: ClassVar[str] = "scikit-sundae"
    installed: ClassVar[bool] = IDA is not None

    def drive(self, run: Run) -> None:
        """Step one IDA to the end of the run."""

        def residual(t: float, y: Any, yp: Any, result: Any) -> None:
            result[:] = run.residual(t, y, yp)

        matrix = SundialsMatrix(run.form)

        def jacobian(t: float, y: Any, yp: Any, _: Any, c: float, result: Any) -> None:
            result[:] = matrix.values(run.jacobian(t, y, yp, c))

        algebraic = [int(i) for i in np.flatnonzero(~run.form.differential)]
        options = {"algebraic_idx": algebraic, "rtol": run.rtol, "atol": run.weights}
        solver = matrix.solver(IDA, residual, jacfn=jacobian, **options)
        solver.init_step(run.t0, run.start.y, run.start.yp)
        step_sundials(run, solver)


def solver(**options: Any) -> IDASolver:
    """IDA; option ``form``: ggl (default), index1, integrated, index2 or index3."""
    chosen = choose("ida", options, KNOWN)
    return IDASolver(f"ida(form={chosen['form']})", chosen["form"], "bdf")
