"""What an error costs HHT and its rivals on each scene, and over all scenes.

HHT counts only with both levels of the constraints below ``STEADY``; its rivals may drift.  Alpha methods are HHT, HHT-I3
and generalised-alpha: a scene is won against all solvers, the factor is over the best method that is no alpha method.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import CONSTANT, SUBJECT, family
from hhtbench.campaign.analysis.fronts import STEADY, Comparison, Front, campaign_of
from hhtbench.campaign.store import RunRow

ALPHA = (SUBJECT, "generalised_alpha", "hht_i3")
SCENES = {  # where a scene has two problems, the worse verdict is the scene's
    "spinup_beam": ("spinup_beam(t_end=10)",),
    "right_angle_cantilever": ("right_angle_cantilever",),
    "flexible_crank": ("flexible_crank(t_end=0.05)",),
    "cable_pendulum": ("cable_pendulum", "cable_pendulum(dimension=3)"),
    "mooring_line": ("mooring_line",),
    "belt_drive": ("belt_drive",),
    "band_track": ("band_track",),
    "cam_follower": ("cam_follower",),
    "ball_mill": ("ball_mill",),
    "falling_net": ("falling_net",),
    "bushing_chain": ("bushing_chain(c=3500.0)", "bushing_chain(c=3500000.0)"),
    "train_buffers": ("train_buffers",),
}
BEAMS = ("spinup_beam", "right_angle_cantilever", "flexible_crank")
NEVER = (
    "refused",
    "fails",
    "standstill",
)  # kinds of reasons of a solver that would not reach an error with more time either

Key = tuple[str, float]  # problem, error


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """HHT on one problem at one error."""

    target: float
    ours: float | None  #: least time of HHT [s]
    outcome: str  #: against all solvers: "wins", "alone", "level", "loses", "absent" or "unknown"
    winner: str  #: the cheapest solver of all, "" if none reaches the error
    rival: str  #: the cheapest that is no alpha method, "" if none reaches the error
    factor: float  #: its time over HHT's; 0 where HHT does not reach the error
    bound: bool  #: no such method reaches the error within its limits: the factor is at least this

    @property
    def won(self) -> bool:
        """True if no other solver reaches the error for less."""
        return self.outcome in ("wins", "alone")


def verdicts(rows: Sequence[RunRow], targets: Sequence[float], constant: bool = True) -> dict[Key, Verdict]:
    """Return the verdict of each problem and error; HHT counts with error control, and if ``constant`` with equal steps."""
    level = campaign_of(rows).level
    held = {(front.problem, front.target): front for front in analysis.fronts(rows, "time", targets, held=STEADY)}
    found = {}
    for front in analysis.fronts(rows, "time", targets):
        at = front.problem, front.target
        ours = _part(held[at], lambda entry: family(entry) == SUBJECT and (constant or not entry.endswith(CONSTANT)))
        others = _part(front, lambda entry: family(entry) != SUBJECT)
        found[at] = _verdict(ours, others, level)
    return found


def _verdict(ours: Front, others: Front, level: float) -> Verdict:
    against_all = _joined(ours, others, level)
    strangers = _part(others, lambda entry: family(entry) not in ALPHA)
    least = None if against_all.subject is None else against_all.subject.value
    if least is None:
        factor = 0.0
    elif strangers.costs:
        factor = strangers.costs[0].value / least
    else:
        tried = [why.bound for why in strangers.missing.values() if why.kind not in NEVER and why.bound]
        factor = min(tried, default=math.inf) / least
    return Verdict(
        target=others.target,
        ours=least,
        outcome=against_all.outcome,
        winner=against_all.costs[0].entry if against_all.costs else "",
        rival=strangers.costs[0].entry if strangers.costs else "",
        factor=factor,
        bound=least is not None and not strangers.costs,
    )


def _part(front: Front, chosen: Callable[[str], bool]) -> Front:
    """Return ``front`` with only those entries for which ``chosen(entry)`` is true."""
    costs = tuple(cost for cost in front.costs if chosen(cost.entry))
    return replace(front, costs=costs, missing={entry: why for entry, why in front.missing.items() if chosen(entry)})


def _joined(ours: Front, others: Front, level: float) -> Comparison:
    costs = tuple(sorted((*ours.costs, *others.costs), key=lambda cost: cost.value))
    return Comparison(**vars(others) | {"costs": costs, "missing": {**ours.missing, **others.missing}}, level=level)


def by_scene(found: Mapping[Key, Verdict], target: float) -> dict[str, Verdict]:
    """Return the verdict of every scene whose problems were all run; one that is not won counts before one that is."""
    return {
        scene: min((found[problem, target] for problem in problems), key=lambda one: (one.won, one.factor))
        for scene, problems in SCENES.items()
        if all((problem, target) in found for problem in problems)
    }


def summary(scenes: Mapping[str, Verdict]) -> str:
    """State on how many scenes HHT is the cheapest, the median factors, and where it loses to whom."""
    won, ahead = (sum(test(one) for one in scenes.values()) for test in (lambda one: one.won, lambda one: one.factor > 1.0))
    level = [name for name, one in scenes.items() if one.outcome == "level"]
    lost = [f"{name} to {one.winner or 'nobody'}" for name, one in scenes.items() if not one.won and name not in level]
    medians = [
        statistics.median(one.factor for name, one in scenes.items() if name in names) if names & scenes.keys() else math.nan
        for names in (set(SCENES), set(BEAMS))
    ]
    return (
        f"cheapest of all solvers on {won} of {len(scenes)} scenes, level on {len(level)} more, cheaper than all that are "
        f"no alpha methods on {ahead}; the best of these takes {medians[0]:.3g} times as long (median), on beams "
        f"{medians[1]:.3g} times. It loses: {', '.join(lost) or 'nowhere'}."
    )
