"""One chart of the comparison: lines by solver, and marks at the edge for what has no place inside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from hhtbench.report import colours
from hhtbench.report.colours import SolverStyle
from hhtbench.report.figures import MARGIN, axis

HEIGHT = 430  # pixels
BAND = 0.05  # of the axis for each row of marks in the strip beyond the data
LEAST_ROWS = 2  # of the strip, else its marks touch the axis
APART = 0.03  # of the axis: marks nearer to one another stand in different rows
FAR = 1.0  # decades beyond the data: a failed run farther right stands at the edge, or a spent budget flattens all curves
NEAR_LIMIT = 30.0  # the reference's limit is drawn where errors come within this factor of it
MOST_DECADES = 18  # of an axis: beyond, one diverged run would flatten all others
NARROW_DIGITS = 4  # significant digits kept for the page

# What a mark at the edge looks like: the reader tells a spent budget from a refusal without hovering.
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


@dataclass(frozen=True, kw_only=True)
class Trace:
    """The curve of one solver; ``y`` None is a gap."""

    entry: str
    x: tuple[float, ...]
    y: tuple[float | None, ...]
    text: tuple[str, ...] = ()  #: what a pointer shows at each point; empty: a series over time
    note: str = ""  #: what a pointer shows anywhere on a series


@dataclass(frozen=True, kw_only=True)
class EdgeMark:
    """A run without a place inside: ``y`` None stands at the top, ``x`` None at the right, zero at the bottom."""

    entry: str
    status: str
    text: str
    x: float | None = None
    y: float | None = None


@dataclass(frozen=True, kw_only=True)
class Chart:
    """What :func:`draw` needs."""

    id: str
    title: str
    caption: str
    x_label: str
    y_label: str
    traces: tuple[Trace, ...]
    marks: tuple[EdgeMark, ...] = ()
    logarithmic_x: bool = True
    limit: float = 0.0  #: a horizontal line: errors below it cannot be judged


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Limits of the data and of the strips around it; exponents of ten on logarithmic axes."""

    x: tuple[float, float]
    y: tuple[float, float]
    right: float  #: the x axis ends here
    top: float  #: the y axis ends here
    rows: dict[EdgeMark, float]  #: for marks in the upper strip the height within it, 0 to 1


def draw(chart: Chart, styles: dict[str, SolverStyle]) -> go.Figure:
    """The figure; its legend is the page's, which shows and hides a solver on all charts."""
    frame = _frame(chart)
    figure = go.Figure()
    for trace in chart.traces:
        _add_trace(figure, trace, styles[trace.entry])
    order = {entry: index for index, entry in enumerate(styles)}
    for mark in chart.marks:
        _add_mark(figure, mark, styles[mark.entry], _place(chart, frame, mark, order[mark.entry], len(order)))
    x_axis = axis(chart.x_label, [frame.x[0], frame.right], chart.logarithmic_x)
    y_axis = axis(chart.y_label, [frame.y[0], frame.top], True) | {"automargin": True}
    if chart.logarithmic_x:
        _end_ticks(x_axis, frame.x[1], frame.right)
    _end_ticks(y_axis, frame.y[1], frame.top)
    figure.update_layout(
        template="none",
        height=HEIGHT,
        margin={"l": 76, "r": 16, "t": 30, "b": 60},
        font={"family": colours.FONT, "size": 14, "color": colours.TEXT},
        showlegend=False,
        hovermode="closest",
        xaxis=x_axis,
        yaxis=y_axis,
        shapes=_strips(chart, frame),
        annotations=_labels(chart, frame),
    )
    return figure


def _end_ticks(layout: dict[str, Any], end: float, strip: float) -> None:
    """No ticks in the strip: a mark there has no value."""
    step = layout["dtick"]
    if strip > end and isinstance(step, int):
        first = math.ceil(layout["range"][0])
        exponents = range(first, math.floor(end) + 1, step)
        texts = ["1" if n == 0 else f"10<sup>{n}</sup>".replace("-", "\N{MINUS SIGN}") for n in exponents]
        layout |= {"tickmode": "array", "tickvals": [10.0**n for n in exponents], "ticktext": texts}
        layout.pop("minor", None)


def _add_trace(figure: go.Figure, trace: Trace, style: SolverStyle) -> None:
    look: dict[str, Any] = {"name": trace.entry, "line": style.line}
    if trace.text:
        look |= {
            "mode": "lines+markers",
            "marker": {"color": style.colour, "size": 8, "symbol": style.symbol},
            "text": trace.text,
            "hovertemplate": "<b>%{fullData.name}</b><br>%{text}<extra></extra>",
            "x": [_rounded(x) for x in trace.x],
            "y": [_rounded(y) for y in trace.y],
        }
    else:
        look |= {
            "mode": "lines",
            "hovertemplate": f"<b>%{{fullData.name}}</b><br>{trace.note}<br>%{{x:.4g}} s: %{{y:.3g}}<extra></extra>",
            "x": np.asarray(trace.x, dtype=np.float32),  # packed by plotly: half the page
            "y": np.asarray(trace.y, dtype=np.float32),
        }
    figure.add_scatter(**look)


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{NARROW_DIGITS}g}")


def _add_mark(figure: go.Figure, mark: EdgeMark, style: SolverStyle, place: tuple[float, float]) -> None:
    figure.add_scatter(
        x=[place[0]],
        y=[place[1]],
        name=mark.entry,
        mode="markers",
        marker={
            "symbol": "triangle-down-open" if mark.y == 0 else STATUS_SYMBOLS.get(mark.status, OTHER_SYMBOL),
            "size": 11,
            "color": style.colour,
            "line": {"width": 2},
        },
        text=[f"{mark.status}: {mark.text}"],
        hovertemplate="<b>%{fullData.name}</b><br>%{text}<extra></extra>",
        cliponaxis=False,
    )


