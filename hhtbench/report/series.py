"""The charts over time of one problem: drift at every level, energy, invariants and multipliers of the typical runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import DOUBTED, TYPICAL_ERROR, Point
from hhtbench.campaign.analysis.drift import TimeSeries, invariant_names, multiplier_series
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.colours import solver_order
from hhtbench.report.frame import Chart, Trace
from hhtbench.report.marks import described, mark_of
from hhtbench.report.runs import typical_runs
from hhtbench.report.words import listed

LEAST_DRIFT = 1e-18  # zero has no place on a logarithmic axis and is drawn here
MAX_POINTS = 40  # of a series over time
LEVELS = ("position", "velocity", "acceleration")
OVER_TIME, MULTIPLIERS = "Over time", "Multipliers"  # titles of figures
SYMBOLS = {"lam": "λ", "mu": "μ"}


def charts_over_time(rows: Sequence[RunRow]) -> list[Chart]:
    """All of them that have something to show; ``rows`` are those of one problem."""
    chosen = typical_runs(rows)
    keys = {run.key for run in chosen}
    own = [row for row in rows if row.key in keys]
    charts = [_of_level(chosen, own, level) for level in LEVELS]
    for name in ("energy", *invariant_names(own)):
        kind, unit = ("drift", "scaled") if name == "energy" else ("invariant", "relative")
        named: dict[str, Any] = {"id": f"{kind}-{name}", "view": name, "title": f"Change of {name} over time"}
        charts.append(_chart(chosen, analysis.drift_series(own, name), **named, y_label=f"{unit} change of {name}"))
    for name in SYMBOLS:
        charts.append(_of_multipliers(chosen, multiplier_series([row for row in own if row.success], name), name))
    return [chart for chart in charts if chart is not None]


def _of_level(chosen: Sequence[Point], rows: Sequence[RunRow], level: str) -> Chart | None:
    own = level == "acceleration"
    return _chart(
        chosen,
        analysis.drift_series(rows, level),
        note=ACCELERATIONS if own else "",
        id=f"drift-{level}",
        view=f"{level} drift",
        title="Drift of the acceleration level over time" if own else f"Drift of the {level} constraints over time",
        y_label=f"scaled {level} drift",
    )


ACCELERATIONS = " At output times, with the accelerations that follow from each solver's own multipliers."


def _of_multipliers(chosen: Sequence[Point], series: Sequence[TimeSeries], name: str) -> Chart | None:
    components = sorted({item.component for item in series if item.component is not None})
    named = listed([f"{name}[{index}]" for index in components]) if components else name
    return _chart(
        chosen,
        series,
        note=f" {named}, recovered from the acceleration level at output times; the lines of solvers that agree coincide.",
        id=f"series-{name}",
        group=MULTIPLIERS,
        view=f"{SYMBOLS[name]} over time",
        title=f"Multipliers {SYMBOLS[name]} over time",
        y_label=SYMBOLS[name],
        logarithmic_y=False,
    )


def _chart(
    chosen: Sequence[Point],
    found: Sequence[TimeSeries],
    note: str = "",
    group: str = OVER_TIME,
    logarithmic_y: bool = True,
    **named: Any,
) -> Chart | None:
    """``named``: id, view, title and y_label of the chart."""
    if not found:
        return None
    traces, marks = [], []
    end = max((series.t[-1] for series in found), key=lambda t: abs(t - found[0].t[0]))  # time may run backward
    order = solver_order(series.point.entry for series in found)  # HHT's thick lines first, below the others'
    for series in sorted(found, key=lambda series: order.index(series.point.entry)):
        run = series.point
        stride = -(-len(series.t) // MAX_POINTS)
        t, value = _thinned(series, end) if logarithmic_y else (series.t[::stride], series.value[::stride])
        component = "" if series.component is None else f"component {series.component}<br>"
        traces.append(Trace(entry=run.entry, x=t, y=value, note=f"{component}{described(run)}"))
        if not run.success:
            marks.append(mark_of(run, series.t[-1], value[-1] if value and run.status == DOUBTED else None))
    zero = logarithmic_y and any(y is not None and y <= LEAST_DRIFT for trace in traces for y in trace.y)
    floor = f" Zero is drawn at {LEAST_DRIFT:.0e}." if zero else ""
    if zero and all(y is None or y <= LEAST_DRIFT for trace in traces for y in trace.y):
        floor = f" All solvers keep it exactly.{floor}"
    head = f"Each solver's run with an error nearest to {TYPICAL_ERROR:.0e}{_spread(chosen)}."
    return Chart(
        group=group,
        caption=f"{head}{note}{_absent(chosen, traces, named['id'] == 'drift-acceleration')}{floor}",
        x_label="time [s]",
        traces=tuple(traces),
        marks=tuple(marks),
        logarithmic_x=False,
        logarithmic_y=logarithmic_y,
        **named,
    )


def _absent(chosen: Sequence[Point], traces: Sequence[Trace], noted: bool) -> str:
    """Who has no series, and why: where the level is ``noted`` the note that it was not measured, else the status."""
    named = {trace.entry for trace in traces}
    reasons: dict[str, list[str]] = {}
    for run in chosen:
        if run.entry not in named:
            note = run.note if noted else ""
            reasons.setdefault(note or run.status, []).append(run.entry)
    parts = [f"{listed(entries)} ({reason})" for reason, entries in reasons.items()]
    return f" No series: {'; '.join(parts)}." if parts else ""


def _spread(chosen: Sequence[Point]) -> str:
    """How far from equal accuracy the runs are that stand side by side."""
    errors = [run.error for run in chosen if run.error is not None]
    return f" (they are from {min(errors):.1e} to {max(errors):.1e})" if errors else ", or a middle setting as none is known"


def _thinned(series: TimeSeries, end: float) -> tuple[tuple[float, ...], tuple[float | None, ...]]:
    """The largest value of each of ``MAX_POINTS`` equal stretches up to ``end``, in its middle; zero at ``LEAST_DRIFT``."""
    largest: dict[int, float] = {}
    start = series.t[0]
    for t, value in zip(series.t, series.value, strict=True):
        stretch = min(int(MAX_POINTS * (t - start) / (end - start)), MAX_POINTS - 1) if end != start else 0
        if value is not None:
            largest[stretch] = max(value, largest.get(stretch, LEAST_DRIFT))
    width = (end - start) / MAX_POINTS
    return tuple(start + (stretch + 0.5) * width for stretch in largest), tuple(float(f"{y:.1e}") for y in largest.values())
