"""Runs of the integrator for cases with known motion, and their errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.lowering import ConstraintLevels, Dynamics, compile_function, derive
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Solution, Status
from solvers.hht.adapter import solver
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
from solvers.hht.verify.study import slope

RIGID = "stiff_spring_pendulum(stiffness=inf)"  # differs from k = 1e10 by 1e-9 in q and 1e-5 in v
FLOOR = 1e-11  # weighted errors below this are due to roundoff and references, not to steps

_loaded = cache(load_problem)


@dataclass(frozen=True)
class Case:
    """A problem of the library between two times at which its motion is known."""

    name: str
    t_end: float  #: [s]
    times: int = 1  #: number of equally spaced times at which errors count, the end included
    t_start: float = 0.0  #: [s]
    counts: tuple[int, ...] = ()  #: numbers of steps

    def __str__(self) -> str:
        return self.name

    @property
    def problem(self) -> Problem:
        """The problem, with its own interval."""
        return _loaded(self.name)

    def known(self, t: float) -> Motion:
        """The motion at ``t`` [s], from the closed solution or a row of the reference; the end may be off by roundoff."""
        return _known(self.name, self.t_end if math.isclose(t, self.t_end, rel_tol=1e-12) else t)

    def force(self, t: float) -> Vector:
        """f = M^-1 F (n,) along the known motion."""
        at = self.known(t)
        return _evaluator(self.name)(t, np.asarray(at.q), np.asarray(at.v))


@cache
def _known(name: str, t: float) -> Motion:
    p = _loaded(name)
    return p.exact(t) if p.exact else Motion(*(known_at(p, key, t) for key in Motion._fields))


@cache
def _evaluator(name: str) -> Callable[..., Any]:
    p = _loaded(name)
    return compile_function(_acceleration, derive(p.system, p.t_span[0], p.q0, p.v0))


def _acceleration(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    return dynamics.xp.linalg.solve(dynamics.mass(t, q), dynamics.force(t, q, v))


def known_at(problem: Problem, name: str, t: float) -> Vector:
    """Row at ``t`` [s] of the problem's reference; ``name``: q, v, lam or mu.  Raises ProblemError if there is none."""
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
    """Typical sizes of q and v, (2n,): the problem's scales."""
    n = problem.q0.size
    return np.concatenate([np.broadcast_to(problem.scales.q, n), np.broadcast_to(problem.scales.v, n)])


def weighted_error(problem: Problem, found: Matrix, known: Matrix) -> float:
    """Largest RMS norm over the times of the error over (|x| + scale), to be compared with the tolerance."""
    weighted = (found - known) / (np.abs(known) + typical_sizes(problem))
    return float(np.sqrt(np.mean(weighted**2, axis=1)).max())


@dataclass(frozen=True)
class Run:
    """Result of one run over the whole interval of a problem with known motion."""

    spec: str
    tolerance: float  #: NaN with prescribed steps
    error: float | None  #: largest weighted error over the known times; None where the end was not reached
    status: Status
    accepted: int
    rejected: int

    @property
    def steps(self) -> int:
        """Number of accepted and rejected steps."""
        return self.accepted + self.rejected

    @property
    def ratio(self) -> float | None:
        """Achieved over requested error; None if the error is not above roundoff."""
        return None if self.error is None or self.error <= FLOOR else self.error / self.tolerance

    def __str__(self) -> str:
        if self.error is None:
            return self.status.label
        return "roundoff" if self.ratio is None else f"{self.ratio:.2g}"


def run(spec: str, request: Request, **method: Any) -> Run:
    """Solve ``spec`` by HHT with the options ``method``, as the bench does."""
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
    """Arguments for the multipliers' guesses at the start."""
    return {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}


def solved(name: str, hht: HHT, *start: Any, **request: Any) -> Solution:
    """Call ``hht.solve``; raises ``RuntimeError`` if the run fails, since there is nothing to measure then."""
    solution = hht.solve(*start, **request)
    if not solution.success:
        raise RuntimeError(f"{name}: {solution.status.label}: {solution.message}")
    return solution


def step_by_hand(name: str, hht: HHT) -> State:
    """The state after one more step; raises ``RuntimeError`` if the step fails."""
    if (status := hht.step()) is not Status.success:
        raise RuntimeError(f"{name}: {status.label}: {hht.message}")
    return hht.state


