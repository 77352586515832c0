"""Certify one solution: solve by several methods at tight tolerances and take their differences as error bars."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.campaign.reference.across import solve_across
from hhtbench.campaign.reference.plan import Entry
from hhtbench.catalogue.registry import load_problem, load_solver
from hhtbench.checks.jumps import Jumps, find_jumps
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.solution.result import Counters, Solution, Status

QUANTITIES = ("q", "v", "lam", "mu")
SAFETY = 2.0  # two results may lie on one side of the truth
FLOOR = 8 * float(np.finfo(np.float64).eps)  # smallest bar: the last bits of a stored double
CLOSED = "closed solution"
WORST_BAR = 1e-5  # largest scaled error bar of a reference
NOTHING = 1e-9  # an observable that stays below is zero up to errors
SAME_TIME = 1e-12  # times nearer than this share of the interval differ by rounding only


class UnknownJumpError(ProblemError):
    """The effect of a jump of a prescribed velocity on the motion is not known."""


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """Comparison of another solver with the stored values."""

    solver: str
    form: str
    independent: bool  #: another family and another form
    status: str
    difference: dict[str, Vector]  #: quantity -> largest scaled difference at every time, (k,); empty unless it succeeded
    seconds: float

    @property
    def confirms(self) -> bool:
        """True if it is independent and succeeded, so that its difference bounds the error."""
        return self.independent and bool(self.difference)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Reference values at all times with their error bars."""

    entry: Entry
    t: Vector  #: (k,) [s]
    values: dict[str, Matrix]  #: q, v, lam, mu and observables -> (k, size)
    bars: dict[str, Vector]  #: the same -> (k,) scaled error bars, growing with time
    scales: dict[str, Vector]  #: the same -> (size,)
    confirmations: tuple[Confirmation, ...]
    jumps: tuple[float, ...] = ()  #: times at which a prescribed velocity jumps [s]; no row lies there

    @property
    def certified(self) -> bool:
        """True if an independent method agrees to at least ``WORST_BAR`` in q and v."""
        return all(float(np.max(self.bars[name])) <= WORST_BAR for name in ("q", "v"))

    def digits(self, quantity: str) -> float:
        """Return the decimal digits of ``quantity`` that its largest error bar leaves."""
        return float(-np.log10(np.max(self.bars[quantity], initial=FLOOR)))


def certify(entry: Entry, tell: Callable[[str], None] = lambda text: None) -> Certificate:
    """Solve with every method of the entry and compare, piece by piece where prescribed velocities jump.

    A closed solution counts as an independent method.  The bar also covers the effect of the last bit of the start, which
    is known to double precision only.

    Raises
    ------
    ProblemError
        The first solver does not reach the end, so there is nothing to store.
    UnknownJumpError
        The effect of a jump on the motion is not known.
    """
    problem = load_problem(entry.spec)
    jumps, times = find_jumps(problem), times_of(entry, problem)
    if jumps.declined:
        raise UnknownJumpError(f"{jumps.declined}.")
    at_jump = np.abs(times[:, None] - jumps.times) <= SAME_TIME * abs(problem.t_span[1] - problem.t_span[0])
    case = _Case(entry=entry, problem=problem, jumps=jumps, times=times[~at_jump.any(axis=1)], tell=tell)
    first, _ = case.solved(problem, entry.first, entry.rtol)
    if not first.success:
        raise ProblemError(f"{entry.name}: {entry.first} ended with {first.status.label}: {first.message}")
    values = values_of(problem, first)
    scales = scales_of(problem, values)
    others = [case.confirmation(solver, values, scales) for solver in entry.second]
    others += [] if problem.exact is None else [case.closed(values, scales)]
    others += [case.moved_start(values, scales)] if any(other.confirms for other in others) else []
    bars = {name: _bar(name, others, case.times.size) for name in values}
    return Certificate(
        entry=entry,
        t=case.times,
        values=values,
        bars=bars,
        scales=scales,
        confirmations=tuple(others),
        jumps=tuple(jumps.times.tolist()),
    )


def times_of(entry: Entry, problem: Problem) -> Vector:
    """Merge the stated times and the grid in the direction of the motion; a stated time replaces an equal grid point."""
    t0, t1 = problem.t_span
    stated = np.array(entry.times, dtype=np.float64)
    outside = stated[(stated < min(t0, t1)) | (stated > max(t0, t1))]
    if outside.size:
        raise ProblemError(f"{entry.name}: the time {outside[0]:g} s lies outside of {entry.spec}, [{t0:g}, {t1:g}] s.")
    grid = np.linspace(t0, t1, entry.grid + 1) if entry.grid else np.zeros(0)
    near = np.min(np.abs(grid[:, None] - stated), axis=1, initial=np.inf) <= SAME_TIME * abs(t1 - t0)
    times = np.sort(np.concatenate([stated, grid[~near]]))
    return times if t1 > t0 else times[::-1]


def values_of(problem: Problem, solution: Solution) -> dict[str, Matrix]:
    """Return all quantities of a reference, (k, size) each; quantities without entries are left out."""
    found = {name: np.asarray(getattr(solution, name)) for name in QUANTITIES}
    found = {name: values for name, values in found.items() if values.shape[1]}
    rows = list(zip(solution.t, solution.q, solution.v, solution.lam, strict=True))
    for name, function in problem.observables.items():
        found[f"observable {name}"] = np.array([np.ravel(function(float(t), *state)) for t, *state in rows], dtype=float)
    return found


