"""The two figures of the first screen: drift against cost at equal accuracy, and profiles."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import SUBJECT, TYPICAL_ERROR, family
from hhtbench.campaign.analysis.drift import DriftCost
from hhtbench.campaign.analysis.fronts import BOUNDS
from hhtbench.campaign.analysis.profile import Profile, Reach
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report import colours
from hhtbench.report.chart import axis, layout_of, rounded
from hhtbench.report.colours import SolverStyle
from hhtbench.report.frame import limits
from hhtbench.report.series import LEAST_DRIFT
from hhtbench.report.words import plural, short, weighed

Styles = Mapping[str, SolverStyle]
Views = dict[str, tuple[dict[str, Any], str]]  # views of one figure: name -> drawing, caption
ROOM = 0.08  # free room at the ends of an axis, over its length
SIZE, LETTER, MARK = (400.0, 200.0), (6.5, 14.0), 8.0  # px: of the figure at its smallest beside another, of texts, of marks
BESIDE = {"top center": (0, 1), "bottom center": (0, -1), "middle right": (1, 0), "middle left": (-1, 0)}


def drift_views(rows: Sequence[RunRow], styles: Styles) -> Views:
    """Drift against cost over HHT's, by time and by evaluations; none where HHT reaches the error on no problem."""
    views = {}
    for measure in ("time", "evaluations"):
        found = analysis.drift_costs(rows, measure)
        drawn = {entry: own for entry, lines in found.items() if (own := [line for line in lines if not line.bound])}
        if drawn:
            caption = _drift_caption(_count(drawn)) + _left_out(found)
            views[measure] = (_drift_figure(drawn, measure, styles), caption)
    return views


def _drift_caption(count: int) -> str:
    return (
        f"Left and low is better. On each of {plural(count, 'problem')} with constraints: the cost at an error of "
        f"{TYPICAL_ERROR:.0e} over that of HHT's cheapest entry, and the largest drift. Large marks are medians; the "
        "number of problems stands behind the name where it is not all. Lines are the bounds of the drift. Zero is drawn at "
        f"{LEAST_DRIFT:.0e}."
    )


def _count(found: Mapping[str, Sequence[DriftCost]]) -> int:
    return len({line.problem for lines in found.values() for line in lines})


def _left_out(found: Mapping[str, Sequence[DriftCost]]) -> str:
    """Where a cost at the error is not known, since the cheapest run is more accurate."""
    bounds = Counter({entry: sum(line.bound for line in lines) for entry, lines in found.items()})
    parts = [f"{short(entry)} on {number}" for entry, number in bounds.items() if number]
    return f" Left out, because the cheapest run or HHT's is more accurate than asked: {'; '.join(parts)}." if parts else ""


def _drift_figure(found: Mapping[str, Sequence[DriftCost]], measure: str, styles: Styles) -> dict[str, Any]:
    medians = {entry: _median(lines) for entry, lines in found.items()}
    most = _count(found)
    everything = [line for lines in found.values() for line in lines]
    x = _limits(line.ratio for line in everything)
    y = _limits(max(line.drift, LEAST_DRIFT) for line in everything)
    names = {entry: short(entry) + f", {len(own)} of {most}" * (len(own) < most) for entry, own in found.items()}
    places = _label_places({entry: names[entry] for entry in _named(medians)}, medians, (x, y))
    own = [entry for entry in styles if entry in found]
    data = [_single(entry, found[entry], styles[entry]) for entry in own]
    for entry in own:
        meaning = f"median of {len(found[entry])} of {plural(most, 'problem')}"
        data.append(_middle(entry, medians[entry], (names[entry], meaning), styles[entry], places.get(entry)))
    what = "processor time" if measure == "time" else "evaluations"
    layout = layout_of(axis(f"{what} over HHT's", x, True), axis("largest drift, scaled", y, True) | {"automargin": True})
    layout["shapes"] = [_line(y0=bound) for bound in BOUNDS if bound is not None] + [_line(x0=1.0)]
    return {"data": data, "layout": layout}


def _median(lines: Sequence[DriftCost]) -> tuple[float, float]:
    return median(line.ratio for line in lines), max(median(line.drift for line in lines), LEAST_DRIFT)


def _named(medians: Mapping[str, tuple[float, float]]) -> list[str]:
    """HHT's cheapest and those whom no other beats in both, cheapest first: names of all would hide one another."""

    def beaten(place: tuple[float, float]) -> bool:
        return any(x <= place[0] and y <= place[1] and (x, y) != place for x, y in medians.values())

    own = sorted((entry for entry in medians if family(entry) == SUBJECT), key=lambda entry: medians[entry])
    best = (entry for entry, place in medians.items() if not beaten(place))
    return list(dict.fromkeys([*own[:1], *sorted(best, key=lambda entry: medians[entry])]))


