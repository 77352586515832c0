"""Accuracy: against work, against what was asked, of the multipliers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hhtbench.analysis.cells import DOUBTED, Point, by_entry, entry_of, number, point, points
from hhtbench.store.rows import RunRow

LEAST_POINTS = 3  # of a fitted slope; two points fit any line
ROUNDOFF = 1e-12  # scaled errors below it say nothing of an order
COARSE = 0.1  # scaled errors above it lie before the range where an order shows


@dataclass(frozen=True, kw_only=True)
class WorkCurve:
    """Error against work of one solver on one problem; failed runs are among the points with ``error`` None."""

    problem: str
    entry: str
    points: tuple[Point, ...]  #: loosest setting first


@dataclass(frozen=True, kw_only=True)
class Slope:
    """A straight line through the logarithms."""

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


@dataclass(frozen=True, kw_only=True)
class MultiplierPoint:
    """Scaled errors of the multipliers of one run, largest over the compared times."""

    point: Point
    lam: float | None
    mu: float | None


def work_precision(rows: Iterable[RunRow]) -> tuple[WorkCurve, ...]:
    """One curve for each problem and solver."""
    grouped = _by_problem(points(rows))
    return tuple(
        WorkCurve(problem=problem, entry=entry, points=tuple(runs))
        for problem, found in grouped.items()
        for entry, runs in by_entry(found).items()
    )


def convergence(rows: Iterable[RunRow]) -> tuple[ConvergenceCurve, ...]:
    """One curve for each problem, solver and kind of setting."""
    curves = []
    for problem, found in _by_problem(points(rows)).items():
        for entry, runs in by_entry(found).items():
            for kind in dict.fromkeys(run.setting.kind for run in runs):
                own = tuple(run for run in runs if run.setting.kind == kind)
                curves.append(ConvergenceCurve(problem=problem, entry=entry, kind=kind, points=own, slope=fit(own)))
    return tuple(curves)


def fit(runs: Sequence[Point]) -> Slope | None:
    """Slope of error against setting over successful runs, above the reference's limit and roundoff, up to ``COARSE``."""
    judged = [(run.setting.value, run.error) for run in runs if run.error and max(run.limit, ROUNDOFF) < run.error <= COARSE]
    if len({x for x, _ in judged}) < LEAST_POINTS:
        return None
    x, y = (np.log10(np.asarray(values, dtype=np.float64)) for values in zip(*judged, strict=True))
    slope, height = np.polyfit(x, y, 1)
    return Slope(value=float(slope), count=len(judged), spread=float(np.max(np.abs(y - slope * x - height))))


def multipliers(rows: Iterable[RunRow]) -> tuple[MultiplierPoint, ...]:
    """One point a row; a failed run has neither error, one that is not believed has both."""
    found = []
    for row in rows:
        lam, mu = (component_error(row, name) if row.success or row.status == DOUBTED else None for name in ("lam", "mu"))
        found.append(MultiplierPoint(point=point(row), lam=lam, mu=mu))
    return tuple(found)


def component_error(row: RunRow, name: str) -> float | None:
    """Largest scaled error of one component (q, v, lam, mu) as far as the run came."""
    return number(row.metrics, "errors", name, "max_scaled")


def entries(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Every solver's entry, in order of first appearance."""
    return tuple(dict.fromkeys(entry_of(row) for row in rows))


def _by_problem(found: Iterable[Point]) -> dict[str, list[Point]]:
    groups: dict[str, list[Point]] = {}
    for item in found:
        groups.setdefault(item.problem, []).append(item)
    return groups
