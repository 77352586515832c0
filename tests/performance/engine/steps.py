"""Section 1: time per step beside hand-written C."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.result import Solution
from solvers.hht import HHT
from tests.performance.engine.baselines import ALPHA, Case, End, build, cases, difference, take_steps
from tests.performance.engine.clock import BROKEN, Compared, compare, unmeasured
from tests.performance.engine.ours import ENGINE, constant_steps

SAME = 1e-9  # relative difference of the two ends
MANY = 100_000  # steps of one action at least: short runs are repeated


def measure_steps() -> list[dict[str, Any]]:
    """One line a scene; without a C compiler the lines say so."""
    scenes = cases()
    with tempfile.TemporaryDirectory() as folder:
        try:
            functions = build(Path(folder))
        except RuntimeError as error:
            return [_alone(case, str(error)) for case in scenes]
        return [_line(case, functions[case.source]) for case in scenes]


def _line(case: Case, function: Any) -> dict[str, Any]:
    ours = _ours(case, case.steps)
    if case.rtol is not None:  # C's steps are of the mean length
        attempts = _attempts(ours)
        case = replace(case, h=case.h * case.steps / attempts, steps=attempts)
    theirs = take_steps(function, case)
    batch = max(1, MANY // case.steps)
    found = compare(
        {
            "ours": lambda: _repeat(batch, lambda: _ours(case, case.steps)),
            "start": lambda: _repeat(batch, lambda: _ours(case, 1)),
            "c": lambda: _repeat(batch, lambda: take_steps(function, case)),
        },
        lambda seconds: (seconds["ours"] - seconds["start"]) / seconds["c"],
        case.limit,
    )
    end = End(ours.q[-1], ours.v[-1], int(ours.counters.newton_iterations or 0))
    apart = difference(end, theirs) if case.rtol is None else None
    line = {
        **_common(case, found, batch),
        **found.line(),
        "c_s": found.cpu("c") / batch / case.steps,
        "difference": apart,
        "iterations": end.iterations / case.steps,
        "c_iterations": theirs.iterations / case.steps,
        "note": ""
        if case.rtol is None
        else "HHT with error estimate and step control, C with constant steps of the mean length",
    }
    if apart is not None and apart > SAME:
        line |= {"verdict": BROKEN, "note": "the two ends differ: another trajectory"}
    return line


def _common(case: Case, found: Compared, batch: int) -> dict[str, Any]:
    start = found.cpu("start") / batch
    ours = (found.cpu("ours") / batch - start) / case.steps
    return {"scene": case.name, "h": case.h, "steps": case.steps, "ours_s": ours, "start_s": start}


def _alone(case: Case, reason: str) -> dict[str, Any]:
    """Without the C version."""
    steps = _attempts(_ours(case, case.steps))
    actions = {"ours": lambda: _ours(case, case.steps), "start": lambda: _ours(case, 1)}
    found = compare(actions, lambda seconds: seconds["ours"], float("inf"))
    missing = dict.fromkeys(("c_s", "difference", "iterations", "c_iterations"))
    return {**_common(replace(case, steps=steps), found, 1), **unmeasured(case.limit, reason), **missing}


def _ours(case: Case, steps: int) -> Solution:
    """The whole of a controlled run is asked for by all its ``steps``; one step, of either kind, is its start."""
    if case.rtol is None:
        return constant_steps(case.problem, case.h, steps, alpha=ALPHA, b=0.0)
    problem = case.problem
    hht, most = HHT(problem.system, alpha=ALPHA, b=0.0, engine=ENGINE), 1 if steps == 1 else None
    guess = {"lam_guess": problem.lam_guess, "max_num_steps": most}
    return hht.solve(problem.t_span, problem.q0, problem.v0, rtol=case.rtol, t_eval=np.array([problem.t_span[1]]), **guess)


def _attempts(solution: Solution) -> int:
    found = solution.counters
    return found.steps_accepted + (found.steps_rejected_error or 0) + (found.steps_rejected_newton or 0)


def _repeat(times: int, action: Callable[[], object]) -> None:
    for _ in range(times):
        action()
