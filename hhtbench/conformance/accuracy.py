"""``hhtbench verify accuracy``: compare ``solve(..., accuracy=...)`` with certified references and random scenes.

For every solver: how often the true error is as small as asked, how often no error can be shown, how much
smaller than asked the error is, and the cost beside the cheapest single run of the same solver that is as accurate.
"""

from __future__ import annotations

import operator
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np

from hhtbench.api import solve
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.conformance.families.errors import known_motion
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.protocol.problem import Problem
from hhtbench.runtime.processes import worker_processes
from hhtbench.solution.result import Status

SOLVERS = ("hht", "ida(form=ggl)", "scipy(method=Radau)", "projected(method=DOP853)")
JUDGED = SOLVERS[:2] + SOLVERS[3:]  # solvers whose median error is judged: Radau's is shown beside them
ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5)
SECONDS = 20.0  # of all runs of one cell
SWEEP = tuple(float(f"{10 ** (-k / 2):.2g}") for k in range(4, 25))  # tolerances of the single runs
DRAWN = (  # the library's parameters times 0.6 to 1.4, drawn once; nothing was tuned on them
    "simple_pendulum(L=0.919, amplitude=-1.84, t_end=4)",
    "bead_chain(n_beads=3, w=0.412, L=0.666)",
    "knife_edge(Om=2.75, incline=0.526)",
    "kapitza_pendulum(A=0.0558, w=84.9, t_end=1)",
    "stiff_spring_pendulum(stiffness=9800.0, m2=0.698)",
    "rolling_sphere_table(Om=2.55, x=1.19)",
    "chaplygin_sleigh(a=0.265, w0=2.62)",
    "sundials_slider_crank(a=0.679, k=0.62, t_end=4)",
    "heavy_top(m=17.9, C=0.533, t_end=0.5)",
    "flyball_governor(ball=5.5, K=888000.0, t_end=1)",
    "planar_chain(n_links=3, t_end=1)",
    "bead_on_rotating_rod(Om=2.1, u0=0.55)",
)
SHOWN, WRONG, UNSHOWN = 0.95, 0.01, 0.10  # least share within what was asked, most beyond three times that, most unshown
NOT_TOO_SMALL = 1 / 20  # least median of the true error over what was asked
HOLDS: dict[str, Callable[[float, float], bool]] = {">=": operator.ge, "<=": operator.le, "<": operator.lt}
OVER_SINGLE = "evaluations over those of the cheapest single run that is as accurate"
COSTS = (5.0, 8.0)  # most of the cheapest single run's evaluations: in the median, in nine of ten cells


@dataclass(frozen=True)
class Cell:
    """Result of one solve with ``accuracy``."""

    problem: str
    solver: str
    accuracy: float
    status: str
    error: float | None  #: true scaled error of q and v at the times where it is known; None: nothing was solved
    bound: float | None
    cost: float | None  #: evaluations over those of the cheapest single run that is as accurate
    extrapolated: float | None  #: true error of the better answer


def cells_of(spec: str) -> list[Cell]:
    """Solve one problem with every solver and accuracy; returns no cells if its motion is not known."""
    warnings.simplefilter("ignore")
    problem = load_problem(spec)
    times, known = truth(problem)
    if times.size == 0:
        return []
    return [cell for solver in SOLVERS for cell in _of_solver(problem, spec, solver, times, known)]


def truth(problem: Problem) -> tuple[Vector, Matrix]:
    """Return times at which the motion is known, (k,), and q and v there divided by their scales, (k, 2n)."""
    times = np.linspace(*problem.t_span, 21)
    if problem.exact is not None or problem.reference is not None:
        times, q, v = known_motion(problem, times)
        return times, _over_scales(problem, q, v)
    found = solve(problem, "collocation(form=ggl)", rtol=1e-13, t_eval=times)
    return found.t, _over_scales(problem, found.q, found.v)


def _over_scales(problem: Problem, q: Matrix, v: Matrix) -> Matrix:
    return np.hstack([q / np.asarray(problem.scales.q), v / np.asarray(problem.scales.v)])


def _error(problem: Problem, found: Any, known: Matrix) -> float | None:
    got = _over_scales(problem, found.q, found.v)
    return float(np.max(np.abs(got - known))) if got.shape == known.shape else None


def _of_solver(problem: Problem, spec: str, solver: str, times: Vector, known: Matrix) -> list[Cell]:
    singles = []
    for rtol in SWEEP:
        found = solve(problem, solver, rtol=rtol, t_eval=times, max_seconds=SECONDS)
        if found.status is Status.declined:
            return []
        if found.success and found.counters.residual_evaluations:
            singles.append((_error(problem, found, known), found.counters.residual_evaluations))
        elif found.status is Status.deadline:
            break
        if singles and singles[-1][0] is not None and singles[-1][0] < min(ACCURACIES) / 3:
            break
    return [_cell(problem, spec, solver, accuracy, times, known, singles) for accuracy in ACCURACIES]


