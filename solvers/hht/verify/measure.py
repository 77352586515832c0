"""Runs of the integrator over cases with known motion, and their errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import ProblemError
from hhtbench.lowering import ConstraintLevels, Dynamics, compile_function, derive
from hhtbench.protocol import Motion, Problem
from hhtbench.request import Request
from hhtbench.result import Solution, Status
from solvers.hht.adapter import solver
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
from solvers.hht.verify.study import slope

RIGID = "stiff_spring_pendulum(stiffness=inf)"  # differs from k = 1e10 by 1e-9 in q and 1e-5 in v
FLOOR = 1e-11  # weighted errors below it are roundoff and limits of references, not of steps


@dataclass(frozen=True)
class Case:
    """A registered problem with an exact solution, the interval and the common times its errors are measured at."""

    name: str
    t_end: float  #: [s]
    times: int  #: number of common times, equally spaced, the end included

    def __str__(self) -> str:
        return self.name

    @property
    def problem(self) -> Problem:
        """With its own interval."""
        return _loaded(self.name)

    @property
    def span(self) -> tuple[float, float]:
        """[s]."""
        return self.problem.t_span[0], self.t_end

    def exact(self, t: float) -> Motion:
        """The motion at ``t`` [s]."""
        return _exact(self.name, t)

    def force(self, t: float) -> Vector:
        """f = M^-1 F (n,) along it."""
        at, n = self.exact(t), self.problem.q0.size
        packed = _evaluator(self.name)(t, np.asarray(at.q), np.asarray(at.v))
        return np.linalg.solve(packed[n:].reshape(n, n), packed[:n])


_loaded = cache(load_problem)


@cache
def _exact(name: str, t: float) -> Motion:
    return _loaded(name).exact(t)  # type: ignore[misc]


@cache
def _evaluator(name: str) -> Callable[..., Any]:
    p = _loaded(name)
    return compile_function(_force_and_mass, derive(p.system, p.t_span[0], p.q0, p.v0))


def _force_and_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    return dynamics.xp.concatenate([dynamics.force(t, q, v), dynamics.mass(t, q).ravel()])


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


def known_motion(problem: Problem) -> tuple[Vector, Matrix]:
    """Times [s] (k,) and [q, v] (k, 2n) of the closed solution or the reference."""
    if problem.exact is None and problem.reference is None:
        problem = load_problem(RIGID)
    if problem.exact is not None:
        times = np.linspace(*problem.t_span, 21)
        motions = [problem.exact(float(t)) for t in times]
        return times, np.array([np.concatenate([np.asarray(x.q), np.asarray(x.v)]) for x in motions])
    reference = problem.reference or {}
    return np.asarray(reference["t"]), np.hstack([reference["q"], reference["v"]])


def typical_sizes(problem: Problem) -> Vector:
    """Of q and v, (2n,)."""
    n = problem.q0.size
    return np.concatenate([np.broadcast_to(problem.scales.q, n), np.broadcast_to(problem.scales.v, n)])


def weighted_error(problem: Problem, found: Matrix, known: Matrix) -> float:
    """Largest RMS norm over the times of the error over (|x| + scale): what rtol and atol ask for, over the tolerance."""
    weighted = (found - known) / (np.abs(known) + typical_sizes(problem))
    return float(np.sqrt(np.mean(weighted**2, axis=1)).max())


@dataclass(frozen=True)
class Run:
    """One run over the whole interval of a problem with known motion."""

    spec: str
    tolerance: float  #: NaN with prescribed steps
    error: float | None  #: largest weighted error over the known times; None where the end was not reached
    status: Status
    accepted: int
    rejected: int

    @property
    def steps(self) -> int:
        """Accepted and rejected ones."""
        return self.accepted + self.rejected

    @property
    def ratio(self) -> float | None:
        """Achieved over requested error; None where there is no error above roundoff."""
        return None if self.error is None or self.error <= FLOOR else self.error / self.tolerance

    def __str__(self) -> str:
        if self.error is None:
            return self.status.label
        return "roundoff" if self.ratio is None else f"{self.ratio:.2g}"


def run(spec: str, request: Request, **method: Any) -> Run:
    """``spec`` by HHT with the options ``method``, as the bench runs it."""
    problem, hht = _loaded(spec), solver(**method)
    times, known = known_motion(problem)
    tolerance = math.nan if request.rtol is None else request.rtol
    if hht.accepts(problem, request) is not None:
        return Run(spec, tolerance, None, Status.declined, 0, 0)
    solution = hht.solve(problem, replace(request, t_eval=times))
    c = solution.counters
    error = weighted_error(problem, np.hstack([solution.q, solution.v]), known) if solution.success else None
    rejected = (c.steps_rejected_error or 0) + (c.steps_rejected_newton or 0)
    return Run(spec, tolerance, error, solution.status, c.steps_accepted or 0, rejected)


def guesses(problem: Problem) -> dict[str, Any]:
    """Of the multipliers at the start."""
    return {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}


def solved(name: str, hht: HHT, *start: Any, **request: Any) -> Solution:
    """``hht.solve``; :func:`step_by_hand` is the same for single steps.

    Raises
    ------
    RuntimeError
        It failed: a verification has nothing to measure then.
    """
    solution = hht.solve(*start, **request)
    if not solution.success:
        raise RuntimeError(f"{name}: {solution.status.label}: {solution.message}")
    return solution


def step_by_hand(name: str, hht: HHT) -> State:
    """The state after one more step.

    Raises
    ------
    RuntimeError
        It failed.
    """
    if (status := hht.step()) is not Status.success:
        raise RuntimeError(f"{name}: {status.label}: {hht.message}")
    return hht.state


def integrate(case: Case, steps: int | Vector, **method: Any) -> Solution:
    """``case`` with the given steps, output at its common times."""
    p, t_eval = case.problem, np.linspace(*case.span, case.times + 1)[1:]
    hht = HHT(p.system, **method)
    return solved(f"{case} with {method}", hht, case.span, p.q0, p.v0, steps=steps, t_eval=t_eval, **guesses(p))


def errors(case: Case, solution: Solution, alpha: float) -> dict[str, Vector]:
    """2-norms (k,) of the errors at the common times.

    Those of q, v, lam, mu, of a against f(t + alpha h), and of the stage multipliers.
    """
    data: Any = solution.steps_data
    index = (np.arange(1, case.times + 1) * data.t.size) // case.times - 1  # of the steps that end at the common times
    exact = [case.exact(float(t)) for t in solution.t]
    wanted = {name: np.array([np.asarray(getattr(x, name)) for x in exact]) for name in ("q", "v", "lam", "mu")}
    found = {name: getattr(solution, name) for name in wanted}
    t, h = data.t[index], data.h[index]
    wanted["a"] = np.array([case.force(float(x)) for x in t + alpha * h])
    found["a"] = data.a[index]
    if wanted["lam"].shape[1]:
        stage_times = {"lam_start": t - h, "lam_end": t, "lam_mean": t - 0.5 * h}
        start, end = data.lam_start[index], data.lam_end[index]
        found |= {"lam_start": start, "lam_end": end, "lam_mean": 0.5 * (start + end)}
        wanted |= {name: np.array([case.exact(float(x)).lam for x in times]) for name, times in stage_times.items()}
    return {name: np.linalg.norm(found[name] - wanted[name], axis=1) for name in wanted}


@dataclass(frozen=True)
class Convergence:
    """What refining the steps does to the errors of one method."""

    steps: list[float]  #: mean lengths [s]
    rms: dict[str, list[float]]  #: of :func:`errors` over the common times, for each length
    end: dict[str, list[float]]  #: the same at the last of them

    def orders(self, keys: Iterable[str] = ("q", "v", "a")) -> dict[str, float]:
        """Slopes of the root mean squares."""
        return {key: slope(self.steps, self.rms[key]) for key in keys}


def refine(case: Case, refinements: Iterable[int | Vector], **method: Any) -> Convergence:
    """``case`` with ever more steps: numbers of equal ones, or their lengths [s]."""
    runs = [integrate(case, steps, **method) for steps in refinements]
    lengths = [(case.t_end - case.span[0]) / run.steps_data.t.size for run in runs]  # type: ignore[union-attr]
    found = [errors(case, run, method["alpha"]) for run in runs]
    rms = {key: [float(np.sqrt(np.mean(at[key] ** 2))) for at in found] for key in found[0]}
    return Convergence(lengths, rms, {key: [float(at[key][-1]) for at in found] for key in found[0]})


def alternating(case: Case, periods: int) -> Vector:
    """Steps h/3, 2h/3, h/3, ... with ``periods`` pairs."""
    h = (case.t_end - case.span[0]) / periods
    return np.tile([h / 3, 2 * h / 3], periods)


def violations(problem: Problem, t: Vector, q: Matrix, v: Matrix) -> tuple[float, float]:
    """Largest scaled position and velocity residual of the rows ``q``, ``v`` (k, n) at ``t`` (k,)."""
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0), full=True)
    found = [levels.at(float(time), *state) for time, *state in zip(t, q, v, strict=True)]
    position = max((float(np.max(at.scaled_position(problem.scales.q), initial=0.0)) for at in found), default=0.0)
    return position, max((float(np.max(at.scaled_velocity(problem.scales.v), initial=0.0)) for at in found), default=0.0)


def scaled_drift(problem: Problem, solution: Solution) -> tuple[float, float]:
    """:func:`violations` of the ends of the steps: rows between them are moved onto the constraints, (H47)."""
    steps: Any = solution.interpolant or solution
    return violations(problem, steps.t, steps.q, steps.v)
