"""Machine speed as a section of the comparison, from the ``speed.json`` that ``make bench-engine`` writes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from hhtbench.analysis import RACE_TARGETS, Race, problems, race
from hhtbench.errors import ProblemError
from hhtbench.report import colours
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import html_table
from hhtbench.report.figures import axis
from hhtbench.report.speed import SECTIONS
from hhtbench.report.speed_contest import contest_rows, contest_table, everyone_table, shares_table, summary
from hhtbench.report.wording import anchor
from hhtbench.store.rows import RunRow

SOURCE, MADE = "speed.json", "make bench-engine"
AT_EQUAL_ERROR = "At equal error, beside the reference solvers"
ROOM = 0.2  # decades beside the marks
LINE = 22  # pixels of one problem in a figure
CONTEST = (
    "Constrained problems of the library: HHT under error control against IDA on every form, CVODE and SciPy on the "
    "underlying ODE, with and without a projection after each step, and minimal coordinates where they are written down. "
    "Compared is the time to the same achieved error, the largest scaled error of q and v at the times of the reference."
)
SIDES = {  # who is drawn: label, colour, mark
    "subject": ("HHT", colours.FAMILIES["hht"], "circle"),
    "holder": ("fastest other that holds both levels", colours.FAMILIES["ida"], "square"),
    "other": ("fastest other at all", colours.FAMILIES["diffrax"], "diamond-open"),
    "explicit": ("explicit DOP853 on the underlying ODE", colours.FAMILIES["scipy"], "x"),
}


def speed_section(folder: Path, drawings: Drawings) -> str:
    """The section where ``folder`` holds ``speed.json``, "" where not.

    Raises
    ------
    ProblemError
        The file is not what ``make bench-engine`` writes.
    """
    source = folder / SOURCE
    if not source.is_file():
        return ""
    try:
        return _section(json.loads(source.read_text(encoding="utf-8")), drawings)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        fault = f"{type(error).__name__}: {error}"
        raise ProblemError(f"{source} cannot be read ({fault}); make it again with {MADE}, or remove it.") from error


def _section(speed: Mapping[str, Any], drawings: Drawings) -> str:
    rows = contest_rows(speed)
    present = {key: section for key, section in SECTIONS.items() if speed.get(key)}
    absent = [section.title for key, section in SECTIONS.items() if key not in present]
    parts = [
        f'<h3 id="{anchor(f"speed-{key}")}">{escape(section.title)}</h3>\n<p class="lead">{escape(section.text)}</p>\n'
        f"{html_table(section.table(speed[key]))}"
        for key, section in present.items()
    ]
    links = {f"speed-{key}": section.title for key, section in present.items()}
    if rows:
        parts.append(_contest(rows, speed.get("duels") or [], drawings))
        links["speed-contest"] = AT_EQUAL_ERROR
    else:
        absent.append(AT_EQUAL_ERROR)
    contents = "\n".join(f'<a href="#{anchor(key)}">{escape(title)}</a>' for key, title in links.items())
    parts += [f'<p class="note">Not measured in this run: {escape(", ".join(absent))}.</p>'] if absent else []
    created = str(speed.get("created", ""))[:10] or "an unknown date"
    environment = ", ".join(f"{name} {value}" for name, value in speed["environment"].items())
    engine, sections = str(speed["engine"]), "\n".join(parts)
    return f"""\
<h2 id="speed">Machine speed: hand-written C, Exudyn and the reference solvers</h2>
<nav aria-label="Machine speed">{contents}</nav>
<p class="note">Measured by <code>{escape(MADE)}</code> on {escape(created)} with HHT's engine "{escape(engine)}", side by
side in one run, on one core; all numbers in <a href="{SOURCE}">{SOURCE}</a>. {escape(environment)}.</p>
{sections}"""


def _contest(rows: Sequence[RunRow], duels: Sequence[Mapping[str, Any]], drawings: Drawings) -> str:
    lines = race(rows)
    figures = "\n".join(
        _figure([line for line in lines if line.target == target], target, drawings) for target in RACE_TARGETS
    )
    every = "\n".join(
        f"<details><summary>Every solver on {escape(name)}</summary>\n{html_table(everyone_table(rows, name))}</details>"
        for name in problems(rows)
    )
    said = "<br>".join(escape(text) for text in summary(rows, duels))
    return f"""\
<h3 id="{anchor("speed-contest")}">{AT_EQUAL_ERROR}</h3>
<p class="lead">{escape(CONTEST)}<br>{said}</p>
<div class="charts">
{figures}
</div>
{html_table(contest_table(rows, duels))}
<h3>Where the time of the others goes</h3>
{html_table(shares_table(rows))}
{every}"""


def _figure(lines: Sequence[Race], target: float, drawings: Drawings) -> str:
    figure = time_figure(lines)
    return f"""\
<figure id="{anchor(f"speed-time-{target:.0e}")}">
<h3>Time to reach an error of {target:.0e}</h3>
{drawings.box(figure, figure.layout.height)}
<figcaption class="caption">Left is faster. Who has no mark has no time at this error: the tables say why.</figcaption>
</figure>"""


def time_figure(lines: Sequence[Race]) -> go.Figure:
    """One line a problem, one mark a side."""
    figure = go.Figure()
    names = [line.problem for line in lines]
    for side, (label, colour, symbol) in SIDES.items():
        found = [(line.problem, cost) for line in lines if (cost := getattr(line, side)) is not None]
        figure.add_scatter(
            x=[cost.value for _, cost in found],
            y=[name for name, _ in found],
            text=[cost.entry for _, cost in found],
            name=label,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 9},
            hovertemplate="%{y}: %{text}, %{x:.3g} s",
        )
    figure.update_layout(
        template="none",
        height=150 + LINE * len(names),
        margin={"l": 20, "r": 16, "t": 40, "b": 60},
        font={"family": colours.FONT, "size": 13, "color": colours.TEXT},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
        xaxis=axis("processor time of one solve [s]", _decades(lines), logarithmic=True) | {"tickangle": 0},
        yaxis={
            "title": "problem",
            "automargin": True,
            "categoryorder": "array",
            "categoryarray": names[::-1],
            "gridcolor": colours.FINE_GRID,
        },
    )
    return figure


def _decades(lines: Sequence[Race]) -> list[float]:
    """Limits of the axis of times, exponents of ten, with room for the marks."""
    found = [getattr(line, side) for line in lines for side in SIDES]
    times = [math.log10(cost.value) for cost in found if cost is not None]
    return [min(times) - ROOM, max(times) + ROOM] if times else [-3.0, 0.0]