def _label_places(
    names: Mapping[str, str], medians: Mapping[str, tuple[float, float]], limits: tuple[list[float], list[float]]
) -> dict[str, str]:
    """On which side of their marks ``names`` hide no other and stay in the figure; one that fits nowhere is left out."""
    places, boxes = dict[str, str](), list[tuple[float, float, float, float]]()
    for entry, name in names.items():
        x, y = (
            (math.log10(value) - low) / (high - low) * size
            for value, (low, high), size in zip(medians[entry], limits, SIZE, strict=True)
        )
        width, height = len(name) * LETTER[0], LETTER[1]
        for side, (right, up) in BESIDE.items():
            left, bottom = x - width / 2 + right * (width / 2 + MARK), y - height / 2 + up * (height / 2 + MARK)
            box = left, bottom, left + width, bottom + height
            inside = box[0] >= 0 and box[1] >= 0 and box[2] <= SIZE[0] and box[3] <= SIZE[1]
            if inside and not any(_overlap(box, other) for other in boxes):
                places[entry] = side
                boxes.append(box)
                break
    return places


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether two boxes, left, bottom, right and top each, have a point in common."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _single(entry: str, lines: Sequence[DriftCost], style: SolverStyle) -> dict[str, Any]:
    places = [(line.ratio, max(line.drift, LEAST_DRIFT)) for line in lines]
    texts = [f"{line.problem}, {line.cost.run.setting.text}" for line in lines]
    return _points(entry, places, texts, style, {"size": 5, "opacity": 0.4})


def _middle(
    entry: str, place: tuple[float, float], texts: tuple[str, str], style: SolverStyle, label: str | None
) -> dict[str, Any]:
    """A median; ``texts``: its name and of what it is one."""
    drawn = _points(entry, [place], [texts[1]], style, {"size": 13, "line": {"width": 1, "color": "#ffffff"}})
    drawn |= {"customdata": [texts[1]], "text": [texts[0]], "textposition": label or "top center", "textfont": {"size": 12}}
    hover = drawn["hovertemplate"].replace("%{text}", "%{customdata}")
    return drawn | {"mode": "markers+text" if label else "markers", "hovertemplate": hover}


def _points(
    entry: str, places: Sequence[tuple[float, float]], texts: Sequence[str], style: SolverStyle, look: dict[str, Any]
) -> dict[str, Any]:
    return {
        "type": "scatter",
        "name": entry,
        "mode": "markers",
        "x": [rounded(x) for x, _ in places],
        "y": [rounded(y) for _, y in places],
        "text": list(texts),
        "hovertemplate": "<b>%{fullData.name}</b><br>%{text}<br>%{x:.3g} times HHT's, drift %{y:.2g}<extra></extra>",
        "marker": {"color": style.colour, "symbol": style.symbol} | look,
    }


def _line(x0: float | None = None, y0: float | None = None) -> dict[str, Any]:
    """Across the whole figure, at one value of one axis."""
    look = {"type": "line", "layer": "below", "line": {"color": colours.GUIDE, "width": 1, "dash": "dot"}}
    if x0 is None:
        return look | {"xref": "paper", "x0": 0, "x1": 1, "y0": y0, "y1": y0}
    return look | {"yref": "paper", "y0": 0, "y1": 1, "x0": x0, "x1": x0}


def profile_views(rows: Sequence[RunRow], styles: Styles, front: Iterable[str]) -> Views:
    """Shares of problem-error pairs within a cost, by time and by evaluations."""
    shown_first = [entry for entry in styles if entry in set(front)]
    by_time, by_count = (analysis.reaches(rows, measure) for measure in ("time", "evaluations"))
    views = {}
    for name, found, label in (("time", by_time, "processor time [s]"), ("evaluations", by_count, "evaluations")):
        if any(reach.cost is not None for reach in found):
            figure = _profile_figure(analysis.profiles(found), label, styles, shown_first)
            what = "" if name == "time" else f" {weighed(analysis.points(rows))}"
            views[name] = (figure, _pairs(found) + what)
    return views


def _pairs(found: Sequence[Reach]) -> str:
    targets = sorted({reach.target for reach in found}, reverse=True)
    problems = plural(len({reach.problem for reach in found}), "problem")
    return (
        f"Left and high is better. Share of all pairs of {problems}, each of the same weight, and errors {targets[0]:.0e} "
        f"to {targets[-1]:.0e} that a solver reaches within a cost: that of its loosest run that does."
    )


def _profile_figure(found: Sequence[Profile], label: str, styles: Styles, front: Sequence[str]) -> dict[str, Any]:
    x = _limits(cost for profile in found for cost in profile.cost)
    known = {profile.entry: profile for profile in found}
    data = [_staircase(known[entry], styles[entry], 10.0 ** x[1]) for entry in styles if entry in known]
    y_axis = axis("share reached", [0.0, 1.02], False) | {"tickformat": ".0%"}
    return {"data": data, "layout": layout_of(axis(label, x, True), y_axis), "front": list(front)}


def _staircase(profile: Profile, style: SolverStyle, end: float) -> dict[str, Any]:
    """From the first cost to the right edge."""
    share = [0.0, *profile.share]
    cost = [*profile.cost[:1], *profile.cost, end] if profile.cost else [end]
    return {
        "type": "scatter",
        "name": profile.entry,
        "mode": "lines",
        "x": [rounded(value) for value in cost],
        "y": [rounded(value) for value in [*share, share[-1]][: len(cost)]],
        "line": style.line | {"shape": "hv"},
        "hovertemplate": "<b>%{fullData.name}</b><br>%{y:.0%} within %{x:.3g}<extra></extra>",
    }


def _limits(values: Iterable[float]) -> list[float]:
    return list(limits(list(values), True, ROOM))
