"""What a solve costs beside its steps.

A solve of one step of the paper's pendulum holds everything that a solve does once.  With an adapter the library's own start
and first step, on the same functions without our checks, counters and output, are subtracted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from scipy import integrate

import hhtbench as hb
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import make_request
from solvers.explicit.steps import NOTHING, CompiledSteps
from solvers.hht import HHT
from tests.performance.engine.clock import compare, unmeasured

try:
    from sksundae.cvode import CVODE  # type: ignore[import-untyped, import-not-found, unused-ignore]
    from sksundae.ida import IDA  # type: ignore[import-untyped, import-not-found, unused-ignore]
except ImportError:
    IDA = CVODE = None

LIMITS = {"HHT": 0.10e-3, "hb": 0.20e-3, "by hand": 10e-6, "adapter": 0.30e-3}  # [s]
H, RTOL = 1e-3, 1e-4
BATCH = 10  # solves of one action
BY_HAND = 500  # steps of one action
ADAPTERS = (
    "ida(form=ggl)",
    "ida(form=index1)",
    "cvode(form=ode, method=adams)",
    "cvode(form=ode, method=bdf)",
    "scipy(method=DOP853)",
    "scipy(method=Radau)",
    "projected(method=DOP853)",
)


def measure_starts() -> list[dict[str, Any]]:
    """One line a call."""
    problem = hb.load_problem("jay_negrut_pendulum")
    short = replace(problem, t_span=(0.0, H), reference=None)
    solver = hb.load_solver("hht")
    calls = {
        "HHT(system).solve, a constant step": ("HHT", partial(_own_solve, short, step=H)),
        "HHT(system).solve, a step with error control": ("HHT", partial(_own_solve, problem, rtol=RTOL, max_num_steps=1)),
        'hb.solve(problem, "hht"), a constant step': ("hb", partial(hb.solve, short, solver, step=H, t_eval=[H])),
    }
    lines = [_line(name, _repeated(BATCH, call), BATCH, LIMITS[limit]) for name, (limit, call) in calls.items()]
    hht = HHT(problem.system)
    hht.init_step(0.0, problem.q0, problem.v0, step=H, lam_guess=problem.lam_guess)
    lines.append(_line("hht.step() by hand, a constant step", _repeated(BY_HAND, hht.step), BY_HAND, LIMITS["by hand"]))
    return lines + [_added(problem, name) for name in ADAPTERS]


def _own_solve(problem: Problem, **request: Any) -> None:
    end = np.array([problem.t_span[1]])
    HHT(problem.system).solve(problem.t_span, problem.q0, problem.v0, lam_guess=problem.lam_guess, t_eval=end, **request)


def _line(what: str, action: Callable[[], None], count: int, limit: float) -> dict[str, Any]:
    found = compare({"": action}, lambda seconds: seconds[""] / count, limit)
    return {"what": what, "unit": "s", **found.line(), "note": ""}


def _added(problem: Problem, name: str) -> dict[str, Any]:
    """What the adapter adds: its solve of one step, with a row of output, less the library's."""
    what, limit = f"{name}, what the adapter adds to one step", LIMITS["adapter"]
    adapter = hb.load_solver(name)
    request = make_request(rtol=RTOL, max_num_steps=1)
    reason = adapter.accepts(problem, request)
    if reason is not None:
        return {"what": what, "unit": "s", **unmeasured(limit, reason)}
    own = _library_start(_caught(adapter, problem, request), name)
    actions = {
        "adapter": _repeated(BATCH, partial(adapter.solve, problem, request)),
        "library": _repeated(BATCH, own),
    }
    found = compare(actions, lambda seconds: (seconds["adapter"] - seconds["library"]) / BATCH, limit)
    note = f"the library's own start and step {1e3 * found.cpu('library') / BATCH:.2g} ms"
    return {"what": what, "unit": "s", **found.line(), "note": note}


def _caught(adapter: Any, problem: Problem, request: Any) -> Any:
    """The run that the adapter hands to its library: form, functions, start and tolerances."""
    kept: list[Any] = []

    def drive(self: Any, run: Any) -> None:
        kept.append(run)
        type(adapter).drive(self, run)

    watching = type("Watching", (type(adapter),), {"drive": drive})
    watching(**{field.name: getattr(adapter, field.name) for field in fields(adapter)}).solve(problem, request)
    return kept[0]


def _library_start(run: Any, name: str) -> Callable[[], None]:
    """The library alone, from its making to the end of its first step."""
    family, method = name.partition("(")[0], name.rpartition("=")[2].rstrip(")")
    starts = {"ida": _ida, "cvode": _cvode, "scipy": _scipy, "projected": _projected}
    return partial(starts[family], run, method)


def _ida(run: Any, _: str) -> None:
    form = run.form

    def residual(t: float, y: Any, yp: Any, result: Any) -> None:
        result[:] = form.residual(t, y, yp)

    def jacobian(t: float, y: Any, yp: Any, _: Any, c: float, result: Any) -> None:
        result[:] = form.jacobian(t, y, yp, c)

    algebraic = [int(i) for i in np.flatnonzero(~form.differential)]
    solver = IDA(residual, jacfn=jacobian, algebraic_idx=algebraic, rtol=run.rtol, atol=run.weights)
    solver.init_step(run.t0, run.start.y, run.start.yp)
    solver.step(run.t1, method="onestep", tstop=run.t1)


def _cvode(run: Any, method: str) -> None:
    form = run.form

    def rhs(t: float, y: Any, result: Any) -> None:
        result[:] = form.rhs(t, y)

    def jacobian(t: float, y: Any, _: Any, result: Any) -> None:
        result[:] = form.rhs_jacobian(t, y)

    solver = CVODE(rhs, method=method, jacfn=jacobian, rtol=run.rtol, atol=run.weights)
    solver.init_step(run.t0, run.start.y)
    solver.step(run.t1, method="onestep", tstop=run.t1)


def _scipy(run: Any, method: str) -> Any:
    form = run.form

    def rhs(t: Any, y: Any) -> Any:
        return form.rhs(float(t), y)  # SciPy's time is NumPy's float, which takes compiled code twice as long

    def jacobian(t: Any, y: Any) -> Any:
        return form.rhs_jacobian(float(t), y)

    options = {} if method == "DOP853" else {"jac": jacobian}
    made = getattr(integrate, method)
    solver = made(rhs, run.t0, run.start.y, run.t1, rtol=run.rtol, atol=run.weights, **options)
    solver.step()
    return solver


def _projected(run: Any, method: str) -> None:
    """The compiled loop."""
    steps = CompiledSteps(run, method)
    steps.advance(1, NOTHING, np.empty((1, 1 + run.form.size)))


def _repeated(times: int, call: Callable[[], object]) -> Callable[[], None]:
    def action() -> None:
        for _ in range(times):
            call()

    return action
