"""The time of one step beside hand-written C."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.solution.result import Solution
from solvers.hht import HHT
from tests.performance.engine import baselines
from tests.performance.engine.baselines import ALPHA, Case, End
from tests.performance.engine.clock import BROKEN, compare, unmeasured
from tests.performance.engine.ours import constant_steps

SAME = 1e-9  # relative difference of the two ends
ALIKE = 0.05  # of the steps under error control, that C may take more or fewer


@dataclass(frozen=True)
class Run:
    """One run of one side."""

    end: End
    steps: int


def measure_steps() -> list[dict[str, Any]]:
    """One line a scene; without a C compiler the lines say so."""
    scenes = baselines.cases()
    with tempfile.TemporaryDirectory() as folder:
        try:
            functions = baselines.build(Path(folder))
        except RuntimeError as error:
            return [{"what": case.name, "unit": "", **unmeasured(case.limit, str(error))} for case in scenes]
        return [line_of(case, functions[case.source]) for case in scenes]


def line_of(case: Case, function: Any) -> dict[str, Any]:
    """Our time of a step over C's, where both go the same way."""
    theirs_of = _c_runs(case, function)
    ours, theirs = _ours(case), theirs_of()
    found = compare(
        {"ours": lambda: _ours(case), "start": lambda: _ours(case, 1), "c": theirs_of},
        lambda seconds: (seconds["ours"] - seconds["start"]) / ours.steps / (seconds["c"] / theirs.steps),
        case.limit,
    )
    apart, start = baselines.difference(ours.end, theirs.end), found.cpu("start")
    ways = f"; ends differ by {apart:.1e}" if case.rtol is None else f", {theirs.steps} steps of C"
    note = (
        f"{1e6 * (found.cpu('ours') - start) / ours.steps:.3g} us a step, C {1e6 * found.cpu('c') / theirs.steps:.3g} us; "
        f"{ours.steps} steps{ways}; {ours.end.iterations / ours.steps:.2g} and {theirs.end.iterations / theirs.steps:.2g} "
        f"Newton iterations a step; {1e3 * start:.2g} ms before the first step"
    )
    line = {"what": case.name, "unit": "", **found.line(), "note": note}
    same = apart <= SAME if case.rtol is None else abs(theirs.steps - ours.steps) <= ALIKE * ours.steps
    return line if same else {**line, "verdict": BROKEN, "note": f"C goes another way, steps or ends differ: {note}"}


def _c_runs(case: Case, function: Any) -> Callable[[], Run]:
    """The C version of the case."""
    if case.rtol is None:
        return lambda: Run(baselines.take_steps(function, case), case.steps)
    start = baselines.after_first_steps(case)

    def run() -> Run:
        found = baselines.take_controlled(function, case, start)
        return Run(found.end, found.accepted)

    return run


def _ours(case: Case, most: int | None = None) -> Run:
    """All of the case, or its start and ``most`` steps."""
    if case.rtol is None:
        return _run(constant_steps(case.problem, case.h, most or case.steps, alpha=ALPHA, b=0.0))
    problem, hht = case.problem, HHT(case.problem.system, alpha=ALPHA, b=0.0)
    asked = {"rtol": case.rtol, "atol": case.rtol, "max_num_steps": most, "t_eval": np.array([problem.t_span[1]])}
    return _run(hht.solve(problem.t_span, problem.q0, problem.v0, lam_guess=problem.lam_guess, **asked))


def _run(solution: Solution) -> Run:
    iterations = int(solution.counters.newton_iterations or 0)
    end = End(solution.q[-1], solution.v[-1], iterations) if len(solution.t) else End(np.empty(0), np.empty(0), iterations)
    return Run(end, solution.counters.steps_accepted)
