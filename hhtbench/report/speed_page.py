"""``speed.html``: machine speed, from the ``speed.json`` that ``make bench-engine`` writes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
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

PAGE, SOURCE = "speed.html", "speed.json"
TITLE = "Machine speed: hand-written C, Exudyn and the reference solvers"
MADE = "make bench-engine"
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


def write_speed(folder: Path, command: str) -> bool:
    """Write the page where ``folder`` holds ``speed.json``, remove it where not; whether there is one.

    Raises
    ------
    ProblemError
        The file is not what ``make bench-engine`` writes.
    """
    source = folder / SOURCE
    if not source.is_file():
        (folder / PAGE).unlink(missing_ok=True)
        return False
    try:
        text = speed_page(json.loads(source.read_text(encoding="utf-8")), command)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        fault = f"{type(error).__name__}: {error}"
        raise ProblemError(f"{source} cannot be read ({fault}); make it again with {MADE}, or remove it.") from error
    (folder / PAGE).write_text(text, encoding="utf-8")
    return True


def speed_page(speed: Mapping[str, Any], command: str) -> str:
    """The text of the page."""
    rows, drawings = contest_rows(speed), Drawings()
    present = {key: section for key, section in SECTIONS.items() if speed.get(key)}
    absent = [section.title for key, section in SECTIONS.items() if key not in present]
    parts = [
        f'<h2 id="{key}">{escape(section.title)}</h2>\n<p class="lead">{escape(section.text)}</p>\n'
        f"{html_table(section.table(speed[key]))}"
        for key, section in present.items()
    ]
    links = [f'<a href="#{key}">{escape(section.title)}</a>' for key, section in present.items()]
    if rows:
        parts.append(_contest(rows, speed.get("duels") or [], drawings))
        links.append('<a href="#contest">At equal error, beside the reference solvers</a>')
    else:
        absent.append("At equal error, beside the reference solvers")
    parts += [f'<p class="note">Not measured in this run: {escape(", ".join(absent))}.</p>'] if absent else []
    texts = {name: files("hhtbench.report").joinpath(name).read_text(encoding="utf-8") for name in PARTS}
    return Template(texts["speed.html"]).substitute(
        title=escape(TITLE),
        style=Template(texts["comparison.css"]).substitute(font=colours.FONT, text=colours.TEXT, height=LINE),
        contents="\n".join(links),
        engine=escape(str(speed["engine"])),
        sections="\n".join(parts),
        command=escape(command),
        made=escape(MADE),
        created=escape(str(speed.get("created", ""))[:10] or "an unknown date"),
        environment=escape(", ".join(f"{name} {value}" for name, value in speed["environment"].items())),
        scripts=drawings.scripts(texts["draw_all.js"]),
    )


PARTS = ("speed.html", "comparison.css", "draw_all.js")


def _contest(rows: Sequence[RunRow], duels: Sequence[Mapping[str, Any]], drawings: Drawings) -> str:
    lines = race(rows)
    figures = "\n".join(
        _figure([line for line in lines if line.target == target], target, drawings) for target in RACE_TARGETS
    )
    every = "\n".join(
        f'<details id="{anchor(name)}"><summary>Every solver on {escape(name)}</summary>\n'
        f"{html_table(everyone_table(rows, name))}</details>"
        for name in problems(rows)
    )
    said = "<br>".join(escape(text) for text in summary(rows, duels))
    return f"""\
<h2 id="contest">At equal error, beside the reference solvers</h2>
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
<figure id="time-{target:.0e}">
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
        paper_bgcolor=colours.GROUND,
        plot_bgcolor=colours.GROUND,
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
