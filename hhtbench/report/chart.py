"""One chart of the comparison: lines by solver, and marks at the edge for what has no place inside."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hhtbench.report import colours
from hhtbench.report.colours import SolverStyle
from hhtbench.report.frame import Chart, EdgeMark, Frame, Trace, make_frame, place_of

HEIGHT = 430  # pixels
MAX_TICKS = 9  # labels of a logarithmic axis: more are turned
DIGITS = 3  # significant digits of a value on a page
PARTS = 1000.0  # parts of an axis to which values over time are rounded

# Marks at the edge by status: a spent budget and a refusal differ without hovering.
STATUS_SYMBOLS = {
    "declined": "circle-open",
    "deadline": "hourglass-open",
    "max_steps": "hourglass-open",
    "evaluation_budget": "hourglass-open",
    "crashed": "x-thin-open",
    "out_of_memory": "x-thin-open",
    "user_exception": "x-thin-open",
}
OTHER_SYMBOL = "triangle-up-open"


def draw(chart: Chart, styles: Mapping[str, SolverStyle]) -> dict[str, Any]:
    """The figure as plotly.js takes it; its legend is the page's, which shows and hides a solver on all charts.

    ``front`` names who is shown first.  Not made by plotly.py's own classes, which check every value and take as long as
    all else of a report.
    """
    frame = make_frame(chart)
    order = {entry: index for index, entry in enumerate(styles)}
    data = [_trace(trace, styles[trace.entry], chart) for trace in chart.traces]
    for mark in chart.marks:
        place = place_of(chart, frame, mark, order[mark.entry], len(order))
        data.append(_mark(mark, styles[mark.entry], place))
    x_axis = axis(chart.x_label, [frame.x[0], frame.right], chart.logarithmic_x)
    y_axis = axis(chart.y_label, [frame.y[0], frame.top], chart.logarithmic_y) | {"automargin": True}
    if chart.logarithmic_x:
        _end_ticks(x_axis, frame.x[1], frame.right)
    if chart.logarithmic_y:
        _end_ticks(y_axis, frame.y[1], frame.top)
    layout = layout_of(x_axis, y_axis) | _edges(chart, frame)
    return {"data": data, "layout": layout, "front": [entry for entry in styles if entry in chart.front]}


def layout_of(x_axis: dict[str, Any], y_axis: dict[str, Any]) -> dict[str, Any]:
    """What all charts of the page have in common."""
    return {
        "height": HEIGHT,
        "margin": {"l": 76, "r": 16, "t": 30, "b": 60},
        "font": {"family": colours.FONT, "size": 14, "color": colours.TEXT},
        "showlegend": False,
        "hovermode": "closest",
        "xaxis": x_axis,
        "yaxis": y_axis,
    }


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
        layout |= {"type": "log", "dtick": "D2" if decades < 1.5 else math.ceil(decades / MAX_TICKS), "tickangle": 0}
        if decades < 6:
            layout["minor"] = {
                "dtick": "D1",
                "ticks": "outside",
                "ticklen": 3,
                "showgrid": True,
                "gridcolor": colours.FINE_GRID,
            }
    return layout


def _end_ticks(layout: dict[str, Any], end: float, strip: float) -> None:
    """No ticks in the strip: a mark there has no value."""
    step = layout["dtick"]
    if strip > end and isinstance(step, int):
        first = math.ceil(layout["range"][0])
        exponents = range(first, math.floor(end) + 1, step)
        texts = ["1" if n == 0 else f"10<sup>{n}</sup>".replace("-", "\N{MINUS SIGN}") for n in exponents]
        layout |= {"tickmode": "array", "tickvals": [10.0**n for n in exponents], "ticktext": texts}
        layout.pop("minor", None)


def _trace(trace: Trace, style: SolverStyle, chart: Chart) -> dict[str, Any]:
    look: dict[str, Any] = {"type": "scatter", "name": trace.entry, "line": style.line}
    if trace.text:
        look |= {
            "mode": "lines+markers",
            "marker": {"color": style.colour, "size": 8, "symbol": style.symbol},
            "text": trace.text,
            "hovertemplate": "<b>%{fullData.name}</b><br>%{text}<extra></extra>",
            "x": [rounded(x) for x in trace.x],
            "y": [rounded(y) for y in trace.y],
        }
    else:
        look |= {
            "mode": "lines",
            "hovertemplate": f"<b>%{{fullData.name}}</b><br>{trace.note}<br>%{{x:.4g}} s: %{{y:.3g}}<extra></extra>",
            "x": trace.x if chart.logarithmic_x else on_axis(trace.x),
            "y": trace.y if chart.logarithmic_y else on_axis(trace.y),
        }
    return look


def on_axis(values: Sequence[float | None]) -> list[float | None]:
    """With as many decimals as a linear axis shows."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    width = max(known, default=0.0) - min(known, default=0.0) or max(map(abs, known), default=0.0) or 1.0
    decimals = math.ceil(math.log10(PARTS / width))
    return [None if value is None else round(value, decimals) for value in values]


