"""Compare solvers pairwise on one problem, whether or not its solution is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from tabulate import tabulate

from hhtbench.api import solve
from hhtbench.catalogue.registry import load_problem, load_solver
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.protocol.scales import Scales
from hhtbench.solution.request import Request
from hhtbench.solution.result import Solution

LEVELS = {"position": ("q",), "velocity": ("v",), "acceleration": ("lam", "mu")}  # level of the motion -> what is compared
ROWS = 11  # output times, equal distances
FACTOR = 100.0  # largest difference of two good solvers after a whole run, over the tolerance
FIRST_STEPS, MAX_STEPS = 200, 51_200  # numbers of prescribed steps: doubled until the motion stays
Motion = Mapping[str, Matrix]  # of "q", "v", "lam", "mu": (rows, width)


@dataclass(frozen=True)
class Agreement:
    """Pairwise differences of solvers."""

    names: tuple[str, ...]  #: names of the solvers that reached the end
    matrix: Matrix  #: (k, k) largest scaled difference over all rows; 0 on the diagonal
    left_out: Mapping[str, str]  #: solver -> status and message

    @property
    def spread(self) -> float:
        """Largest pairwise difference: an estimate of the error of the worst solver."""
        return float(np.max(self.matrix, initial=0.0))

    def middle(self) -> int:
        """Return the index of the solver with the smallest median difference from the others."""
        apart = self.matrix + np.diag(np.full(len(self.names), np.nan))
        return int(np.argmin(np.nanmedian(apart, axis=1))) if len(self.names) > 1 else 0

    def table(self, style: str = "simple") -> str:
        """Format the matrix of differences, with numbers of the solvers as headings."""
        count = range(len(self.names))
        rows = [[f"{i + 1} {self.names[i]}", *(f"{self.matrix[i, j]:.0e}" if i != j else "" for j in count)] for i in count]
        heads = ["largest difference", *(str(i + 1) for i in count)]
        return tabulate(rows, headers=heads, tablefmt=style, disable_numparse=True)


def agreement_of(motions: Mapping[str, Motion], scales: Scales, left_out: Mapping[str, str] | None = None) -> Agreement:
    """Compute the matrix of differences of motions given at the same times."""
    names = tuple(motions)
    sizes = _sizes(motions, scales)
    scaled = [_flat(motions[name], sizes) for name in names]
    matrix = np.array([[float(np.max(np.abs(a - b), initial=0.0)) for b in scaled] for a in scaled])
    return Agreement(names, matrix.reshape(len(names), len(names)), dict(left_out or {}))


def agreement(
    problem: Problem | str,
    solvers: Sequence[Solver | str],
    rtol: float = 1e-6,
    levels: Sequence[str] = ("position", "velocity"),
) -> Agreement:
    """Solve ``problem`` by each of ``solvers`` and compare; solvers that fail are left out with the reason.

    Solvers with prescribed steps start with 200 and double them until the motion changes by less than ``rtol``.
    """
    unknown = sorted(set(levels) - set(LEVELS))
    if unknown or not levels:
        raise ProblemError(f"levels must be some of {', '.join(LEVELS)}; got {', '.join(map(str, levels)) or 'none'}.")
    loaded = load_problem(problem)
    times = np.linspace(*loaded.t_span, ROWS)
    names = [name for level in levels for name in LEVELS[level]]
    motions: dict[str, Motion] = {}
    left_out: dict[str, str] = {}
    for entry in solvers:
        solver = load_solver(entry)
        label = entry if isinstance(entry, str) else solver.name
        solution = _solved(loaded, solver, rtol, times)
        if solution.success and solution.t.size == times.size:
            motions[label] = {name: getattr(solution, name) for name in names}
        else:
            left_out[label] = f"{solution.status.label}: {solution.message}"
    return agreement_of(motions, loaded.scales, left_out)


def assert_solvers_agree(
    problem: Problem | str,
    solvers: Sequence[Solver | str],
    rtol: float = 1e-6,
    levels: Sequence[str] = ("position", "velocity"),
    factor: float = FACTOR,
) -> Agreement:
    """Assert that all of ``solvers`` reach the end of ``problem`` and agree pairwise to ``factor * rtol``.

    Parameters
    ----------
    problem
        A Problem or a spec; no reference is needed.
    solvers
        Two or more solvers or specs.
    rtol
        Tolerance of each; solvers with prescribed steps refine them until the motion changes by less.
    levels
        Some of "position" (q), "velocity" (v) and "acceleration" (lam and mu).  Differences are relative to the
        largest size in the motion, at least ``problem.scales``.
    factor
        Largest difference of two motions, divided by ``rtol``.

    Raises
    ------
    AssertionError
        Two differ by more, or one does not reach the end; the text holds the whole matrix.
    """
    if len(solvers) < 2:
        raise ProblemError("solvers must name two or more; one agrees with itself.")
    found = agreement(problem, solvers, rtol, levels)
    faults = [f"{name} ends with {reason}" for name, reason in found.left_out.items()]
    for i, one in enumerate(found.names):
        for j in range(i):
            if found.matrix[i, j] > factor * rtol:
                faults.append(f"{one} and {found.names[j]} differ by {found.matrix[i, j]:.1e}; expected {factor * rtol:.1e}")
    if faults:
        raise AssertionError("\n".join([*faults, found.table()]))
    return found


def _solved(problem: Problem, solver: Solver, rtol: float, times: Vector) -> Solution:
    """Solve with the tolerance, or with doubled numbers of steps until the motion changes by less."""
    declines = [solver.accepts(problem, Request(**asked)) for asked in ({"rtol": rtol}, {"steps": FIRST_STEPS})]
    if declines[0] is None or declines[1] is not None:
        return solve(problem, solver, rtol=rtol, t_eval=times)
    steps, before = FIRST_STEPS, None
    while True:
        found = solve(problem, solver, steps=steps, t_eval=times)
        if not found.success or steps >= MAX_STEPS:
            return found
        if before is not None and np.max(np.abs(_state(found, problem.scales) - _state(before, problem.scales))) <= rtol:
            return found
        steps, before = 2 * steps, found


def _state(solution: Solution, scales: Scales) -> Vector:
    motion = {"q": solution.q, "v": solution.v}
    return _flat(motion, _sizes({"": motion}, scales))


def _sizes(motions: Mapping[str, Motion], scales: Scales) -> dict[str, Vector]:
    """Return the sizes that differences are relative to: the largest of a component in any motion, at least its scale."""
    found: dict[str, Vector] = {}
    for motion in motions.values():
        for name, values in motion.items():
            least = np.maximum(np.max(np.abs(values), axis=0), np.asarray(getattr(scales, name)))
            found[name] = np.maximum(found.get(name, least), least)
    return found


def _flat(motion: Motion, sizes: Mapping[str, Vector]) -> Vector:
    """Concatenate all components, each divided by its size, in one vector."""
    return np.concatenate([(values / sizes[name]).ravel() for name, values in motion.items()])
