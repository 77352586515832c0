"""Time of a controlled step of middle mechanisms, work of a step over the library, memory of a long run."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import warnings
from typing import Any

import hhtbench as hb
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.catalogue.registry import list_problems
from tests.performance.engine.clock import BROKEN, HOLDS, compare, unmeasured

STEP_LIMITS = {"bricard": 0.35e-3, "fekete(t_end=100)": 0.12e-3, "flyball_governor(t_end=1)": 0.2e-3}  # [s]
STEP_RTOL = 1e-4
EVALUATIONS, EVALUATIONS_RTOL = 3.5, 1e-3  # mean over the library, of a step
MEMORY = 50.0  # MB above the start
PATIENCE = 20.0  # of one mechanism [s]
LONGEST = 10.0  # of one solve of the library [s]


def measure_middle() -> list[dict[str, Any]]:
    """Milliseconds of a step under error control: a whole run less its start and first step."""
    return [_step_line(spec, limit) for spec, limit in STEP_LIMITS.items()]


def _step_line(spec: str, limit: float) -> dict[str, Any]:
    problem = hb.load_problem(spec)
    line = {"what": f"{spec}, a step at rtol {STEP_RTOL:g}", "unit": "s"}

    def solve(most: int | None = None) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # bricard's redundant constraint
            return hb.solve(problem, "hht", rtol=STEP_RTOL, t_eval=[problem.t_span[1]], max_num_steps=most)

    found = solve()
    if not found.success:
        return {**line, **unmeasured(limit, found.message)}
    steps = found.counters.steps_accepted
    actions = {"run": solve, "start": lambda: solve(1)}
    taken = compare(actions, lambda seconds: (seconds["run"] - seconds["start"]) / (steps - 1), limit, PATIENCE)
    return {**line, **taken.line(), "note": f"{steps} steps; start and first step {1e3 * taken.cpu('start'):.2g} ms"}


def measure_evaluations() -> list[dict[str, Any]]:
    """Residual evaluations of a step under error control, the mean over the library; counted, so without an interval."""
    plan, per_step, failed = registered_plans(), dict[str, float](), []
    for name in list_problems():
        spec = validated_spec(name, plan)
        problem = hb.load_problem(spec)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            end = [problem.t_span[1]]
            found = hb.solve(problem, "hht", rtol=EVALUATIONS_RTOL, t_eval=end, max_seconds=LONGEST)
        if found.success:
            per_step[spec] = found.counters.residual_evaluations / found.counters.steps_accepted
        else:
            failed.append(f"{spec}: {found.status.label}")
    mean, most = statistics.mean(per_step.values()), max(per_step, key=lambda spec: per_step[spec])
    note = f"{len(per_step)} problems, {min(per_step.values()):.2g} to {per_step[most]:.2g} ({most})"
    what = f"residual evaluations of a step at rtol {EVALUATIONS_RTOL:g}, mean over the library"
    line = _counted(what, mean, EVALUATIONS, "; ".join([note, *failed]), "")
    return [line]


def measure_memory() -> list[dict[str, Any]]:
    """Peak memory of many steps with one row of output, in a process of its own."""
    what = "peak memory of 1e7 steps of the pendulum with one row of output, above that of the start"
    done = subprocess.run(
        [sys.executable, "-m", "tests.performance.engine.long_run"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        reason = (done.stderr.strip() or "no message").splitlines()[-1][:200]
        return [{"what": what, "unit": "MB", **unmeasured(MEMORY, reason)}]
    found = json.loads(done.stdout.splitlines()[-1])
    return [_counted(what, found["after"] - found["before"], MEMORY, f"{found['before']:.0f} MB at the start", "MB")]


def _counted(what: str, value: float, limit: float, note: str, unit: str) -> dict[str, Any]:
    """A number that every run gives alike."""
    verdict = HOLDS if value <= limit else BROKEN
    same = {"value": value, "low": value, "high": value, "count": 1, "limit": limit, "verdict": verdict}
    return {"what": what, "unit": unit, **same, "note": note}
