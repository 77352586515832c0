"""The error estimate against the local error itself, computed by another method from the same state."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.evidence import Row
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.result import Status
from solvers.collocation import solver as collocation
from solvers.hht.control.tolerances import Tolerances, make_tolerances
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
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
    problem, values = load_problem(spec), list[float]()
    hht, (t0, t1) = HHT(problem.system, **method), problem.t_span
    guesses: Any = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
    if hht.init_step(t0, problem.q0, problem.v0, rtol=TOLERANCE, **guesses) is not Status.success:
        raise RuntimeError(f"{spec}: {hht.message}")
    tolerances = make_tolerances(TOLERANCE, None, hht.state)
    for index in range(steps):
        before, status = hht.state, hht.step(tstop=t1)
        if status is not Status.success or hht.state.t == t1:
            break
        if index % 3 == 2:
            values.append(_ratio(problem, tolerances, before, hht.state))
    return Ratios(spec, method, tuple(values))


def _ratio(problem: Problem, tolerances: Tolerances, before: State, after: State) -> float:
    if after.memory is None or after.memory.error is None:
        raise RuntimeError(f"{problem.name}: the step to {after.t:g} has no estimate")
    true = np.concatenate([after.q, after.v]) - local_solution(problem, before, after.t)
    size = true / tolerances.weights(before, after)
    allowed = math.sqrt(tolerances.relative(after))
    return after.memory.error / (math.sqrt(float(size @ size) / size.size) / allowed)


def local_solution(problem: Problem, state: State, t1: float) -> Any:
    """[q, v] (2n,) at ``t1`` [s] of the exact motion through ``state``, by a method of order eight or more."""
    own = replace(problem, t_span=(state.t, t1), q0=state.q, v0=state.v, exact=None, reference=None)
    other = collocation() if problem.name in NONLINEAR else projected(method="DOP853")
    solution = other.solve(own, Request(rtol=1e-13, atol=1e-15, t_eval=np.array([t1])))
    if solution.status is not Status.success:
        raise RuntimeError(f"{problem.name}: no local solution: {solution.message}")
    return np.concatenate([solution.q[-1], solution.v[-1]])
