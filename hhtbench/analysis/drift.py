"""Constraint drift: maxima of every run, and series over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hhtbench.analysis.cells import Point, number, point
from hhtbench.store.rows import RunRow


@dataclass(frozen=True, kw_only=True)
class DriftRow:
    """Largest drift of one run; None where the level does not exist or nothing was measured."""

    point: Point
    position: float | None
    velocity: float | None
    acceleration: float | None
    energy: float | None
    invariants: Mapping[str, float] = field(default_factory=dict)
    sampled: str = ""  #: "steps" (every internal step) or "rows" (output times only)


@dataclass(frozen=True, kw_only=True)
class TimeSeries:
    """One quantity of one run over time."""

    point: Point
    t: tuple[float, ...]  #: [s]
    value: tuple[float | None, ...]


def drift(rows: Iterable[RunRow]) -> tuple[DriftRow, ...]:
    """One line a row, in their order."""
    return tuple(_line(row) for row in rows)


def _line(row: RunRow) -> DriftRow:
    found = row.metrics.get("drift") or {}
    invariants = {name: number(found, "invariants", name) for name in found.get("invariants") or {}}
    return DriftRow(
        point=point(row),
        position=number(found, "position"),
        velocity=number(found, "velocity"),
        acceleration=number(found, "acceleration"),
        energy=number(found, "energy"),
        invariants={name: value for name, value in invariants.items() if value is not None},
        sampled=found.get("sampled") or "",
    )


def drift_series(rows: Iterable[RunRow], level: str) -> tuple[TimeSeries, ...]:
    """Drift over time at one level, of the rows that kept any."""
    found = []
    for row in rows:
        series = row.series.get("drift") or {}
        if series.get("t") and series.get(level):
            found.append(TimeSeries(point=point(row), t=tuple(series["t"]), value=tuple(series[level])))
    return tuple(found)
