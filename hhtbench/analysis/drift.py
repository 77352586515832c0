"""Constraint drift: maxima of every run, runs of equal accuracy, series over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.analysis.accuracy import work_precision
from hhtbench.analysis.cells import NEAR, TYPICAL_ERROR, Point, number, point, typical
from hhtbench.store.rows import RunRow

MOST_COMPONENTS = 3  # of the multipliers drawn over time: more lines cannot be told apart


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
    note: str = ""  #: why the acceleration level was not measured


@dataclass(frozen=True, kw_only=True)
class TimeSeries:
    """One quantity of one run over time."""

    point: Point
    t: tuple[float, ...]  #: [s]
    value: tuple[float | None, ...]
    component: int | None = None  #: of a vector, from 0


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
        note=found.get("acceleration_note") or "",
    )


def equally_accurate(rows: Iterable[RunRow], error: float = TYPICAL_ERROR) -> dict[str, tuple[Point, ...]]:
    """Entry -> on each problem its run nearest to ``error``, where that is within the factor ``NEAR`` of it."""
    found: dict[str, tuple[Point, ...]] = {}
    for curve in work_precision(rows):
        run = typical(curve.points, error)
        near = run.error is not None and error / NEAR <= run.error <= error * NEAR
        found[curve.entry] = (*found.get(curve.entry, ()), *((run,) if near else ()))
    return found


def drift_series(rows: Iterable[RunRow], level: str) -> tuple[TimeSeries, ...]:
    """Drift over time at one level (or energy), of the rows that kept any; the acceleration level where it was measured."""
    if level == "acceleration":
        measured = [row for row in rows if number(row.metrics, "drift", "acceleration") is not None]
        return _series((row, row.series.get("acceleration") or {}, "value") for row in measured)
    return _series((row, row.series.get("drift") or {}, level) for row in rows)


def invariant_names(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Invariants that some row kept over time."""
    found = [(row.series.get("drift") or {}).get("invariants") or {} for row in rows]
    return tuple(dict.fromkeys(name for names in found for name in names))


def invariant_series(rows: Iterable[RunRow], name: str) -> tuple[TimeSeries, ...]:
    """Relative change of one invariant over time."""
    kept = [(row, row.series.get("drift") or {}) for row in rows]
    return _series((row, {"t": found.get("t"), **(found.get("invariants") or {})}, name) for row, found in kept)


def _series(found: Iterable[tuple[RunRow, Mapping[str, Any], str]]) -> tuple[TimeSeries, ...]:
    return tuple(
        TimeSeries(point=point(row), t=tuple(series["t"]), value=tuple(series[name]))
        for row, series, name in found
        if series.get("t") and series.get(name)
    )


def multiplier_series(rows: Sequence[RunRow], name: str) -> tuple[TimeSeries, ...]:
    """``lam`` or ``mu`` over time: of every row the same ``MOST_COMPONENTS`` components, the largest over all rows."""
    kept = []
    for row in rows:
        series = row.series.get("multipliers") or {}
        values = np.array(series.get(name) or [[]], dtype=np.float64)  # null, a value that is not finite, becomes NaN
        if values.ndim == 2 and values.size and len(series["t"]) == len(values):
            kept.append((row, tuple(series["t"]), values))
    if not kept:
        return ()
    largest = np.max(
        [np.nan_to_num(np.abs(values)).max(axis=0) for row, _, values in kept if row.success] or [[0.0]], axis=0
    )
    chosen = sorted(np.argsort(-largest, kind="stable")[:MOST_COMPONENTS].tolist())
    return tuple(
        TimeSeries(
            point=point(row), t=t, value=tuple(None if np.isnan(x) else float(x) for x in values[:, index]), component=index
        )
        for row, t, values in kept
        for index in chosen
    )