def _frame(chart: Chart) -> Frame:
    """Room for all data, and a strip at the top and at the right where marks stand there."""
    xs = [x for trace in chart.traces for x in trace.x]
    farthest = max(xs, default=0.0) * 10.0**FAR or float("inf")
    xs += [min(mark.x, farthest) for mark in chart.marks if mark.x is not None]
    ys = [y for trace in chart.traces for y in trace.y if y] + [mark.y for mark in chart.marks if mark.y]
    if _limit_matters(chart):
        ys.append(chart.limit)
    x, y = _limits(xs, chart.logarithmic_x), _limits(ys, True)
    rows = _rows(chart, x)
    strip = BAND * max(LEAST_ROWS, *rows.values()) if rows else 0.0
    heights = {mark: (row - 0.5) / max(LEAST_ROWS, *rows.values()) for mark, row in rows.items()}
    right = x[1] + BAND * LEAST_ROWS * (x[1] - x[0]) if any(mark.x is None for mark in chart.marks) else x[1]
    return Frame(x=x, y=y, right=right, top=y[1] + strip * (y[1] - y[0]), rows=heights)


def _rows(chart: Chart, limits: tuple[float, float]) -> dict[EdgeMark, int]:
    """Rows, from 1, of the marks in the upper strip: none hides another."""
    inside = [(_clamped(chart, mark.x, limits[1]), mark) for mark in chart.marks if mark.y is None and mark.x is not None]
    ends: list[float] = []
    rows = {}
    for x, mark in sorted(inside, key=lambda pair: pair[0]):
        free = (row for row, end in enumerate(ends) if x - end >= APART * (limits[1] - limits[0]))
        row = next(free, len(ends))
        ends[row : row + 1] = [x]
        rows[mark] = row + 1
    return rows


def _clamped(chart: Chart, x: float, end: float) -> float:
    return min(math.log10(x) if chart.logarithmic_x else x, end)


def _limit_matters(chart: Chart) -> bool:
    lowest = min((y for trace in chart.traces for y in trace.y if y), default=float("inf"))
    return chart.limit > 0 and lowest < NEAR_LIMIT * chart.limit


def _limits(values: list[float], logarithmic: bool) -> tuple[float, float]:
    if logarithmic:
        values = [math.log10(value) for value in values if value > 0 and math.isfinite(value)]
    if not values:
        return (0.0, 1.0)
    low, high = min(values), max(values)
    if logarithmic:
        low = max(low, high - MOST_DECADES)
        missing = max(0.0, 1.0 - (high - low)) / 2
        low, high = low - missing, high + missing
    room = MARGIN * (high - low) if logarithmic else 0.0
    return (low - room, high + room)


def _place(chart: Chart, frame: Frame, mark: EdgeMark, index: int, count: int) -> tuple[float, float]:
    """Where a mark stands: its own coordinate where it has one, the strip where not."""
    if mark.x is None:
        x = (frame.x[1] + frame.right) / 2
        y = frame.y[1] - (index + 0.5) / count * (frame.y[1] - frame.y[0])  # one height for each solver
        y = math.log10(mark.y) if mark.y else y
    else:
        x = _clamped(chart, mark.x, frame.x[1])
        y = frame.y[1] + frame.rows[mark] * (frame.top - frame.y[1]) if mark.y is None else frame.y[0]
    return (10.0**x if chart.logarithmic_x else x, 10.0**y)


def _strips(chart: Chart, frame: Frame) -> list[dict[str, Any]]:
    fill = {"type": "rect", "fillcolor": "#f3f1ec", "line": {"width": 0}, "layer": "below"}
    strips = []
    if frame.top > frame.y[1]:
        height = (frame.y[1] - frame.y[0]) / (frame.top - frame.y[0])
        strips.append(fill | {"xref": "paper", "x0": 0, "x1": 1, "yref": "paper", "y0": height, "y1": 1})
    if frame.right > frame.x[1]:
        width = (frame.x[1] - frame.x[0]) / (frame.right - frame.x[0])
        strips.append(fill | {"xref": "paper", "x0": width, "x1": 1, "yref": "paper", "y0": 0, "y1": 1})
    if _limit_matters(chart):
        line = {"color": colours.GUIDE, "width": 1.5, "dash": "dash"}
        strips.append(
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": chart.limit, "y1": chart.limit, "line": line}
        )
    return strips


def _labels(chart: Chart, frame: Frame) -> list[dict[str, Any]]:
    small = {"showarrow": False, "font": {"size": 11, "color": "#5f5b52"}, "xref": "paper"}
    labels = []
    if frame.top > frame.y[1]:
        labels.append(
            small | {"text": "did not finish", "x": 0, "xanchor": "left", "yref": "paper", "y": 1, "yanchor": "bottom"}
        )
    if frame.right > frame.x[1]:
        labels.append(
            small | {"text": "no result", "x": 1, "xanchor": "right", "yref": "paper", "y": 0, "yanchor": "bottom"}
        )
    if _limit_matters(chart):
        place = {"x": 0.005, "xanchor": "left", "y": math.log10(chart.limit), "yanchor": "top"}
        labels.append(small | place | {"bgcolor": "rgba(255,255,255,0.8)", "text": "the reference cannot judge below"})
    return labels
