"""Reasons why a solver has no cost at an error, with a lower bound from its finest run.

A target that was not reached is a censored cell.  A campaign asks every solver for every target, so there is always a
reason: not supported, failed, no gain from finer settings, a limit of the campaign, or drift.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.campaign.analysis.cells import Point, kind_of
from hhtbench.campaign.analysis.ladder import Next, next_setting

NOT_RUN = "not run"  # kind of a solver without rows on a problem
UNREFINED = ("unfinished", "not asked")  #: kinds of which no finer run was made
UNKNOWN = (NOT_RUN, "unjudged", "uncounted", *UNREFINED)  #: kinds that say nothing about the solver


@dataclass(frozen=True, kw_only=True)
class Missing:
    """Reason why one solver has no cost at an error."""

    kind: str  #: "refused", "fails", "standstill", "capped" or "drifts"; or one of ``UNKNOWN``
    text: str
    error: float | None = None  #: the smallest that was reached
    bound: float | None = None  #: lower bound of the cost, s or evaluations: what the finest run took


def drifting(accurate: Sequence[Point], bound: float) -> Missing:
    """Return the reason for a solver whose sufficiently ``accurate`` runs all drift more than ``bound``."""
    least = min(run.drift or 0.0 for run in accurate)
    return Missing(kind="drifts", text=f"drifts by {least:.1e} or more, above {bound:.0e}")


def why_missing(runs: Sequence[Point], measure: str) -> Missing:
    """Return the reason from all runs of one solver on one problem, loosest first, none of which reaches the error."""
    errors = [run.error for run in runs if run.error is not None]
    best = min(errors, default=None)
    if errors and not any(run.work(measure) for run in runs if run.error is not None):
        return Missing(kind="uncounted", text=f"{measure} not reported", error=best)
    kind, text = _reason(runs)
    reached = "" if best is None else f"smallest error {best:.2g}; "
    return Missing(kind=kind, text=f"{reached}{text}", error=best, bound=_bound(runs, measure))


def _reason(runs: Sequence[Point]) -> tuple[str, str]:
    """Return kind and text of the End of the refinement, or a summary of the runs if it did not ask for this error."""
    finest = runs[-1]
    end = None if finest.rules is None else next_setting(runs, finest.rules, kind_of(finest))
    if isinstance(end, Next):
        return "unfinished", "the campaign was stopped here: resume it"
    if end is not None and end.kind != "reached":
        return end.kind, end.text
    if not finest.success:
        failed = Counter(run.status for run in runs if not run.success)
        kind = "refused" if set(failed) == {"declined"} else "fails"
        return kind, ", ".join(f"{status} {count} of {len(runs)}" for status, count in failed.items())
    if finest.error is None:
        return "unjudged", "no exact solution or reference to compare with"
    return "not asked", f"finest run {finest.setting.text}, error {finest.error:.2g}"


def _bound(runs: Sequence[Point], measure: str) -> float | None:
    """Return the work of the finest run, a lower bound since more accuracy costs no less; None if not known."""
    for run in reversed(runs):
        work = run.work(measure) if run.success else (run.spent if measure == "time" else run.evaluations)
        if work:
            return work
    return None
