"""What a chart holds and how much room it takes: limits of the data, strips for marks, places of the marks."""

from __future__ import annotations

import math
from dataclasses import dataclass

MARGIN = 0.06  # of the axis, left free around the data
BAND = 0.05  # share of the axis for each row of marks in the strip beyond the data
LEAST_ROWS = 2  # fewest rows of the strip, else its marks touch the axis
APART = 0.03  # marks nearer than this share of the axis stand in different rows
FAR = 1.0  # decades beyond the data: a failed run farther right stands at the edge, or a spent budget flattens all curves
DOUBTED_ABOVE = 2.0  # decades above the curves: a rejected run that lies higher stands at this height
NEAR_LIMIT = 30.0  # the reference's limit is drawn where errors come within this factor of it
MOST_DECADES = 18  # of an axis: beyond, one diverged run would flatten all others


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
    """A run that is no point of a curve: ``y`` None stands at the top, ``x`` None at the right, zero at the bottom.

    With both, and not zero, it stands in its own place: a run whose result was rejected.
    """

    entry: str
    status: str
    text: str
    x: float | None = None
    y: float | None = None

    @property
    def inside(self) -> bool:
        """Whether it stands in its own place."""
        return self.x is not None and bool(self.y)


@dataclass(frozen=True, kw_only=True)
class Chart:
    """What :func:`~hhtbench.report.chart.draw` needs."""

    id: str
    group: str  #: title of the figure in which it is one of several views
    view: str  #: what it is called there
    title: str
    caption: str
    x_label: str
    y_label: str
    traces: tuple[Trace, ...]
    marks: tuple[EdgeMark, ...] = ()
    logarithmic_x: bool = True
    logarithmic_y: bool = True
    edge: str = "did not finish"  #: what marks in the upper strip have in common
    limit: float = 0.0  #: a horizontal line: errors below it cannot be judged
    front: frozenset[str] = frozenset()  #: solvers that are shown first; empty: all

    @property
    def limit_matters(self) -> bool:
        """Whether errors come near the limit."""
        lowest = min((y for trace in self.traces for y in trace.y if y), default=float("inf"))
        return self.limit > 0 and lowest < NEAR_LIMIT * self.limit


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Limits of the data and of the strips around it; exponents of ten on logarithmic axes."""

    x: tuple[float, float]
    y: tuple[float, float]
    right: float  #: the x axis ends here
    top: float  #: the y axis ends here
    rows: dict[EdgeMark, float]  #: for marks in the upper strip the height within it, 0 to 1


def make_frame(chart: Chart) -> Frame:
    """Room for all data, and a strip at the top and at the right where marks stand there."""
    xs = [x for trace in chart.traces for x in trace.x]
    farthest = max(xs, default=0.0) * 10.0**FAR or float("inf")
    xs += [min(mark.x, farthest) for mark in chart.marks if mark.x is not None]
    ys = [y for trace in chart.traces for y in trace.y if y is not None]
    highest = max(ys, default=0.0) * 10.0**DOUBTED_ABOVE or float("inf")
    ys += [min(mark.y, highest) for mark in chart.marks if mark.y is not None]
    if chart.limit_matters:
        ys.append(chart.limit)
    x = limits(xs, chart.logarithmic_x, MARGIN if chart.logarithmic_x else 0.0)
    y = limits(ys, chart.logarithmic_y, MARGIN)
    rows = _rows(chart, x)
    strip = BAND * max(LEAST_ROWS, *rows.values()) if rows else 0.0
    heights = {mark: (row - 0.5) / max(LEAST_ROWS, *rows.values()) for mark, row in rows.items()}
    right = x[1] + BAND * LEAST_ROWS * (x[1] - x[0]) if any(mark.x is None for mark in chart.marks) else x[1]
    return Frame(x=x, y=y, right=right, top=y[1] + strip * (y[1] - y[0]), rows=heights)


def _rows(chart: Chart, limits: tuple[float, float]) -> dict[EdgeMark, int]:
    """Rows, from 1, of the marks in the upper strip: none hides another."""
    above = [(_axis(mark.x, chart.logarithmic_x), mark) for mark in chart.marks if mark.y is None and mark.x is not None]
    ends: list[float] = []
    rows = {}
    for place, mark in sorted(above, key=lambda pair: pair[0]):
        x = min(place, limits[1])
        free = (row for row, end in enumerate(ends) if x - end >= APART * (limits[1] - limits[0]))
        row = next(free, len(ends))
        ends[row : row + 1] = [x]
        rows[mark] = row + 1
    return rows


def limits(values: list[float], logarithmic: bool, margin: float) -> tuple[float, float]:
    """Least and largest of the values with room; their exponents of ten on a logarithmic axis."""
    if logarithmic:
        values = [math.log10(value) for value in values if value > 0 and math.isfinite(value)]
    if not values:
        return (0.0, 1.0)
    low, high = min(values), max(values)
    if logarithmic:
        low = max(low, high - MOST_DECADES)
        missing = max(0.0, 1.0 - (high - low)) / 2
        low, high = low - missing, high + missing
    room = margin * (high - low or abs(high) or 1.0)
    return (low - room, high + room)


def place_of(chart: Chart, frame: Frame, mark: EdgeMark, index: int, count: int) -> tuple[float, float]:
    """Where a mark stands: its own coordinate where it has one, the strip where not."""
    if mark.x is None:
        x = (frame.x[1] + frame.right) / 2
        y = frame.y[1] - (index + 0.5) / count * (frame.y[1] - frame.y[0])  # one height for each solver
        y = _axis(mark.y, chart.logarithmic_y) if mark.y else y
    else:
        x = min(_axis(mark.x, chart.logarithmic_x), frame.x[1])
        if mark.y is None:
            y = frame.y[1] + frame.rows[mark] * (frame.top - frame.y[1])
        else:
            y = min(_axis(mark.y, chart.logarithmic_y), frame.y[1]) if mark.y else frame.y[0]
    return (_value(x, chart.logarithmic_x), _value(y, chart.logarithmic_y))


def _axis(value: float, logarithmic: bool) -> float:
    return math.log10(value) if logarithmic else value


def _value(place: float, logarithmic: bool) -> float:
    return 10.0**place if logarithmic else place
