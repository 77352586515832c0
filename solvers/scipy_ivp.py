"""``scipy(method=Radau|BDF|LSODA|DOP853)``: SciPy's solver classes on the underlying ODE, stepped one by one.

``solve_ivp`` is not used: it returns nothing if a function raises, and has no budgets.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy import integrate

from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers._adapter import Adapter, choose
from solvers._run import Halt, Run

KNOWN = {"method": ("Radau", "BDF", "LSODA", "DOP853"), "form": ("ode",)}
MIN_RTOL = 100 * float(np.finfo(np.float64).eps)  # SciPy raises smaller ones to this, with a warning


class SciPySolver(Adapter):
    """One of SciPy's methods; implicit ones get the form's exact Jacobian."""

    library: ClassVar[str] = "scipy"

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use; LSODA needs the Jacobian from where it changes to stiff steps."""
        super().warm_up(problem, request)
        if self.method == "LSODA":
            replace(self, method="BDF").warm_up(problem, request)

    def drive(self, run: Run) -> None:
        """Step one SciPy solver to the end of the run."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="lsoda: ")  # failures are reported by the status
            solver = self._stepper(run, run.t0, run.start.y, run.t1)
            while run.unfinished():
                _step(run, solver)
                run.work.library["factorisations"] = int(solver.nlu)
                run.accept(solver.t, solver.y, partial(self._between, run, solver), dense=solver.dense_output)

    def _stepper(self, run: Run, t0: float, y0: Any, t1: float, **options: Any) -> Any:
        if self.method != "DOP853":
            options["jac"] = partial(self._jacobian, run)
        method = getattr(integrate, self.method)
        return method(run.rhs, t0, y0, t1, rtol=max(run.rtol, MIN_RTOL), atol=run.weights, **options)

    def _jacobian(self, run: Run, t: float, y: Any) -> Any:
        """dy'/dy; LSODA takes only full matrices."""
        return run.form.matrix(run.rhs_jacobian(t, y), full=self.method == "LSODA")

    def _between(self, run: Run, solver: Any, time: float) -> Any:
        """y at ``time`` within the last step.

        Multistep methods have an interpolant as accurate as their steps.  Those of Radau and DOP853 are less accurate,
        so a shorter step from the same start is used instead.
        """
        if self.method in ("BDF", "LSODA"):
            return solver.dense_output()(time)
        shorter = self._stepper(run, solver.t_old, solver.y_old, time, first_step=abs(time - solver.t_old))
        while shorter.status == "running":
            _step(run, shorter)
        return shorter.y


def _step(run: Run, solver: Any) -> None:
    message = solver.step()
    if solver.status == "failed":
        status = Status.step_too_small
        raise Halt(status, f"{message} {status.text} t = {exact(run.now)} was reached.")


def solver(**options: Any) -> SciPySolver:
    """A method of SciPy; options ``method``: Radau (default), BDF, LSODA or DOP853, ``form``: ode."""
    chosen = choose("scipy", options, KNOWN)
    return SciPySolver(f"scipy(method={chosen['method']})", chosen["form"], chosen["method"])
