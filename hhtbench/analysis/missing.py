"""Why a solver has no cost at an error: refused, failed, no better, not tried that far, not counted."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.analysis.cells import Point

NOT_RUN = "not run"  # status of a run for which there was no time: it says nothing about the solver
LEAST_ORDER = 0.25  # of error against setting between the two finest runs: a lower one is a standstill


@dataclass(frozen=True, kw_only=True)
class Missing:
    """Why one solver has no cost; ``kind`` tells whether it was asked for this error at all."""

    kind: str  #: "untried", "fails", "drifts", "uncounted" or "unjudged"
    text: str
    error: float | None = None  #: the smallest that was reached


def unjudged(limit: float) -> Missing:
    """The reference is not good enough."""
    return Missing(kind="unjudged", text=f"the reference cannot judge errors below {limit:.0e}")


def drifting(accurate: Sequence[Point], bound: float) -> Missing:
    """All of the runs that are ``accurate`` enough drift too far."""
    least = [max(run.position or 0.0, run.velocity or 0.0) for run in accurate]
    return Missing(kind="drifts", text=f"drifts by {min(least):.1e} or more, above {bound:.0e}")


def why_missing(runs: Sequence[Point], measure: str) -> Missing:
    """From all runs of one solver on one problem, loosest first, none of which reaches the error."""
    if any(run.status == NOT_RUN for run in runs):
        message = next(run.message for run in runs if run.status == NOT_RUN)
        return Missing(kind="untried", text=f"{NOT_RUN}: {message}")
    failed = Counter(run.status for run in runs if not run.success)
    outcome = ", ".join(f"{status} {count} of {len(runs)}" for status, count in failed.items())
    good = [run for run in runs if run.error is not None]
    if not good:
        text = outcome or "no exact solution or reference to compare with"
        return Missing(kind="fails" if outcome else "unjudged", text=text)
    best = min(run.error for run in good if run.error is not None)
    if not any(run.work(measure) for run in good):
        return Missing(kind="uncounted", text=f"{measure} not reported", error=best)
    finest = good[-1]
    if finest is runs[-1] and _falling(good):
        text = f"not tried: finest run {finest.setting.text}, error {finest.error:.2g}"
        return Missing(kind="untried", text=text, error=best)
    return Missing(kind="fails", text=f"smallest error {best:.2g}; {outcome or 'finer settings do not help'}", error=best)


def _falling(good: Sequence[Point]) -> bool:
    """The finest run is the best, and better than the one before it by what its setting should bring."""
    if len(good) < 2:
        return True
    coarse, fine = good[-2:]
    if not coarse.error or not fine.error or fine.error > min(run.error for run in good if run.error is not None):
        return False
    refinement = coarse.setting.value / fine.setting.value
    return math.log(coarse.error / fine.error) >= LEAST_ORDER * math.log(refinement)
