"""Newton's iteration that stops where the error allows, (H35), beside the one that takes every row to roundoff.

``python -m tests.performance.newton_stop [PROBLEM ...]`` prints for every problem and tolerance evaluations of the residual
a step, steps, the error, the drift and the time a step, before -> after; it leaves with 1 where the mean of the evaluations
at the first tolerance is above MOST.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from functools import partial

import numpy as np
from tabulate import tabulate

from hhtbench import list_problems, load_problem
from hhtbench.campaign.drift import measure_drift
from hhtbench.lowering.caching import Cache
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.request import Request
from solvers.hht.adapter import solver
from solvers.hht.run import functions, idle
from solvers.hht.step.newton import NewtonOptions
from solvers.hht.verify.control import known_motion, weighted_error

TOLERANCES = (1e-3, 1e-5)
MOST = 3.5  # evaluations a step, mean over the problems at the first tolerance
REPEATS = 3
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
    plan, means = registered_plans(), list[float]()
    for tolerance in TOLERANCES:
        rows, runs = [], []
        for name in names or list_problems():
            spec = validated_spec(name, plan)
            before, after = (run(spec, tolerance, remaining) for remaining in (0.0, NewtonOptions().remaining))
            rows.append([spec, f"{tolerance:g}", *before.cells(after)])
            runs.append((before.evaluations, after.evaluations))
        mean = np.mean(runs, axis=0)
        means.append(float(mean[1]))
        rows.append(["mean", f"{tolerance:g}", f"{mean[0]:.3g} -> {mean[1]:.3g}"])
        sys.stdout.write(tabulate(rows, HEAD) + "\n\n")
    return int(means[0] > MOST)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
