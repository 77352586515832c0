"""``hhtbench verify control``: what error control delivers, over all problems and tolerances."""

from __future__ import annotations

import time
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np

from hhtbench import list_problems, load_problem
from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Curve, Evidence, Plot, Row
from hhtbench.processes import worker_processes
from hhtbench.protocol import Problem
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.request import Request
from solvers.hht.adapter import solver
from solvers.hht.verify.chrono import solve_as_chrono
from solvers.hht.verify.effectivity import effectivities
from solvers.hht.verify.measure import Progress, slope

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
STIFF = tuple(f"stiff_spring_pendulum(stiffness=1e{k})" for k in (6, 8, 10, 12))
RIGID = "stiff_spring_pendulum(stiffness=inf)"  # differs from k = 1e10 by 1e-9 in q and 1e-5 in v
SEPARATED = ("stiff_spring_pendulum(stiffness=1e4)", "slider_crank_flexible", "kapitza_pendulum", "andrews")
ALPHA = {"default": -0.05, "stiff": -0.3}
NEAR = 10.0  # factor around the calibrated error that counts as what was asked for
SHARE = 0.9  # of the runs that must be so near
SLOPE = 0.2  # how far the slope of error over tolerance may lie from 1
REJECTED = 0.15  # share of rejected steps
MAX_SECONDS = 60.0  # of one solve [s]
FLOOR = 1e-11  # errors below it are roundoff and limits of references, not of steps


@dataclass(frozen=True)
class ControlledRun:
    """One controlled run."""

    spec: str
    tolerance: float
    error: float | None  #: largest weighted error over the known times; None where the end was not reached
    status: str
    accepted: int
    rejected: int
    evaluations: int
    seconds: float


def run(spec: str, tolerance: float, alpha: float, rule: str = "error") -> ControlledRun:
    """``spec`` at ``rtol`` = ``tolerance`` and absolute tolerances of that times the problem's scales."""
    problem = load_problem(spec)
    times, known = known_motion(problem)
    began = time.perf_counter()
    request = Request(rtol=tolerance, t_eval=times, max_seconds=MAX_SECONDS)
    chrono = rule == "chrono"
    solution = solve_as_chrono(problem, request, alpha) if chrono else solver(alpha=alpha).solve(problem, request)
    c = solution.counters
    error = weighted_error(problem, np.hstack([solution.q, solution.v]), known) if solution.success else None
    return ControlledRun(
        spec=spec,
        tolerance=tolerance,
        error=error,
        status=solution.status.label,
        accepted=c.steps_accepted or 0,
        rejected=(c.steps_rejected_error or 0) + (c.steps_rejected_newton or 0),
        evaluations=c.residual_evaluations or 0,
        seconds=time.perf_counter() - began,
    )


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


def weighted_error(problem: Problem, found: Matrix, known: Matrix) -> float:
    """Largest RMS norm over the times of the error over (|x| + scale): what rtol and atol ask for, over the tolerance."""
    n = problem.q0.size
    scales = np.concatenate([np.broadcast_to(problem.scales.q, n), np.broadcast_to(problem.scales.v, n)])
    return float(np.sqrt(np.mean(((found - known) / (np.abs(known) + scales)) ** 2, axis=1)).max())


