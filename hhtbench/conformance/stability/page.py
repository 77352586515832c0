"""``stability.html``: sentences, counts, and a map of every axis: solver and request against the parameter."""

from __future__ import annotations

import math
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import plotly.graph_objects as go

from hhtbench.conformance.entry import Entry, Kind, Outcome
from hhtbench.conformance.stability.study import SAFE, Stability
from hhtbench.conformance.stability.workers import cells_of
from hhtbench.protocol.errors import ProblemError
from hhtbench.report import COMPARISON, STABILITY, colours
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import html_table
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor

ABOUT = (
    "Each axis drives one parameter to its extremes. A cell is one solve with a budget of time; its answer is judged "
    "by a closed solution, a certified reference or an invariant; only perturbed starts and fitted orders compare "
    "runs of a solver. What is allowed stands beside every line of an axis: under error control mostly a hundred "
    "times the tolerance, for prescribed steps the error of a method of second order, capped where a motion that "
    "stands still or has lost its phase would pass. A solver is safe on an axis where no cell misleads and at least "
    f"{100 * SAFE:g} % are right. Steps on an oscillator are compared with rows of the closed recurrence; the matrix of "
    "HHT's step, its radius, damping and overshoot are rows M1 to M5 of hhtbench study acceptance, by how much error "
    "control lets its steps grow is row M10, spans of 1e300 s are row S6. "
    "Maps of stability of the closed-loop solvers of game engines are in arXiv 2504.19771 (2025); new here: typed ends, "
    "solvers with error control and prescribed steps through the same cases, and wrong answers that say success apart."
)
LINE = 17  # pixels of one line of a map
PALEST = 0.35
MARKS = {  # colour and mark of a class: distinct for colour-blind eyes, and without colours
    Kind.right: ("#009E73", "square"),
    Kind.named: ("#56B4E9", "diamond"),
    Kind.budget: ("#E69F00", "triangle-up"),
    Kind.warned: ("#CC79A7", "circle"),
    Kind.wrong: ("#B3261E", "x"),
    Kind.crashed: ("#000000", "star"),
    Kind.hung: ("#777777", "hourglass"),
}


def write_stability(found: Stability, folder: Path) -> Path:
    """Write the page into ``folder``, made if missing; the comparison links it, and is linked if it is there.

    Raises
    ------
    ProblemError
        The folder cannot be made or written.
    """
    file = folder / STABILITY
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file.write_text(stability_page(found, compared=(folder / COMPARISON).is_file()), encoding="utf-8")
    except OSError as error:
        raise ProblemError(f"{file} cannot be written: {error.strerror}.") from error
    return file


def stability_page(found: Stability, compared: bool = False) -> str:
    """The text of the page; ``compared``: the comparison lies beside it."""
    drawings, report = Drawings(), files("hhtbench.report")
    style = Template(report.joinpath("comparison.css").read_text(encoding="utf-8"))
    template = Template(files("hhtbench.conformance.stability").joinpath("stability.html").read_text(encoding="utf-8"))
    return template.substitute(
        style=style.substitute(font=colours.FONT, text=colours.TEXT, height=LINE),
        comparison=f'<a href="{COMPARISON}">the comparison</a>' if compared else "",
        contents="\n".join(f'<a href="#{anchor(axis.id)}">{escape(axis.id)}</a>' for axis in found.axes),
        about=escape(ABOUT),
        classes="\n".join(f"<li><b>{kind.label}</b>: {escape(kind.text)}</li>" for kind in MARKS),
        sentences="\n".join(f"<p>{escape(found.sentence(solver))}</p>" for solver in found.solvers),
        counts=html_table(counts(found)),
        sections="\n".join(_section(found, axis, drawings) for axis in found.axes),
        seed=str(found.seed),
        minutes=f"{found.seconds / 60:.0f}",
        environment=escape(", ".join(f"{name} {value}" for name, value in found.environment.items())),
        scripts=drawings.scripts(report.joinpath("draw_all.js").read_text(encoding="utf-8")),
    )


def counts(found: Stability) -> Table:
    """A line an axis, a column a solver: right cells of those that it can be asked, and how many are silently wrong."""
    rows: list[list[str | Cell]] = [
        [axis.id, *(_share(found.of(axis.id, solver)) for solver in found.solvers)] for axis in found.axes
    ]
    note = "Right of all cells that it can be asked; below it those that are silently wrong, crashed or hung."
    return make_table(["axis", *found.solvers], rows, note)