def rounded(value: float | None) -> float | None:
    """As many digits as the page needs."""
    return None if value is None else float(f"{value:.{DIGITS}g}")


def _mark(mark: EdgeMark, style: SolverStyle, place: tuple[float, float]) -> dict[str, Any]:
    return {
        "type": "scatter",
        "x": [place[0]],
        "y": [place[1]],
        "meta": {"x": mark.x, "y": mark.y},  # what is known of them, for the data's own file
        "name": mark.entry,
        "mode": "markers",
        "marker": {"symbol": _symbol(mark, style), "size": 11, "color": style.colour, "line": {"width": 2}},
        "text": [f"{mark.status}: {mark.text}"],
        "hovertemplate": "<b>%{fullData.name}</b><br>%{text}<extra></extra>",
        "cliponaxis": False,
    }


def _symbol(mark: EdgeMark, style: SolverStyle) -> str:
    """The solver's own mark, hollow, in its own place; at the edge a mark of its status."""
    if mark.inside:
        return f"{style.symbol}-open"
    return "triangle-down-open" if mark.y == 0 else STATUS_SYMBOLS.get(mark.status, OTHER_SYMBOL)


def _edges(chart: Chart, frame: Frame) -> dict[str, Any]:
    """The strips for marks and the line below which the reference cannot judge, with what stands at them."""
    strip = {"type": "rect", "fillcolor": "#f3f1ec", "line": {"width": 0}, "layer": "below", "yref": "paper", "y1": 1}
    small = {"showarrow": False, "font": {"size": 11, "color": "#5f5b52"}, "xref": "paper", "yanchor": "bottom"}
    shapes, labels = [], []
    if frame.top > frame.y[1]:
        height = (frame.y[1] - frame.y[0]) / (frame.top - frame.y[0])
        shapes.append(strip | {"xref": "paper", "x0": 0, "x1": 1, "y0": height})
        labels.append(small | {"text": chart.edge, "x": 0, "xanchor": "left", "yref": "paper", "y": 1})
    if frame.right > frame.x[1]:
        width = (frame.x[1] - frame.x[0]) / (frame.right - frame.x[0])
        shapes.append(strip | {"xref": "paper", "x0": width, "x1": 1, "y0": 0})
        labels.append(small | {"text": "no result or count", "x": 1, "xanchor": "right", "yref": "paper", "y": 0})
    if chart.limit_matters:
        line = {"color": colours.GUIDE, "width": 1.5, "dash": "dash"}
        shapes.append(
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": chart.limit, "y1": chart.limit, "line": line}
        )
        place = {"x": 0.005, "xanchor": "left", "y": math.log10(chart.limit), "yanchor": "top"}
        labels.append(small | place | {"bgcolor": "rgba(255,255,255,0.8)", "text": "error bar of the reference"})
    return {"shapes": shapes, "annotations": labels}
