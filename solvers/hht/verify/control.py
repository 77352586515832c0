"""``hhtbench verify control``: what error control delivers, over all problems and tolerances, and its estimate.

The estimate is compared with the local error itself, computed by another method from the same state.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hhtbench import list_problems, load_problem
from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Curve, Evidence, Plot, Row
from hhtbench.protocol import Problem
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.request import Request
from hhtbench.result import Status
from solvers.collocation import solver as collocation
from solvers.hht.adapter import solver
from solvers.hht.control.tolerances import Tolerances, make_tolerances
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
from solvers.hht.verify.chrono import solve_as_chrono
from solvers.hht.verify.measure import guesses
from solvers.hht.verify.study import Method, Progress, collected, run_all, shown_row, slope
from solvers.projected import solver as projected

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
STIFF = tuple(f"stiff_spring_pendulum(stiffness=1e{k})" for k in (6, 8, 10, 12))
RIGID = "stiff_spring_pendulum(stiffness=inf)"  # differs from k = 1e10 by 1e-9 in q and 1e-5 in v
SEPARATED = ("stiff_spring_pendulum(stiffness=1e4)", "slider_crank_flexible", "kapitza_pendulum", "andrews")
DEFAULT, DAMPED = -0.05, -0.3  # alpha; the second of stiff springs
NEAR = 10.0  # factor around the calibrated error that counts as what was asked for
SHARE = 0.9  # of the runs that must be so near
SLOPE = 0.2  # how far the slope of error over tolerance may lie from 1
REJECTED = 0.15  # share of rejected steps
MAX_SECONDS = 60.0  # of one solve [s]
FLOOR = 1e-11  # errors below it are roundoff and limits of references, not of steps
ESTIMATED = ("jay_negrut_test1", "jay_negrut_pendulum", "andrews", "knife_edge", "rolling_disk3d_steady", "flyball_governor")
METHODS: tuple[Method, ...] = (
    {"alpha": -0.05},
    {"alpha": -0.3},
    {"alpha": -0.3, "b": 0.25},
    {"alpha": -0.15, "reaction": "midpoint"},
    {"alpha": 0.0, "reaction": "predictor"},
)
ESTIMATE_TOLERANCE = 1e-5
NONLINEAR = ("jay_negrut_test1",)  # its reaction: there is no underlying ODE by one linear solve
STEPS = 40  # looked at along each run, every third
RANGE = (0.8, 1.25)  # of the middle of estimated over true local error


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

    @property
    def ratio(self) -> float | None:
        """Achieved over requested error; None where there is no error above roundoff."""
        return None if self.error is None or self.error <= FLOOR else self.error / self.tolerance

    def __str__(self) -> str:
        if self.error is None:
            return self.status
        return "roundoff" if self.ratio is None else f"{self.ratio:.2g}"


Runs = list[ControlledRun]  # of one problem, one for each tolerance


def run(spec: str, tolerance: float, alpha: float, rule: str = "error") -> ControlledRun:
    """``spec`` at ``rtol`` = ``tolerance`` and absolute tolerances of that times the problem's scales."""
    problem = load_problem(spec)
    times, known = known_motion(problem)
    request = Request(rtol=tolerance, t_eval=times, max_seconds=MAX_SECONDS)
    chrono = rule == "chrono"
    solution = solve_as_chrono(problem, request, alpha) if chrono else solver(alpha=alpha).solve(problem, request)
    c = solution.counters
    return ControlledRun(
        spec=spec,
        tolerance=tolerance,
        error=weighted_error(problem, np.hstack([solution.q, solution.v]), known) if solution.success else None,
        status=solution.status.label,
        accepted=c.steps_accepted or 0,
        rejected=(c.steps_rejected_error or 0) + (c.steps_rejected_newton or 0),
        evaluations=c.residual_evaluations or 0,
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

    ``progress`` and ``jobs`` are those of :func:`~solvers.hht.verify.study.verify`.
    """
    began, plan = time.perf_counter(), registered_plans()
    specs = [validated_spec(name, plan) for name in list_problems()]
    cells = [(spec, tolerance, DEFAULT, "error") for spec in specs for tolerance in TOLERANCES]
    cells += [(spec, tolerance, DAMPED, "error") for spec in STIFF for tolerance in TOLERANCES[:3]]
    cells += [(spec, 1e-4, DEFAULT, rule) for spec in SEPARATED for rule in ("error", "chrono")]
    cells = list(dict.fromkeys(cells))
    runs = dict(zip(cells, run_all([(run, *cell) for cell in cells], progress, jobs), strict=True))
    items = run_all([(quartiles, spec, method) for spec in ESTIMATED for method in METHODS], progress, jobs)
    controlled = {spec: [runs[spec, tolerance, DEFAULT, "error"] for tolerance in TOLERANCES] for spec in specs}
    items += judged(controlled)
    items += [stiff_row([runs[spec, tolerance, DAMPED, "error"] for tolerance in TOLERANCES[:3]]) for spec in STIFF]
    items += [compared(*(runs[spec, 1e-4, DEFAULT, rule] for rule in ("chrono", "error"))) for spec in SEPARATED]
    return collected("Error control: what is asked for and what comes", [*items, drawn(controlled.values())], began)


def judged(controlled: dict[str, Runs]) -> list[Row]:
    """Per problem the ratios over their middle and the slope; over all runs the share that is near, and rejections."""
    rows, near, runs = [], 0, [run for own in controlled.values() for run in own]
    for spec, own in controlled.items():
        ratios = [run.ratio for run in own if run.ratio is not None]
        constant = float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0
        near += sum(1 / NEAR <= ratio / constant <= NEAR for ratio in ratios)
        near += sum(run.error is not None and run.ratio is None for run in own)
        claim = f"{spec}: achieved/requested at 1e-2 .. 1e-6; constant {constant:.2g}"
        rows += [shown_row(f"ratio/{spec}", claim, ", ".join(map(str, own))), _slope_row(spec, own)]
    share = near / len(runs)
    claim = f"runs whose achieved/requested error lies within a factor of {NEAR:g} of its problem's constant"
    text = f"{near} of {len(runs)}: {share:.0%}"
    rows.append(Row(id="ratio/all", claim=claim, measured=text, bound=f">= {SHARE:.0%}", passed=share >= SHARE))
    accepted, rejected = sum(run.accepted for run in runs), sum(run.rejected for run in runs)
    part = rejected / max(1, accepted + rejected)
    worst = max(runs, key=lambda run: run.rejected / max(1, run.accepted + run.rejected))
    text = f"{part:.1%}; most in {worst.spec} at {worst.tolerance:g}: {worst.rejected} of {worst.accepted + worst.rejected}"
    claim = "rejected steps, of all runs together"
    return [*rows, Row(id="rejected/all", claim=claim, measured=text, bound=f"< {REJECTED:.0%}", passed=part < REJECTED)]


def _curve(runs: Runs) -> Curve:
    """Errors above roundoff over the tolerance."""
    told = [(run.tolerance, run.error) for run in runs if run.error is not None and run.ratio is not None]
    return Curve(label=runs[0].spec, x=tuple(x for x, _ in told), y=tuple(y for _, y in told))


def _slope_row(spec: str, own: Runs) -> Row:
    id, curve = f"slope/{spec}", _curve(own)
    if len(curve.x) < 3:
        return shown_row(id, f"{spec}: slope of error over tolerance", "fewer than three errors above roundoff")
    found, claim = slope(curve.x, curve.y), f"{spec}: slope of error over tolerance, both logarithmic"
    return Row(id=id, claim=claim, measured=f"{found:.2f}", bound=f"1 +- {SLOPE:g}", passed=abs(found - 1) <= SLOPE)


def stiff_row(own: Runs) -> Row:
    """The row of a stiff spring: every error within NEAR times its tolerance."""
    spec = own[0].spec
    claim = f"{spec}, alpha {DAMPED}: achieved/requested at {', '.join(f'{run.tolerance:g}' for run in own)}"
    text = ", ".join(f"{run} in {run.accepted} steps" for run in own)
    passed = all(run.error is not None and run.error <= NEAR * run.tolerance for run in own)
    return Row(id=f"stiff/{spec}", claim=claim, measured=text, bound=f"< {NEAR:g}", passed=passed)


def compared(chrono: ControlledRun, own: ControlledRun) -> Row:
    """A row, not judged, with the errors and the work of both kinds of step control."""
    errors = [f"{run.error:.1e}" if run.error is not None else run.status for run in (chrono, own)]
    text = f"error {errors[0]} with {chrono.evaluations:,} evaluations; error control: {errors[1]} with {own.evaluations:,}"
    claim = f"{own.spec}: Chrono's rule (double after five easy steps, halve on failure)"
    return shown_row(f"chrono/{own.spec}", claim, text)


def drawn(controlled: Iterable[Runs]) -> Plot:
    """Error over tolerance, a curve for every problem that has errors above roundoff."""
    return Plot(
        id="control",
        title="Achieved over requested error",
        caption="Largest weighted error of q and v over time against the tolerance; the guide line has slope one.",
        x_label="tolerance",
        y_label="error",
        curves=tuple(curve for curve in map(_curve, controlled) if curve.x),
        slope=1.0,
    )


def quartiles(spec: str, method: Method) -> Row:
    """Those of estimated over true local error."""
    found = ratios(spec, method)
    low, middle, high = np.quantile(found, [0.25, 0.5, 0.75])
    name = ", ".join(f"{key} {value}" for key, value in method.items())
    return Row(
        id=f"effectivity/{spec}/{name}",
        claim=f"{spec}, {name}: estimated over true local error, quartiles of {len(found)} steps",
        measured=f"{low:.2f} {middle:.2f} {high:.2f}",
        bound=f"middle in [{RANGE[0]:g}, {RANGE[1]:g}]",
        passed=RANGE[0] <= middle <= RANGE[1],
    )


def ratios(spec: str, method: Method, steps: int = STEPS) -> list[float]:
    """Estimated over true local error, in the norm of the error test, of every third step of a controlled run."""
    problem, values = load_problem(spec), list[float]()
    hht, (t0, t1) = HHT(problem.system, **method), problem.t_span
    if hht.init_step(t0, problem.q0, problem.v0, rtol=ESTIMATE_TOLERANCE, **guesses(problem)) is not Status.success:
        raise RuntimeError(f"{spec}: {hht.message}")
    tolerances = make_tolerances(ESTIMATE_TOLERANCE, None, hht.state, hht.state.f)
    for index in range(steps):
        before, status = hht.state, hht.step(tstop=t1)
        if status is not Status.success or hht.state.t == t1:
            break
        if index % 3 == 2:
            values.append(_ratio(problem, tolerances, before, hht.state))
    return values


def _ratio(problem: Problem, tolerances: Tolerances, before: State, after: State) -> float:
    if after.memory is None or after.memory.error is None:
        raise RuntimeError(f"{problem.name}: the step to {after.t:g} has no estimate")
    true = np.concatenate([after.q, after.v]) - local_solution(problem, before, after.t)
    return after.memory.error / tolerances.size(before, after, true)


def local_solution(problem: Problem, state: State, t1: float) -> Vector:
    """[q, v] (2n,) at ``t1`` [s] of the exact motion through ``state``, by a method of order eight or more."""
    own = replace(problem, t_span=(state.t, t1), q0=state.q, v0=state.v, exact=None, reference=None)
    other = collocation() if problem.name in NONLINEAR else projected(method="DOP853")
    solution = other.solve(own, Request(rtol=1e-13, atol=1e-15, t_eval=np.array([t1])))
    if solution.status is not Status.success:
        raise RuntimeError(f"{problem.name}: no local solution: {solution.message}")
    return np.concatenate([solution.q[-1], solution.v[-1]])
