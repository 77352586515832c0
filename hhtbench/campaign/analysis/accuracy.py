"""Curves of achieved error against tolerance or step, with fitted slopes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hhtbench.campaign.analysis.cells import Point, by_problem, points
from hhtbench.campaign.store.rows import RunRow

LEAST_POINTS = 3  # fewest points of a fitted slope; two points fit any line
ROUNDOFF = 1e-12  # scaled errors below it say nothing of an order
COARSE = 0.1  # scaled errors above it lie before the range where an order shows


@dataclass(frozen=True, kw_only=True)
class Slope:
    """Straight line fitted to logarithms."""

    value: float
    count: int  #: points it was fitted to
    spread: float  #: largest distance of a point from the line, in decades


@dataclass(frozen=True, kw_only=True)
class ConvergenceCurve:
    """Error against tolerance or step."""

    problem: str
    entry: str
    kind: str  #: "rtol", "step" or "steps"
    points: tuple[Point, ...]
    slope: Slope | None  #: None where fewer than ``LEAST_POINTS`` runs can be judged


def convergence(rows: Iterable[RunRow]) -> tuple[ConvergenceCurve, ...]:
    """Return one curve for each problem, solver and kind of setting."""
    curves = []
    for problem, groups in by_problem(points(rows)).items():
        for entry, runs in groups.items():
            for kind in dict.fromkeys(run.setting.kind for run in runs):
                own = tuple(run for run in runs if run.setting.kind == kind)
                curves.append(ConvergenceCurve(problem=problem, entry=entry, kind=kind, points=own, slope=fit(own)))
    return tuple(curves)


def fit(runs: Sequence[Point]) -> Slope | None:
    """Fit the slope of error against setting over successful runs from the reference's limit or roundoff to ``COARSE``."""
    judged = [(run.setting.value, run.error) for run in runs if run.error and max(run.limit, ROUNDOFF) < run.error <= COARSE]
    if len({x for x, _ in judged}) < LEAST_POINTS:
        return None
    x, y = (np.log10(np.asarray(values, dtype=np.float64)) for values in zip(*judged, strict=True))
    slope, height = np.polyfit(x, y, 1)
    return Slope(value=float(slope), count=len(judged), spread=float(np.max(np.abs(y - slope * x - height))))