def _share(asked: list[Outcome]) -> Cell:
    right, wrong = (sum(x.kind is Kind.right for x in asked), sum(x.kind.misleading for x in asked))
    if not asked:
        return Cell("-")
    tone = "bad" if wrong else "good" if right == len(asked) else ""
    return Cell(f"{right} of {len(asked)}", tone, f"{wrong} wrong" if wrong else "")


def allowed(found: Stability, axis: Entry) -> dict[str, str]:
    """Line of the axis -> what is expected, and the largest errors that count as right, least to most."""
    bounds: dict[str, dict[str, list[float]]] = {}
    for cell in cells_of(axis.id, found.seed):
        for name, known in cell.expected.items():
            bounds.setdefault(cell.line, {}).setdefault(name, []).append(known.most)
    return {
        line: "; ".join(f"{name} {' to '.join(dict.fromkeys((f'{min(x):.2g}', f'{max(x):.2g}')))}" for name, x in of.items())
        for line, of in bounds.items()
    }


def _section(found: Stability, axis: Entry, drawings: Drawings) -> str:
    drawn = axis_map(found.of(axis.id), axis.parameter)
    allowances = "\n".join(f"<li>{escape(line)}: {escape(most)}</li>" for line, most in allowed(found, axis).items())
    return f"""\
<section>
<h2 id="{anchor(axis.id)}">{escape(axis.id)}</h2>
<p class="lead">{escape(axis.sentence)}</p>
<ul>
{allowances}
</ul>
{drawings.box(drawn, drawn.layout.height)}
</section>"""


def axis_map(asked: list[Outcome], label: str) -> go.Figure:
    """A line for every solver and request, a column for every value of the parameter, a mark for the class of the end."""
    rows = list(dict.fromkeys(_name(x) for x in asked))
    columns = [f"{x:g}" for x in sorted({x.x for x in asked if x.x is not None})]
    figure = go.Figure()
    for kind, (colour, symbol) in MARKS.items():
        own = [x for x in asked if x.kind is kind]
        figure.add_scatter(
            x=[f"{x.x:g}" for x in own],
            y=[_name(x) for x in own],
            text=[_figures(x) for x in own],
            name=kind.label,
            mode="markers",
            marker={"color": colour, "symbol": symbol, "size": 11, "opacity": [_opacity(x) for x in own]},
            hovertemplate="%{y}<br>%{x}: %{text}",
        )
    figure.update_layout(
        template="none",
        height=130 + LINE * max(1, len(rows)),
        margin={"l": 20, "r": 16, "t": 36, "b": 60},
        font={"family": colours.FONT, "size": 12, "color": colours.TEXT},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
        showlegend=True,
        hovermode="closest",
        xaxis=_categories(columns) | {"title": {"text": label}},
        yaxis=_categories(rows[::-1]) | {"automargin": True, "gridcolor": colours.FINE_GRID},
    )
    return figure


def _opacity(x: Outcome) -> float:
    """Of a right cell: full from a hundredth of the allowed error on, pale at all of it."""
    if x.kind is not Kind.right or not x.share:
        return 1.0
    return PALEST + (1.0 - PALEST) * min(max(-math.log10(x.share), 0.0), 2.0) / 2.0


def _categories(names: list[str]) -> dict[str, object]:
    return {"type": "category", "categoryorder": "array", "categoryarray": names, "range": [-0.7, len(names) - 0.3]}


def _name(x: Outcome) -> str:
    return escape(f"{x.solver}, {x.line}")


def _figures(x: Outcome) -> str:
    """What a pointer shows."""
    parts = [f"{name} off by {error:.1e}" for name, error in x.errors.items()]
    parts += [f"{x.share:.2g} of what is allowed"] if x.share is not None else [escape(f"{x.status}: {x.message[:160]}")]
    parts += [] if x.steps is None else [f"{x.steps} steps"]
    parts += [] if x.evaluations is None else [f"{x.evaluations} evaluations"]
    return "<br>".join([*parts, f"{x.seconds:.2g} s"])
