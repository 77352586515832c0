"""Section 1: time per step beside hand-written C."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.result import Solution
from solvers.hht import HHT
from tests.performance.engine.baselines import (
    ALPHA,
    Case,
    End,
    after_first_steps,
    build,
    cases,
    difference,
    take_controlled,
    take_steps,
)
from tests.performance.engine.clock import BROKEN, Compared, compare, unmeasured
from tests.performance.engine.ours import ENGINE, constant_steps

SAME = 1e-9  # relative difference of the two ends
ALIKE = 0.05  # of the steps under error control, that C may take more or fewer


def measure_steps() -> list[dict[str, Any]]:
    """One line a scene; without a C compiler the lines say so."""
    scenes = cases()
    with tempfile.TemporaryDirectory() as folder:
        try:
            functions = build(Path(folder))
        except RuntimeError as error:
            return [_alone(case, str(error)) for case in scenes]
        return [_line(case, functions[case.source]) for case in scenes]


@dataclass(frozen=True)
class Run:
    """One run of one side."""

    end: End
    steps: int


def _line(case: Case, function: Any) -> dict[str, Any]:
    theirs_of = _c_runs(case, function)
    ours, theirs = _ours(case), theirs_of()
    found = compare(
        {"ours": lambda: _ours(case), "start": lambda: _start(case), "c": theirs_of},
        lambda seconds: (seconds["ours"] - seconds["start"]) / ours.steps / (seconds["c"] / theirs.steps),
        case.limit,
    )
    apart = difference(ours.end, theirs.end)
    line = {
        **_common(case, found, ours.steps),
        **found.line(),
        "c_s": found.cpu("c") / theirs.steps,
        "difference": apart,
        "iterations": ours.end.iterations / ours.steps,
        "c_iterations": theirs.end.iterations / theirs.steps,
        "note": "" if case.rtol is None else f"{theirs.steps} steps of C",
    }
    same = apart <= SAME if case.rtol is None else abs(theirs.steps - ours.steps) <= ALIKE * ours.steps
    return line if same else {**line, "verdict": BROKEN, "note": "C goes another way: steps or ends differ"}


def _c_runs(case: Case, function: Any) -> Callable[[], Run]:
    """The C version of the case."""
    if case.rtol is None:
        return lambda: Run(take_steps(function, case), case.steps)
    start = after_first_steps(case)

    def run() -> Run:
        found = take_controlled(function, case, start)
        return Run(found.end, found.accepted)

    return run


def _common(case: Case, found: Compared, steps: int) -> dict[str, Any]:
    start = found.cpu("start")
    ours = (found.cpu("ours") - start) / steps
    return {"scene": case.name, "h": case.h or None, "steps": steps, "ours_s": ours, "start_s": start}


def _alone(case: Case, reason: str) -> dict[str, Any]:
    """Without the C version."""
    steps = _ours(case).steps
    actions = {"ours": lambda: _ours(case), "start": lambda: _start(case)}
    found = compare(actions, lambda seconds: seconds["ours"], float("inf"))
    missing = dict.fromkeys(("c_s", "difference", "iterations", "c_iterations"))
    return {**_common(case, found, steps), **unmeasured(case.limit, reason), **missing}


def _ours(case: Case) -> Run:
    return _run(_controlled(case) if case.rtol else constant_steps(case.problem, case.h, case.steps, alpha=ALPHA, b=0.0))


def _start(case: Case) -> Run:
    """The start and one step."""
    return _run(_controlled(case, 1) if case.rtol else constant_steps(case.problem, case.h, 1, alpha=ALPHA, b=0.0))


def _controlled(case: Case, most: int | None = None) -> Solution:
    problem, hht = case.problem, HHT(case.problem.system, alpha=ALPHA, b=0.0, engine=ENGINE)
    asked = {"rtol": case.rtol, "atol": case.rtol, "max_num_steps": most, "t_eval": np.array([problem.t_span[1]])}
    return hht.solve(problem.t_span, problem.q0, problem.v0, lam_guess=problem.lam_guess, **asked)


def _run(solution: Solution) -> Run:
    iterations = int(solution.counters.newton_iterations or 0)
    end = End(solution.q[-1], solution.v[-1], iterations) if len(solution.t) else End(np.empty(0), np.empty(0), iterations)
    return Run(end, solution.counters.steps_accepted)
