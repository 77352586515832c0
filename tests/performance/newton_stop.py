"""Newton's iteration that stops where the error allows, (H35), beside the one that takes every row to roundoff.

``python -m tests.performance.newton_stop [PROBLEM ...]`` prints for every problem and tolerance evaluations of the residual
a step, steps, the error, the drift and the time a step, before -> after; it leaves with 1 where the mean of the evaluations
at the first tolerance is above MOST.  Below stands what the stop makes of the errors, after over before, and what a
tolerance larger by NEARLY_SAME makes of them without it: where another step is rejected a single error moves by more than
either.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial

import numpy as np
from tabulate import tabulate

from hhtbench import list_problems, load_problem
from hhtbench.checks.drift import measure_drift
from hhtbench.lowering.caching import Cache
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.request import Request
from solvers.hht.adapter import solver
from solvers.hht.run import functions, idle
from solvers.hht.step.newton import NewtonOptions
from solvers.hht.verify.measure import known_motion, weighted_error

TOLERANCES = (1e-3, 1e-5)
MOST = 3.5  # evaluations a step, mean over the problems at the first tolerance
REPEATS = 3
NEARLY_SAME = 1e-3  # relative change of the tolerance
NOTABLE = 0.02  # relative change of an error
HEAD = ("problem", "rtol", "evaluations/step", "matrices/step", "steps", "error", "position", "velocity", "us/step")


@dataclass(frozen=True)
class Run:
    """One controlled run."""

    evaluations: float  #: of the residual, a step
    matrices: float  #: a step
    steps: int
    error: float
    position: float  #: largest drift over its scale
    velocity: float
    microseconds: float  #: a step, processor time

    def cells(self, after: Run) -> list[str]:
        """Both, side by side."""
        pairs = zip(vars(self).values(), vars(after).values(), strict=True)
        return [f"{one:.3g} -> {other:.3g}" for one, other in pairs]


def run(spec: str, tolerance: float, remaining: float) -> Run:
    """``spec`` at rtol = ``tolerance``, with ``remaining`` of what is allowed left in the force rows."""
    functions.NewtonOptions = partial(NewtonOptions, remaining=remaining)  # type: ignore[assignment, misc]
    functions._known = Cache(16)
    idle._idle.clear()
    problem = load_problem(spec)
    times, known = known_motion(problem)
    request, least = Request(rtol=tolerance, t_eval=times), np.inf
    for _ in range(REPEATS):
        began = time.process_time()
        solution = solver().solve(problem, request)
        least = min(least, time.process_time() - began)
    count, drift = solution.counters, measure_drift(problem, solution)
    steps, levels = count.steps_accepted or 1, (None, None) if drift is None else (drift.position, drift.velocity)
    return Run(
        (count.residual_evaluations or 0) / steps,
        (count.jacobian_evaluations or 0) / steps,
        steps,
        weighted_error(problem, np.hstack([solution.q, solution.v]), known) if solution.success else np.nan,
        *(0.0 if level is None else float(level.max()) for level in levels),
        microseconds=1e6 * least / steps,
    )


def main(names: list[str]) -> int:
    """The table, and whether the mean is too large."""
    plan, means, by_stop, by_tolerance = registered_plans(), list[float](), list[float](), list[float]()
    for tolerance in TOLERANCES:
        rows, runs = [], []
        for name in names or list_problems():
            spec = validated_spec(name, plan)
            before, after = (run(spec, tolerance, remaining) for remaining in (0.0, NewtonOptions().remaining))
            rows.append([spec, f"{tolerance:g}", *before.cells(after)])
            runs.append((before.evaluations, after.evaluations))
            by_stop.append(after.error / before.error)
            by_tolerance.append(run(spec, tolerance * (1.0 + NEARLY_SAME), 0.0).error / before.error)
        mean = np.mean(runs, axis=0)
        means.append(float(mean[1]))
        rows.append(["mean", f"{tolerance:g}", f"{mean[0]:.3g} -> {mean[1]:.3g}"])
        sys.stdout.write(tabulate(rows, HEAD) + "\n\n")
    sys.stdout.write(f"error, after over before: {spread(by_stop)}\n")
    sys.stdout.write(f"error, rtol larger by {NEARLY_SAME:g} over before: {spread(by_tolerance)}\n")
    return int(means[0] > MOST)


def spread(ratios: list[float]) -> str:
    """Mean and extremes of ratios of errors; those that are not finite are counted apart."""
    logs = np.log(ratios)
    known = logs[np.isfinite(logs)]
    mean, least, most = np.exp([known.mean(), known.min(), known.max()])
    notable = int((np.abs(known) > np.log1p(NOTABLE)).sum())
    apart = f", {logs.size - known.size} not known" if known.size < logs.size else ""
    return f"mean {mean:.4f}, from {least:.3f} to {most:.3f}, {notable} of {known.size} beyond {NOTABLE:.0%}{apart}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