def scales_of(problem: Problem, values: dict[str, Matrix]) -> dict[str, Vector]:
    """Return typical sizes of all quantities: the problem's scales, and the largest value of an observable."""
    scales = {}
    for name, rows in values.items():
        own = getattr(problem.scales, name, None)
        size = np.max(np.abs(rows), axis=0) if own is None else np.asarray(own, dtype=np.float64)
        scales[name] = np.broadcast_to(np.where(size > NOTHING, size, 1.0), rows.shape[1:])
    return scales


@dataclass(frozen=True, kw_only=True)
class _Case:
    """Data of one entry while it is being certified."""

    entry: Entry
    problem: Problem
    jumps: Jumps
    times: Vector
    tell: Callable[[str], None]

    def solved(self, problem: Problem, solver: str, rtol: float) -> tuple[Solution, float]:
        """Solve with output at the times of the reference; return the solution and the seconds it took."""
        self.tell(f"{self.entry.name}: {solver}")
        started = time.perf_counter()
        solution = solve_across(problem, solver, self.jumps, self.times, rtol=rtol, seconds=self.entry.seconds)
        return solution, time.perf_counter() - started

    def confirmation(self, solver: str, values: dict[str, Matrix], scales: dict[str, Vector]) -> Confirmation:
        """Compare the result of another solver with the stored values."""
        solution, seconds = self.solved(self.problem, solver, self.entry.second_rtol)
        mine, other = load_solver(self.entry.first), load_solver(solver)
        forms = str(getattr(mine, "form", "")), str(getattr(other, "form", ""))
        return Confirmation(
            solver=solver,
            form=forms[1],
            independent=_family(mine) != _family(other) and forms[0] != forms[1],
            status=solution.status.label,
            difference=_differences(values_of(self.problem, solution), values, scales) if solution.success else {},
            seconds=seconds,
        )

    def closed(self, values: dict[str, Matrix], scales: dict[str, Vector]) -> Confirmation:
        """Compare the closed solution with the stored values."""
        exact = self.problem.exact
        motions = [] if exact is None else [exact(float(t)) for t in self.times]
        solution = _as_solution(self.times, motions)
        difference = _differences(values_of(self.problem, solution), values, scales)
        return Confirmation(solver=CLOSED, form="", independent=True, status="success", difference=difference, seconds=0.0)

    def moved_start(self, values: dict[str, Matrix], scales: dict[str, Vector]) -> Confirmation:
        """Run the first solver again from a start moved to neighbouring doubles, alternately up and down, and compare."""
        sign = np.where(np.arange(self.problem.q0.size) % 2, -np.inf, np.inf)
        q0, v0 = _neighbour(self.problem.q0, sign), _neighbour(self.problem.v0, -sign)
        solution, seconds = self.solved(replace(self.problem, q0=q0, v0=v0), self.entry.first, self.entry.rtol)
        return Confirmation(
            solver=f"{self.entry.first} from a start moved by its last bit",
            form=str(getattr(load_solver(self.entry.first), "form", "")),
            independent=False,
            status=solution.status.label,
            difference=_differences(values_of(self.problem, solution), values, scales) if solution.success else {},
            seconds=seconds,
        )


def _neighbour(x: Vector, direction: Vector) -> Vector:
    """Return the next double towards ``direction``; zeros are exact and stay."""
    return np.where(x == 0, x, np.nextafter(x, direction))


def _as_solution(t: Vector, motions: list[Motion]) -> Solution:
    q, v, lam, mu = (np.array(list(parts), dtype=np.float64) for parts in zip(*motions, strict=True))
    return Solution(t=t, q=q, v=v, lam=lam, mu=mu, status=Status.success, message=CLOSED, counters=Counters())


def _differences(found: dict[str, Matrix], values: dict[str, Matrix], scales: dict[str, Vector]) -> dict[str, Vector]:
    return {name: np.max(np.abs(found[name] - rows) / scales[name], axis=1) for name, rows in values.items()}


FAMILIES = {"Radau": "Radau IIA", "radau": "Radau IIA", "bdf": "BDF", "BDF": "BDF", "DOP853": "explicit Runge-Kutta"}


def _family(solver: Any) -> str:
    """Return the method family of a solver; two codes of one method are one family."""
    method = str(getattr(solver, "method", solver.name))
    return FAMILIES.get(method, method)


def _bar(name: str, others: list[Confirmation], count: int) -> Vector:
    """Return the error bar at every time, nondecreasing in time; infinite if nothing confirms.  The last entry is the
    moved start.

    It is the distance to the closed solution if there is one, since that is the error; else SAFETY times the smallest
    difference of an independent solver; and in both cases at least the effect of the last bit of the start.
    """
    closed = [other for other in others if other.solver == CLOSED]
    found = [other.difference[name] for other in closed or others if other.confirms]
    if not found or not others[-1].difference:
        return np.full(count, np.inf)
    closest = min(found, key=lambda difference: float(np.max(difference)))
    return np.maximum(SAFETY * np.maximum.accumulate(np.maximum(closest, others[-1].difference[name])), FLOOR)
