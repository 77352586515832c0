"""Tables of curves in, plotly figures out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import plotly.graph_objects as go

from hhtbench.evidence import Curve, Plot
from hhtbench.report import colours

MARGIN = 0.06  # of the axis, left free around the data
GUIDE_BELOW = 0.5  # the guide line runs this factor below the lowest curve, so that it hides none
LEAST_DECADES = 0.9  # of a logarithmic axis, so that two of 1, 2, 5 are on it
MOST_MARKS = 40  # points of a curve; beyond it the marks would hide the line
MOST_TICKS = 9  # of a logarithmic axis: labels of more are turned
HEIGHT = 418  # pixels of the drawing area with its axes
LEGEND_ROW = 24  # pixels
LEGEND_COLUMN = 20  # characters of one entry, about; decides how many rows the legend takes
LEGEND_CHARACTERS = 66  # characters across the page


def figure(plot: Plot, styles: dict[str, int]) -> go.Figure:
    """The figure of one plot; ``styles`` is its part of :func:`~hhtbench.report.colours.style_numbers`.

    Values that cannot be drawn (not finite, or not positive on logarithmic axes) are drawn at the edge with
    an open triangle, never dropped.
    """
    x_range, y_range = _ranges(plot)
    result = go.Figure()
    if plot.slope is not None and plot.logarithmic:
        _add_guide(result, plot, x_range, y_range)
    for curve in plot.curves:
        look = colours.marked_line(styles[curve.label])
        x, y = _inside(plot, curve)
        mode = "lines+markers" if len(x) <= MOST_MARKS else "lines"
        result.add_scatter(x=x, y=y, name=curve.label, mode=mode, hovertemplate="%{x:.4g}, %{y:.4g}", **look)
        _add_edge_marks(result, plot, curve, (x_range, y_range))
    _lay_out(result, plot, x_range, y_range)
    return result


def _lay_out(result: go.Figure, plot: Plot, x_range: list[float], y_range: list[float]) -> None:
    rows = _legend_rows(plot)
    result.update_layout(
        template="none",
        height=HEIGHT + rows * LEGEND_ROW,
        margin={"l": 84, "r": 20, "t": 30, "b": 74 + rows * LEGEND_ROW},
        font={"family": colours.FONT, "size": 14, "color": colours.TEXT},
        legend={"orientation": "h", "x": 0, "xanchor": "left", "y": 0, "yref": "container", "yanchor": "bottom"},
        xaxis=axis(plot.x_label, x_range, plot.logarithmic),
        yaxis=axis(plot.y_label, y_range, plot.logarithmic) | {"automargin": True},
        hovermode="closest",
    )


def axis(label: str, limits: list[float], logarithmic: bool) -> dict[str, Any]:
    """Layout of one axis; ``limits`` are exponents of ten where it is logarithmic."""
    layout: dict[str, Any] = {
        "title": {"text": label, "standoff": 12},
        "range": limits,
        "showline": True,
        "mirror": True,
        "linecolor": colours.TEXT,
        "ticks": "outside",
        "gridcolor": colours.GRID,
        "zeroline": False,
        "exponentformat": "power",
    }
    if logarithmic:
        decades = limits[1] - limits[0]
        layout |= {"type": "log", "dtick": "D2" if decades < 1.5 else math.ceil(decades / MOST_TICKS), "tickangle": 0}
        if decades < 6:
            layout["minor"] = {
                "dtick": "D1",
                "ticks": "outside",
                "ticklen": 3,
                "showgrid": True,
                "gridcolor": colours.FINE_GRID,
            }
    return layout


def _usable(plot: Plot, values: tuple[float, ...]) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    return np.isfinite(array) & (array > 0) if plot.logarithmic else np.isfinite(array)


def _inside(plot: Plot, curve: Curve) -> tuple[list[float], list[float | None]]:
    """The points to draw; a gap (None) where the value cannot be drawn."""
    x_good, y_good = _usable(plot, curve.x), _usable(plot, curve.y)
    pairs = zip(curve.x, curve.y, x_good, y_good, strict=True)
    points = [(float(x), float(y) if good else None) for x, y, usable, good in pairs if usable]
    return [x for x, _ in points], [y for _, y in points]


def _ranges(plot: Plot) -> tuple[list[float], list[float]]:
    """Axis limits (exponents of ten on logarithmic axes) that hold every drawable point."""
    limits = []
    for axis in ("x", "y"):
        values = [getattr(curve, axis) for curve in plot.curves]
        good = np.concatenate([np.asarray(v, dtype=np.float64)[_usable(plot, v)] for v in values] or [np.empty(0)])
        if plot.logarithmic:
            good = np.log10(good)
        low, high = (float(good.min()), float(good.max())) if good.size else (0.0, 1.0)
        missing = max(0.0, LEAST_DECADES - (high - low)) / 2 if plot.logarithmic else 0.0
        low, high = low - missing, high + missing
        if axis == "y" and plot.slope is not None and plot.logarithmic:
            low += math.log10(GUIDE_BELOW)
        room = MARGIN * (high - low) or 0.5
        limits.append([low - room, high + room])
    return limits[0], limits[1]


def _add_edge_marks(result: go.Figure, plot: Plot, curve: Curve, ranges: tuple[list[float], list[float]]) -> None:
    """Open triangles at the bottom (zero or below) or the top (not finite) of the plot."""
    x_good, y_good = _usable(plot, curve.x), _usable(plot, curve.y)
    lost = [(x, y) for x, y, usable, good in zip(curve.x, curve.y, x_good, y_good, strict=True) if usable and not good]
    if not lost:
        return
    bottom, top = ranges[1]
    inset = 0.02 * (top - bottom)  # on the very edge rounding would hide a mark
    low, high = (10.0**limit if plot.logarithmic else limit for limit in (bottom + inset, top - inset))
    below = [math.isfinite(y) or y == -math.inf for _, y in lost]
    index = next(i for i, other in enumerate(result.data) if other.name == curve.label)
    result.add_scatter(
        x=[x for x, _ in lost],
        y=[low if down else high for down in below],
        mode="markers",
        marker={
            "symbol": ["triangle-down-open" if down else "triangle-up-open" for down in below],
            "size": 13,
            "color": result.data[index].line.color,
        },
        text=[f"{curve.label}: {y}" for _, y in lost],
        hoverinfo="text",
        cliponaxis=False,
        showlegend=False,
    )


def _add_guide(result: go.Figure, plot: Plot, x_range: list[float], y_range: list[float]) -> None:
    """A dashed line of the stated slope below the curves, as far as it stays within the plot."""
    slope = float(plot.slope or 0.0)
    points = [
        (math.log10(x), math.log10(y))
        for curve in plot.curves
        for x, y, a, b in zip(curve.x, curve.y, _usable(plot, curve.x), _usable(plot, curve.y), strict=True)
        if a and b
    ]
    if not points:
        return
    height = min(y - slope * x for x, y in points) + math.log10(GUIDE_BELOW)
    grid = np.linspace(x_range[0], x_range[1], 200)
    line = slope * grid + height
    seen = (line >= y_range[0]) & (line <= y_range[1])
    if np.count_nonzero(seen) < 2:
        return
    ends = [int(i) for i in np.flatnonzero(seen)[[0, -1]]]
    result.add_scatter(
        x=[10.0 ** float(grid[i]) for i in ends],
        y=[10.0 ** float(line[i]) for i in ends],
        name=f"slope {slope:g}",
        mode="lines",
        line={"color": colours.GUIDE, "width": 1.5, "dash": "dash"},
        hoverinfo="skip",
        legendrank=2000,  # after the curves (1000)
    )


def _legend_rows(plot: Plot) -> int:
    """Rows that the legend below the plot takes; plotly does not make room for them by itself."""
    entries = [curve.label for curve in plot.curves] + (["slope 2"] if plot.slope is not None else [])
    widest = max((len(entry) for entry in entries), default=0) + 6
    return math.ceil(len(entries) / max(1, LEGEND_CHARACTERS // widest))
