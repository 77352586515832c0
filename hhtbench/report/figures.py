"""The curves of a verification as figures, drawn as those of the comparison, with a line of the stated slope."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hhtbench.protocol.evidence import Curve, Plot
from hhtbench.report import colours
from hhtbench.report.chart import draw
from hhtbench.report.colours import SolverStyle
from hhtbench.report.frame import Chart, EdgeMark, Trace

GUIDE_BELOW = 0.5  # the guide line runs this factor below the lowest curve, so that it hides none
MAX_MARKED_POINTS = 40  # of a curve; beyond it the marks would hide the line
HEIGHT = 418  # pixels of the drawing area with its axes
LEGEND_ROW = 24  # pixels
LEGEND_CHARACTERS = 66  # characters across the page


def figure(plot: Plot, styles: Mapping[str, int]) -> dict[str, Any]:
    """The figure of one plot; ``styles`` is its part of :func:`~hhtbench.report.colours.style_numbers`.

    Values that cannot be drawn (not finite, or not positive on logarithmic axes) are drawn at the edge with
    an open triangle, never dropped.
    """
    guide = _guide(plot)
    looks = {label: colours.plot_style(number) for label, number in styles.items()}
    looks |= {trace.entry: SolverStyle(colour=colours.GUIDE, dash="dash", symbol="circle", width=1.5) for trace in guide}
    chart = Chart(
        id=plot.id,
        group="",
        view="",
        title=plot.title,
        caption=plot.caption,
        x_label=plot.x_label,
        y_label=plot.y_label,
        traces=(*guide, *(_trace(plot, curve) for curve in plot.curves)),
        marks=tuple(mark for curve in plot.curves for mark in _marks(plot, curve)),
        logarithmic_x=plot.logarithmic,
        logarithmic_y=plot.logarithmic,
        edge="not finite",
    )
    drawn = draw(chart, looks)
    for trace in drawn["data"]:
        if len(trace["x"]) > MAX_MARKED_POINTS:
            trace["mode"] = "lines"
    return _with_legend(drawn, chart)


def _with_legend(drawn: dict[str, Any], chart: Chart) -> dict[str, Any]:
    """A legend below the drawing, for which plotly makes no room by itself."""
    entries = [trace.entry for trace in chart.traces]
    widest = max(map(len, entries), default=0) + 6
    room = LEGEND_ROW * math.ceil(len(entries) / max(1, LEGEND_CHARACTERS // widest))
    legend = {"orientation": "h", "x": 0, "xanchor": "left", "y": 0, "yref": "container", "yanchor": "bottom"}
    drawn["layout"] |= {"height": HEIGHT + room, "legend": legend}
    drawn["layout"]["margin"] = {"l": 84, "r": 20, "t": 30, "b": 74 + room}
    return show_legend(drawn, chart)


def show_legend(drawn: dict[str, Any], chart: Chart) -> dict[str, Any]:
    """The figure of ``chart`` with a legend of its own, which names each curve once."""
    named = {trace.entry for trace in chart.traces}
    for trace in drawn["data"]:
        trace["showlegend"] = trace["name"] in named and trace["mode"] != "markers"
    drawn["layout"]["showlegend"] = True
    return drawn


def _usable(plot: Plot, value: float) -> bool:
    return math.isfinite(value) and (value > 0 or not plot.logarithmic)


def _trace(plot: Plot, curve: Curve) -> Trace:
    """The points to draw; a gap (None) where the value cannot be drawn."""
    known = [(float(x), float(y) if _usable(plot, y) else None) for x, y in _pairs(plot, curve)]
    texts = tuple("" if y is None else f"{x:.4g}, {y:.4g}" for x, y in known)
    return Trace(entry=curve.label, x=tuple(x for x, _ in known), y=tuple(y for _, y in known), text=texts)


def _marks(plot: Plot, curve: Curve) -> list[EdgeMark]:
    """Of values that cannot be drawn: at the bottom what is zero or below, at the top what is not finite."""
    lost = [(float(x), float(y)) for x, y in _pairs(plot, curve) if not _usable(plot, y)]
    return [
        EdgeMark(entry=curve.label, status=curve.label, text=f"{y:g}", x=x, y=0.0 if math.isfinite(y) or y < 0 else None)
        for x, y in lost
    ]


def _pairs(plot: Plot, curve: Curve) -> list[tuple[float, float]]:
    return [(x, y) for x, y in zip(curve.x, curve.y, strict=True) if _usable(plot, x)]


def _guide(plot: Plot) -> list[Trace]:
    """A dashed line of the stated slope below the curves, cut off where it would lie far below all of them."""
    points = [(x, y) for curve in plot.curves for x, y in _pairs(plot, curve) if _usable(plot, y)]
    if plot.slope is None or not plot.logarithmic or not points:
        return []
    height = GUIDE_BELOW * min(y / x**plot.slope for x, y in points)
    lowest = GUIDE_BELOW * min(y for _, y in points)
    ends = [(x, height * x**plot.slope) for x in (min(x for x, _ in points), max(x for x, _ in points))]
    ends = [(x, y) if y >= lowest else ((lowest / height) ** (1.0 / plot.slope), lowest) for x, y in ends]
    return [Trace(entry=f"slope {plot.slope:g}", x=tuple(x for x, _ in ends), y=tuple(y for _, y in ends))]