def _cell(
    problem: Problem, spec: str, solver: str, accuracy: float, times: Vector, known: Matrix, singles: list[Any]
) -> Cell:
    found = solve(problem, solver, accuracy=accuracy, t_eval=times, max_seconds=SECONDS)
    cheapest = min((work for error, work in singles if error is not None and error <= accuracy), default=None)
    spent = found.counters.residual_evaluations
    better = found.extrapolated
    return Cell(
        problem=spec,
        solver=solver,
        accuracy=accuracy,
        status=found.status.label,
        error=_error(problem, found, known),
        bound=None if found.error is None else found.error.bound,
        cost=spent / cheapest if cheapest and spent and found.success else None,
        extrapolated=None if better is None else _error(problem, better, known),
    )


def verify_accuracy(progress: Callable[[str], None] | None = None, jobs: int = 1) -> Evidence:
    """Verify all problems on their validated spans and the random scenes, by every solver at every accuracy."""
    began, plans = time.perf_counter(), registered_plans()
    specs = [validated_spec(name, plans) for name in list_problems()] + list(DRAWN)
    cells: list[Cell] = []
    with worker_processes(jobs) as pool:
        for spec, found in zip(specs, pool.map(cells_of, specs), strict=True):
            cells += found
            if progress is not None:
                progress(f"{spec}: {len(found)} cells")
    evidence = evidence_of(cells)
    return replace(evidence, seconds=time.perf_counter() - began)


def evidence_of(cells: Iterable[Cell]) -> Evidence:
    """Turn cells into claims, solver by solver; cells beyond the asked error are named."""
    cells, rows = list(cells), []
    for solver in dict.fromkeys(cell.solver for cell in cells):
        rows += _claims(solver, [cell for cell in cells if cell.solver == solver])
    return Evidence(title="the error that was asked for", rows=tuple(rows))


def _claims(solver: str, cells: list[Cell]) -> list[Row]:
    known = [cell for cell in cells if cell.status == "success" and cell.error is not None]
    share = sorted((cell.error or 0.0) / cell.accuracy for cell in known) or [np.nan]
    costs = sorted(cell.cost for cell in known if cell.cost is not None) or [np.nan]
    unshown = 1 - len(known) / len(cells)
    beyond = [cell for cell in known if (cell.error or 0.0) > 3 * cell.accuracy]
    names = "; ".join(f"{cell.problem} at {cell.accuracy:g}: {cell.error:.1e}" for cell in beyond)
    gains = sorted((cell.extrapolated or 0.0) / (cell.error or np.inf) for cell in known if cell.extrapolated is not None)
    worse = sum(gain > 1.0 for gain in gains) / max(len(gains), 1)
    shown = "share of the cells that claim success whose true error is within what was asked"
    beyond_text = f"share of them beyond three times that{': ' + names if names else ''}"
    better = f"error of the extrapolated answer over that of the run, median of {len(gains)}; {worse:.0%} got worse"
    judged: list[tuple[str, str, float, str, float, str]] = [
        ("within", shown, sum(ratio <= 1.0 for ratio in share) / len(share), ">=", SHOWN, f" of {len(known)}"),
        ("beyond", beyond_text, len(beyond) / len(share), "<=", WRONG, ""),
        ("unshown", "share of all cells that end without a claim", unshown, "<=", UNSHOWN, f" of {len(cells)}"),
        ("size", "median of the true error over what was asked", median(share), ">=", NOT_TOO_SMALL, ""),
        ("cost", f"{OVER_SINGLE}, median", median(costs), "<=", COSTS[0], ""),
        ("cost90", "the same, of nine in ten cells", costs[int(0.9 * (len(costs) - 1))], "<=", COSTS[1], ""),
    ]
    judged += [("better", better, median(gains), "<", 1.0, "")] * bool(gains)
    return [_row(solver, *claim) for claim in judged]


def _row(solver: str, id: str, claim: str, measured: float, relation: str, most: float, of: str) -> Row:
    if id == "size" and solver not in JUDGED:
        return Row(id=f"{solver}/{id}", claim=claim, measured=measured, bound="not judged", passed=None)
    passed, bound = HOLDS[relation](measured, most), f"{relation} {most:g}{of}"
    return Row(id=f"{solver}/{id}", claim=claim, measured=measured, bound=bound, passed=passed)
