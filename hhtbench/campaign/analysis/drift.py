"""Compare runs of equal accuracy: drift over time, and drift against cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.campaign.analysis.cells import NEAR, TYPICAL_ERROR, Point, by_problem, point, points, typical
from hhtbench.campaign.analysis.fronts import Cost, fronts
from hhtbench.campaign.store.rows import RunRow

MOST_COMPONENTS = 3  # components of multipliers drawn over time: more lines cannot be distinguished


@dataclass(frozen=True, kw_only=True)
class TimeSeries:
    """One quantity of one run over time."""

    point: Point
    t: tuple[float, ...]  #: [s]
    value: tuple[float | None, ...]
    component: int | None = None  #: number of the vector's component, from 0


def equally_accurate(rows: Iterable[RunRow], error: float = TYPICAL_ERROR) -> dict[str, tuple[Point, ...]]:
    """Map each entry to its runs nearest to ``error`` on each problem, within the factor ``NEAR``."""
    found: dict[str, tuple[Point, ...]] = {}
    for groups in by_problem(points(rows)).values():
        for entry, runs in groups.items():
            run = typical(runs, error)
            near = run.error is not None and error / NEAR <= run.error <= error * NEAR
            found[entry] = (*found.get(entry, ()), *((run,) if near else ()))
    return found


def drift_series(rows: Iterable[RunRow], level: str) -> tuple[TimeSeries, ...]:
    """Return drift at one level, change of energy, or of an invariant by its name, over time for rows that stored it."""
    if level == "acceleration":
        measured = [row for row in rows if point(row).acceleration is not None]
        return _series((row, row.series.get("acceleration") or {}, "value") for row in measured)
    kept = [(row, row.series.get("drift") or {}) for row in rows]
    return _series((row, {**(found.get("invariants") or {}), **found}, level) for row, found in kept)


def invariant_names(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Return the names of the invariants that some row stored over time."""
    found = [(row.series.get("drift") or {}).get("invariants") or {} for row in rows]
    return tuple(dict.fromkeys(name for names in found for name in names))


def _series(found: Iterable[tuple[RunRow, Mapping[str, Any], str]]) -> tuple[TimeSeries, ...]:
    return tuple(
        TimeSeries(point=point(row), t=tuple(series["t"]), value=tuple(series[name]))
        for row, series, name in found
        if series.get("t") and series.get(name)
    )


def multiplier_series(rows: Sequence[RunRow], name: str) -> tuple[TimeSeries, ...]:
    """Return ``lam`` or ``mu`` over time for every row: the ``MOST_COMPONENTS`` components largest over all rows."""
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


@dataclass(frozen=True, kw_only=True)
class DriftCost:
    """Drift and cost of one solver on one problem at one error, beside HHT's cost."""

    problem: str
    cost: Cost
    own: Cost  #: cost of HHT's cheapest entry
    drift: float  #: the larger of position and velocity, scaled, of the run at the accurate end

    @property
    def ratio(self) -> float:
        """Cost divided by that of HHT's cheapest entry."""
        return self.cost.value / self.own.value

    @property
    def bound(self) -> bool:
        """True if either cost is only an upper bound, so that the ratio is not one of costs at this error."""
        return self.cost.bound or self.own.bound


def drift_costs(rows: Sequence[RunRow], measure: str, target: float = TYPICAL_ERROR) -> dict[str, tuple[DriftCost, ...]]:
    """Map each entry to its drift and cost on every problem with constraints where both it and HHT reach ``target``."""
    found: dict[str, list[DriftCost]] = {}
    for front in fronts(rows, measure, (target,)):
        own = front.subject
        if own is None:
            continue
        for cost in front.costs:
            if cost.run.drift is not None:
                line = DriftCost(problem=front.problem, cost=cost, own=own, drift=cost.run.drift)
                found.setdefault(cost.entry, []).append(line)
    return {entry: tuple(lines) for entry, lines in found.items()}
