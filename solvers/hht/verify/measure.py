"""Runs and error measures that all verifications share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.arguments import Vector
from hhtbench.errors import ProblemError
from hhtbench.evidence import Row
from hhtbench.lowering import ConstraintLevels, Dynamics, compile_function, derive
from hhtbench.protocol import Motion, Problem
from hhtbench.result import Solution
from solvers.hht.solver import HHT

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem with the interval and the common times its errors are measured at."""

    name: str
    problem: Problem
    t_end: float  #: [s]
    times: int  #: number of common times, equally spaced, the end included
    exact: Callable[[float], Motion]
    force: Callable[[float], Vector]  #: f = M^-1 F along the exact motion, (n,)


def known_at(problem: Problem, name: str, t: float) -> Vector:
    """Row ``t`` [s] of the problem's reference: ``name`` is q, v, lam or mu.

    Raises
    ------
    ProblemError
        The reference has no such time.
    """
    reference = problem.reference or {"t": []}
    rows = np.flatnonzero(np.asarray(reference["t"]) == t)
    if rows.size != 1:
        raise ProblemError(f"{problem.name}: its reference has no row at t = {t:g} s; build it again with that time.")
    return np.asarray(reference[name][rows[0]], dtype=np.float64)


def make_case(name: str, t_end: float, times: int) -> Case:
    """The registered problem ``name`` over [t0, t_end] with ``times`` common times; it must have an exact solution."""
    problem = load_problem(name)
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    evaluate = compile_function(_force_and_mass, dynamics)
    n = problem.q0.size
    exact = cache(problem.exact)  # type: ignore[arg-type]

    @cache
    def force(t: float) -> Vector:
        at = exact(t)
        packed = np.asarray(evaluate(t, np.asarray(at.q), np.asarray(at.v)))
        return np.linalg.solve(packed[n:].reshape(n, n), packed[:n])

    return Case(name=name, problem=problem, t_end=t_end, times=times, exact=exact, force=force)


def _force_and_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    return dynamics.xp.concatenate([dynamics.force(t, q, v), dynamics.mass(t, q).ravel()])


def integrate(case: Case, steps: int | Vector, **method: Any) -> Solution:
    """``case`` with the given steps, output at its common times.

    Raises
    ------
    RuntimeError
        The integration failed: a verification has nothing to measure then.
    """
    problem = case.problem
    span = (problem.t_span[0], case.t_end)
    t_eval = np.linspace(*span, case.times + 1)[1:]
    solution = HHT(problem.system, **method).solve(
        span, problem.q0, problem.v0, steps=steps, t_eval=t_eval, lam_guess=problem.lam_guess, mu_guess=problem.mu_guess
    )
    if not solution.success:
        raise RuntimeError(f"{case.name} with {method}: {solution.status.label}: {solution.message}")
    return solution


def common_steps(case: Case, solution: Solution) -> Vector:
    """Indices of the steps that end at the common times; equal numbers of steps lie between them."""
    count = solution.steps_data.t.size  # type: ignore[union-attr]
    return (np.arange(1, case.times + 1) * count) // case.times - 1


@dataclass(frozen=True)
class Errors:
    """Root mean squares over the common times of 2-norms of errors, and the same errors at the end."""

    rms: dict[str, float]
    end: dict[str, float]


def errors(case: Case, solution: Solution, alpha: float) -> Errors:
    """Errors of q, v, lam, mu at the common times, of a against f(t + alpha h), and of the stage multipliers."""
    data, index = solution.steps_data, common_steps(case, solution)
    exact = [case.exact(float(t)) for t in solution.t]
    wanted = {name: np.array([np.asarray(getattr(x, name)) for x in exact]) for name in ("q", "v", "lam", "mu")}
    found = {name: getattr(solution, name) for name in wanted}
    t, h = data.t[index], data.h[index]  # type: ignore[union-attr]
    wanted["a"] = np.array([case.force(float(x)) for x in t + alpha * h])
    found["a"] = data.a[index]  # type: ignore[union-attr]
    if wanted["lam"].shape[1]:
        stage_times = {"lam_start": t - h, "lam_end": t, "lam_mean": t - 0.5 * h}
        start, end = data.lam_start[index], data.lam_end[index]  # type: ignore[union-attr]
        found |= {"lam_start": start, "lam_end": end, "lam_mean": 0.5 * (start + end)}
        wanted |= {name: np.array([case.exact(float(x)).lam for x in times]) for name, times in stage_times.items()}
    difference = {name: np.linalg.norm(found[name] - wanted[name], axis=1) for name in wanted}
    rms = {name: float(np.sqrt(np.mean(d**2))) for name, d in difference.items()}
    return Errors(rms, {name: float(d[-1]) for name, d in difference.items()})


def slope(steps: Sequence[float], measured: Sequence[float]) -> float:
    """Least-squares slope of log(error) over log(step)."""
    return float(np.polyfit(np.log(steps), np.log(measured), 1)[0])


def scaled_drift(case: Case, solution: Solution) -> tuple[float, float]:
    """Largest scaled position and velocity residual over all accepted steps of ``solution`` (output at every step)."""
    problem = case.problem
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0))
    position = velocity = 0.0
    for t, q, v in zip(solution.t, solution.q, solution.v, strict=True):
        at = levels.at(float(t), q, v)
        position = max(position, float(np.max(at.scaled_position(problem.scales.q), initial=0.0)))
        velocity = max(velocity, float(np.max(at.scaled_velocity(problem.scales.v), initial=0.0)))
    return position, velocity


def order_row(id: str, claim: str, orders: dict[str, float], wanted: float, margin: float) -> Row:
    """A row for orders that must all lie within ``margin`` of ``wanted``."""
    text = ", ".join(f"{name} {value:.3f}" for name, value in orders.items())
    passed = all(abs(value - wanted) <= margin for value in orders.values())
    return Row(id=id, claim=claim, measured=text, bound=f"{wanted:.2f} +- {margin:g}", passed=passed)


def below_row(id: str, claim: str, measured: float, bound: float) -> Row:
    """A row for a number that must stay below ``bound``."""
    return Row(id=id, claim=claim, measured=measured, bound=f"< {bound:g}", passed=bool(measured < bound))