def verify_control(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Achieved over requested error, slopes, rejections, effectivity of the estimate, stiff springs, and Chrono's rule.

    Parameters
    ----------
    progress
        Told what is finished, a line each.
    jobs
        Worker processes.  The rows do not depend on it.
    """
    tell = progress or (lambda line: None)
    began = time.perf_counter()
    plan = registered_plans()
    specs = [validated_spec(name, plan) for name in list_problems()]
    cells = [(spec, tolerance, ALPHA["default"], "error") for spec in specs for tolerance in TOLERANCES]
    cells += [(spec, tolerance, ALPHA["stiff"], "error") for spec in STIFF for tolerance in TOLERANCES[:3]]
    cells += [(spec, 1e-4, ALPHA["default"], "chrono") for spec in SEPARATED]
    with worker_processes(jobs) as pool:
        waiting = {pool.submit(run, *cell): cell for cell in cells}
        effective = pool.submit(effectivities)
        for done in as_completed(waiting):
            tell(f"done: {waiting[done][0]} at {waiting[done][1]:g}")
        runs = {cell: future.result() for future, cell in waiting.items()}
        rows = list(effective.result())
    controlled = {spec: [runs[spec, tol, ALPHA["default"], "error"] for tol in TOLERANCES] for spec in specs}
    rows += judged(controlled)
    rows += [
        row for spec in STIFF for row in stiff_rows(spec, [runs[spec, t, ALPHA["stiff"], "error"] for t in TOLERANCES[:3]])
    ]
    rows += [compared(spec, runs[spec, 1e-4, ALPHA["default"], "chrono"], controlled) for spec in SEPARATED]
    return Evidence(
        title="Error control: what is asked for and what comes",
        rows=tuple(rows),
        plots=(drawn(controlled),),
        seconds=time.perf_counter() - began,
    )


def judged(controlled: dict[str, list[ControlledRun]]) -> list[Row]:
    """Per problem the ratios over their middle and the slope; over all runs the share that is near, and rejections."""
    rows, near, runs = [], 0, [run for own in controlled.values() for run in own]
    for spec, own in controlled.items():
        told = [(run.tolerance, run.error) for run in own if run.error is not None and run.error > FLOOR]
        ratios = {tolerance: error / tolerance for tolerance, error in told}
        constant = float(np.exp(np.mean(np.log(list(ratios.values()))))) if ratios else 1.0
        near += sum(1 / NEAR <= ratio / constant <= NEAR for ratio in ratios.values())
        near += sum(run.error is not None and run.error <= FLOOR for run in own)
        text = ", ".join(f"{_ratio(run)}" for run in own)
        rows.append(_shown(f"ratio/{spec}", f"{spec}: achieved/requested at 1e-2 .. 1e-6; constant {constant:.2g}", text))
        rows.append(_slope(spec, told))
    share = near / len(runs)
    claim = f"runs whose achieved/requested error lies within a factor of {NEAR:g} of its problem's constant"
    rows.append(_row("ratio/all", claim, f"{near} of {len(runs)}: {share:.0%}", f">= {SHARE:.0%}", share >= SHARE))
    accepted, rejected = sum(run.accepted for run in runs), sum(run.rejected for run in runs)
    part = rejected / max(1, accepted + rejected)
    worst = max(runs, key=lambda run: run.rejected / max(1, run.accepted + run.rejected))
    text = f"{part:.1%}; most in {worst.spec} at {worst.tolerance:g}: {worst.rejected} of {worst.accepted + worst.rejected}"
    rows.append(_row("rejected/all", "rejected steps, of all runs together", text, f"< {REJECTED:.0%}", part < REJECTED))
    return rows


def _ratio(run: ControlledRun) -> str:
    if run.error is None:
        return run.status
    return "roundoff" if run.error <= FLOOR else f"{run.error / run.tolerance:.2g}"


def _slope(spec: str, told: list[tuple[float, float]]) -> Row:
    if len(told) < 3:
        return _shown(f"slope/{spec}", f"{spec}: slope of error over tolerance", "fewer than three errors above roundoff")
    found = slope([tolerance for tolerance, _ in told], [error for _, error in told])
    claim = f"{spec}: slope of error over tolerance, both logarithmic"
    return _row(f"slope/{spec}", claim, f"{found:.2f}", f"1 +- {SLOPE:g}", abs(found - 1) <= SLOPE)


def stiff_rows(spec: str, own: list[ControlledRun]) -> list[Row]:
    """The row of a stiff spring: every error within NEAR times its tolerance."""
    text = ", ".join(f"{_ratio(run)} in {run.accepted} steps" for run in own)
    claim = f"{spec}, alpha {ALPHA['stiff']}: achieved/requested at {', '.join(f'{run.tolerance:g}' for run in own)}"
    passed = all(run.error is not None and run.error <= NEAR * run.tolerance for run in own)
    return [_row(f"stiff/{spec}", claim, text, f"< {NEAR:g}", passed)]


def compared(spec: str, chrono: ControlledRun, controlled: dict[str, list[ControlledRun]]) -> Row:
    """A row, not judged, with the errors and the work of both kinds of step control."""
    own = next((run for run in controlled.get(spec, []) if run.tolerance == chrono.tolerance), None)
    own = own or run(spec, chrono.tolerance, ALPHA["default"])
    errors = [f"{run.error:.1e}" if run.error is not None else run.status for run in (chrono, own)]
    text = f"error {errors[0]} with {chrono.evaluations:,} evaluations; error control: {errors[1]} with {own.evaluations:,}"
    return _shown(f"chrono/{spec}", f"{spec}: Chrono's rule (double after five easy steps, halve on failure)", text)


def _row(id: str, claim: str, measured: str, bound: str, passed: bool) -> Row:
    return Row(id=id, claim=claim, measured=measured, bound=bound, passed=passed)


def _shown(id: str, claim: str, measured: str) -> Row:
    return Row(id=id, claim=claim, measured=measured, bound="not judged", passed=None)


def drawn(controlled: dict[str, list[ControlledRun]]) -> Plot:
    """Error over tolerance, a curve for every problem that has errors above roundoff."""
    curves: list[Curve] = []
    for spec, own in controlled.items():
        told = [run for run in own if run.error is not None and run.error > FLOOR]
        x, y = tuple(run.tolerance for run in told), tuple(run.error for run in told if run.error)
        curves += [Curve(label=spec, x=x, y=y)] if told else []
    return Plot(
        id="control",
        title="Achieved over requested error",
        caption="Largest weighted error of q and v over time against the tolerance; the guide line has slope one.",
        x_label="tolerance",
        y_label="error",
        curves=tuple(curves),
        slope=1.0,
    )
