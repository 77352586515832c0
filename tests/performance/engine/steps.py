"""Section 1: time per step beside hand-written C."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from tests.performance.engine.baselines import ALPHA, Case, End, build, cases, difference, take_steps
from tests.performance.engine.clock import in_turn
from tests.performance.engine.ours import constant_steps

REPEATS = 7
SAME = 1e-9  # relative difference of the two ends


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
    ours = _ours(case, case.steps)  # compiles
    theirs = take_steps(function, case)
    actions = {
        "ours": lambda: _ours(case, case.steps),
        "start": lambda: _ours(case, 1),
        "c": lambda: take_steps(function, case),
    }
    found = in_turn(actions, REPEATS)
    own = {clock: (getattr(found["ours"], clock) - getattr(found["start"], clock)) / case.steps for clock in ("cpu", "wall")}
    c_cpu, c_wall = found["c"].cpu / case.steps, found["c"].wall / case.steps
    apart = difference(ours, theirs)
    ratio = own["cpu"] / c_cpu
    return {
        "scene": case.name,
        "h": case.h,
        "steps": case.steps,
        "ours_s": own["cpu"],
        "c_s": c_cpu,
        "ratio": ratio,
        "clock_ratio": own["wall"] / c_wall,
        "limit": case.limit,
        "start_s": found["start"].cpu,
        "difference": apart,
        "iterations": ours.iterations / case.steps,
        "c_iterations": theirs.iterations / case.steps,
        "holds": bool(ratio <= case.limit and apart <= SAME),
        "note": "" if apart <= SAME else "the two ends differ: another trajectory",
    }


def _alone(case: Case, reason: str) -> dict[str, Any]:
    """Without the C version."""
    _ours(case, 1)
    found = in_turn({"ours": lambda: _ours(case, case.steps), "start": lambda: _ours(case, 1)}, REPEATS)
    line = {"scene": case.name, "h": case.h, "steps": case.steps, "limit": case.limit, "note": reason}
    own = (found["ours"].cpu - found["start"].cpu) / case.steps
    missing = dict.fromkeys(("c_s", "ratio", "clock_ratio", "difference", "iterations", "c_iterations", "holds"))
    return {**line, "ours_s": own, "start_s": found["start"].cpu, **missing}


def _ours(case: Case, steps: int) -> End:
    solution = constant_steps(case.problem, case.h, steps, alpha=ALPHA, b=0.0)
    return End(solution.q[-1], solution.v[-1], int(solution.counters.newton_iterations or 0))
