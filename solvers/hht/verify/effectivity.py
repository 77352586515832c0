"""The error estimate against the local error itself, computed by another method from the same state."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.counting import Work
from hhtbench.evidence import Row
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.result import Status
from solvers._start import Place
from solvers.collocation import solver as collocation
from solvers.hht.control.first_step import prepared
from solvers.hht.control.tolerances import make_tolerances
from solvers.hht.run import controlled_course
from solvers.hht.solver import HHT
from solvers.hht.step.state import State, Step
from solvers.projected import solver as projected

SPECS = ("jay_negrut_test1", "jay_negrut_pendulum", "andrews", "knife_edge", "rolling_disk3d_steady", "flyball_governor")
METHODS: tuple[dict[str, Any], ...] = (
    {"alpha": -0.05},
    {"alpha": -0.3},
    {"alpha": -0.3, "b": 0.25},
    {"alpha": -0.15, "reaction": "midpoint"},
    {"alpha": 0.0, "reaction": "predictor"},
)
TOLERANCE = 1e-5
NONLINEAR = ("jay_negrut_test1",)  # its reaction: there is no underlying ODE by one linear solve
STEPS = 40  # looked at along each run, every third
RANGE = (0.8, 1.25)  # of the middle of estimated over true local error


@dataclass(frozen=True)
class Ratios:
    """Estimated over true local error in the norm of the error test."""

    spec: str
    method: dict[str, Any]
    values: tuple[float, ...]


def effectivities() -> list[Row]:
    """A row for every problem and method: quartiles of estimated over true local error."""
    rows = []
    for spec in SPECS:
        for method in METHODS:
            found = ratios(spec, method)
            low, middle, high = np.quantile(found.values, [0.25, 0.5, 0.75])
            name = ", ".join(f"{key} {value}" for key, value in method.items())
            rows.append(
                Row(
                    id=f"effectivity/{spec}/{name}",
                    claim=f"{spec}, {name}: estimated over true local error, quartiles of {len(found.values)} steps",
                    measured=f"{low:.2f} {middle:.2f} {high:.2f}",
                    bound=f"middle in [{RANGE[0]:g}, {RANGE[1]:g}]",
                    passed=RANGE[0] <= middle <= RANGE[1],
                )
            )
    return rows


def ratios(spec: str, method: dict[str, Any], steps: int = STEPS) -> Ratios:
    """Estimated over true local error of every third step of a controlled run of ``spec``."""
    problem = load_problem(spec)
    hht = HHT(problem.system, **method)
    place = Place(problem.t_span[0], problem.q0, problem.v0)
    started = hht.begin(place, (problem.lam_guess, problem.mu_guess), 1.0, Work(), controlled=True)
    if started.engine is None or started.state is None:
        raise RuntimeError(f"{spec}: {started.failure}")
    tolerances, t1 = make_tolerances(TOLERANCE, None, started.state), problem.t_span[1]
    advance = controlled_course(started.engine, tolerances, hht.options.control).advance
    state = prepared(started.engine, started.state, tolerances, hht.options.control, t1)
    values: list[float] = []
    for index in range(steps):
        step = advance(state, t1)
        if not isinstance(step, Step) or step.state.t == t1:
            break
        if index % 3 == 2:
            values.append(_ratio(problem, advance, state, step))
        state = step.state
    return Ratios(spec, method, tuple(values))


def _ratio(problem: Problem, advance: Any, before: State, step: Step) -> float:
    estimator, after = advance.estimator, step.state
    true = np.concatenate([after.q, after.v]) - local_solution(problem, before, after.t)
    size = true / estimator.tolerances.weights(before, after)
    allowed = math.sqrt(estimator.tolerances.relative(after))
    return estimator(before, step).size / (math.sqrt(float(size @ size) / size.size) / allowed)


def local_solution(problem: Problem, state: State, t1: float) -> Any:
    """[q, v] (2n,) at ``t1`` [s] of the exact motion through ``state``, by a method of order eight or more."""
    own = replace(problem, t_span=(state.t, t1), q0=state.q, v0=state.v, exact=None, reference=None)
    other = collocation() if problem.name in NONLINEAR else projected(method="DOP853")
    solution = other.solve(own, Request(rtol=1e-13, atol=1e-15, t_eval=np.array([t1])))
    if solution.status is not Status.success:
        raise RuntimeError(f"{problem.name}: no local solution: {solution.message}")
    return np.concatenate([solution.q[-1], solution.v[-1]])
