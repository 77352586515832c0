"""Everything that is held against a success in a campaign: its rows, its steps, the constraints, the equations of motion.

The adapters of libraries make the cheap checks themselves (:mod:`hhtbench.trust`); here all are made, whoever gave the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.result import Solution
from hhtbench.trust.allowed import allowed_errors, sizes_of
from hhtbench.trust.flow import Equations, NotJudged
from hhtbench.trust.levels import CHECKED_ROWS, violated
from hhtbench.trust.motion import Follower, Multipliers, Rows, Window
from hhtbench.trust.rows import doubt_about

STARTS = (0.0, 0.4, 0.8)  # of the rows: where windows begin, beside the last but one
NEAR = 50  # steps at the beginning of a window that are looked at beside its output rows


@dataclass(frozen=True)
class Steps:
    """The solver's own steps: their ends, and the states there, which may have to be interpolated."""

    t: Vector  #: (k,) [s]
    states: Callable[[Any], tuple[Matrix, Matrix]]  #: q and v (len, n) of those of some indices


@dataclass(frozen=True)
class Judgement:
    """What speaks against a success, and how far it was looked at."""

    doubt: str  #: begins with the name of the check that failed; "" where all is well
    windows: tuple[Window, ...] = ()  #: that were integrated again
    not_judged: str = ""  #: why the equations of motion say nothing, or ""

    def metrics(self) -> dict[str, Any]:
        """``metrics["trust"]`` of a row."""
        worst = max((window.off / window.bound for window in self.windows), default=None)
        judged = sum(window.judged for window in self.windows)
        return {"motion": worst, "windows": judged, "not_judged": self.not_judged or None}


def judge(problem: Problem, request: Request, solution: Any, steps: Steps | None = None) -> Judgement:
    """Every check in turn until one fails; a result that is no success is not judged."""
    doubt = doubt_about(problem, request, solution)
    if doubt or not solution.success:
        return Judgement(doubt)
    try:
        levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0))
        doubt = _multipliers(levels, solution) or violated(levels, problem, request, (solution.t, solution.q, solution.v))
        if steps is not None and not doubt:
            some = np.unique(np.linspace(0, steps.t.size - 1, CHECKED_ROWS).astype(int))
            doubt = violated(levels, problem, request, (steps.t[some], *steps.states(some)))
        return Judgement(doubt) if doubt else _motion(problem, request, solution, steps)
    except NotJudged as reason:
        return Judgement("", not_judged=str(reason))
    except Exception as error:  # noqa: BLE001 - a function of the problem, which has its own check
        return Judgement("", not_judged=f"{type(error).__name__}: {error}")


def _multipliers(levels: ConstraintLevels, solution: Solution) -> str:
    for name, wanted in (("lam", levels.structure.m), ("mu", levels.structure.p)):
        found = getattr(solution, name).shape[1]
        if found != wanted:
            return f"shapes: {name} has {found} columns; the system has {wanted} such constraints."
    return ""


def _motion(problem: Problem, request: Request, solution: Solution, steps: Steps | None) -> Judgement:
    equations, size = Equations(problem), sizes_of(problem, solution.q, solution.v)
    follower = Follower(problem, request, equations, size, allowed_errors(problem, request, equations, size))
    windows = []
    for rows, multipliers in _windows(problem, solution, steps):
        windows.append(follower.follow(rows, multipliers))
        if windows[-1].failed:
            break
    found = tuple(windows)
    failed = [window for window in found if window.failed]
    if failed:
        return Judgement(_described(failed[0], request), found)
    if any(window.judged for window in found):
        return Judgement("", found)
    reasons = dict.fromkeys(window.unfinished for window in found if window.unfinished)
    blunt = "at what was asked for, the rows are too close to a straight line to tell them from one"
    return Judgement("", found, "; ".join(reasons) or (blunt if found else "no two rows lie between jumps"))


def _described(window: Window, request: Request) -> str:
    asked = "its steps" if request.fixed else "its tolerances"
    return (
        f"equations of motion: from the row at t = {window.start:.17g} the motion leads elsewhere than to the row at "
        f"t = {window.at:.17g}: they are {window.off:.2g} times as far apart as {asked} let one step be off; "
        f"up to {window.bound:.2g} is believed."
    )


def _windows(problem: Problem, solution: Solution, steps: Steps | None) -> Iterator[tuple[Rows, Multipliers]]:
    """Rows of a few windows, from the last one on: output rows and steps together, each from an output row on.

    They end at events, which may change the state.
    """
    direction = -1.0 if problem.t_span[1] < problem.t_span[0] else 1.0
    jumps = np.sort(direction * np.concatenate([np.zeros(0), *solution.t_events]))
    count = solution.t.size
    first = {count - 2, *(int(part * (count - 1)) for part in STARTS)}
    for i in sorted(first, reverse=True):
        if 0 <= i < count - 1:
            rows = _rows(solution, steps, i, direction)
            after = jumps[jumps >= direction * rows.t[0]]
            kept = direction * rows.t < after[0] if after.size else np.ones(rows.t.size, dtype=bool)
            rows = Rows(*(part[kept] for part in rows))
            if rows.t.size > 1:
                yield rows, Multipliers(solution.lam[i], solution.mu[i])


def _rows(solution: Solution, steps: Steps | None, i: int, direction: float) -> Rows:
    """Row i of the output and what follows it: rows of output, and the next steps."""
    parts = [(solution.t[i:], solution.q[i:], solution.v[i:])]
    if steps is not None:
        begin = int(np.searchsorted(direction * steps.t, direction * solution.t[i], "left"))
        some = np.arange(begin, min(begin + NEAR, steps.t.size))
        parts.append((steps.t[some], *steps.states(some)))
    t, q, v = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(direction * t, kind="stable")
    return Rows(t[order], q[order], v[order])