def integrate(case: Case, steps: int | Vector, kind: type[HHT] = HHT, **method: Any) -> Solution:
    """Solve ``case`` with prescribed ``steps``, a number of equal ones or their lengths [s], by class ``kind``."""
    p, t0 = case.problem, case.t_start
    start = (p.q0, p.v0) if t0 == p.t_span[0] else case.known(t0)[:2]
    t1 = case.t_end if isinstance(steps, int) else t0 + float(steps.sum())
    return solved(f"{case} with {method}", kind(p.system, **method), (t0, t1), *start, steps=steps, **guesses(p))


def errors(case: Case, solution: Solution, key: str, ends: Iterable[int], alpha: float = 0.0) -> Vector:
    """2-norms (k,) of the errors of ``key`` after each of ``ends`` (k,), counted in steps.

    ``q``, ``v``, ``lam`` and ``mu`` are those of the rows; ``a`` is compared with f(t + alpha h).  Multipliers of stages
    are ``lam_start`` and ``lam_end`` of the step, their mean ``lam_mean`` at its midpoint, and ``lam_between``, which
    interpolates the stages on both sides of the step's end and is of second order.
    """
    data: Any = solution.steps_data
    index = np.asarray(list(ends)) - 1
    t, h = data.t[index], data.h[index]
    times = {"a": t + alpha * h, "lam_start": t - h, "lam_mean": t - 0.5 * h}.get(key, t)
    if key in Motion._fields:
        found = getattr(solution, key)[index + 1]
    elif key == "lam_mean":
        found = 0.5 * (data.lam_start[index] + data.lam_end[index])
    elif key == "lam_between":
        before, after = h[:, None], data.h[index + 1, None]
        found = (after * data.lam_end[index] + before * data.lam_start[index + 1]) / (before + after)
    else:
        found = getattr(data, key)[index]
    exact = case.force if key == "a" else lambda at: getattr(case.known(at), key.split("_")[0])
    return np.linalg.norm(found - np.array([np.asarray(exact(float(at))) for at in times]), axis=1)


@dataclass(frozen=True)
class Convergence:
    """Runs of one method with more and more steps."""

    case: Case
    runs: list[Solution]
    alpha: float

    @property
    def steps(self) -> list[float]:
        """Mean step lengths [s]."""
        return [(self.case.t_end - self.case.t_start) / run.steps_data.t.size for run in self.runs]  # type: ignore[union-attr]

    def errors(self, key: str) -> list[Vector]:
        """Errors of every run at the times of the case."""
        share = np.arange(1, self.case.times + 1)
        sizes = [run.steps_data.t.size for run in self.runs]  # type: ignore[union-attr]
        ends = [share * size // self.case.times for size in sizes]
        return [errors(self.case, run, key, at, self.alpha) for run, at in zip(self.runs, ends, strict=True)]

    def orders(self, keys: Iterable[str] = ("q", "v", "a")) -> dict[str, float]:
        """Observed orders: slopes of the root mean square errors."""
        sizes = {key: [float(np.sqrt(np.mean(at**2))) for at in self.errors(key)] for key in keys}
        return {key: slope(self.steps, of) for key, of in sizes.items()}


def refine(case: Case, refinements: Iterable[int | Vector], **method: Any) -> Convergence:
    """Solve ``case`` with each of ``refinements``: numbers of equal steps, or their lengths [s]."""
    return Convergence(case, [integrate(case, steps, **method) for steps in refinements], method["alpha"])


def alternating(case: Case, pairs: int) -> Vector:
    """Step lengths h/3, 2h/3, h/3, ... in ``pairs``."""
    h = (case.t_end - case.t_start) / pairs
    return np.tile([h / 3, 2 * h / 3], pairs)


def violations(problem: Problem, t: Vector, q: Matrix, v: Matrix) -> tuple[float, float]:
    """Largest scaled violation of the position and of the velocity level by the rows ``q``, ``v`` (k, n) at ``t`` (k,)."""
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0), full=True)
    found = [levels.at(float(time), *state) for time, *state in zip(t, q, v, strict=True)]
    position = max((float(np.max(at.scaled_position(problem.scales.q), initial=0.0)) for at in found), default=0.0)
    return position, max((float(np.max(at.scaled_velocity(problem.scales.v), initial=0.0)) for at in found), default=0.0)


def scaled_drift(problem: Problem, solution: Solution) -> tuple[float, float]:
    """:func:`violations` at the ends of steps; rows between them are projected, (H47)."""
    steps: Any = solution.interpolant or solution
    return violations(problem, steps.t, steps.q, steps.v)
