"""``stability.html``: sentences, counts, and a map of every axis with solver and request against the parameter."""

from __future__ import annotations

import math
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from hhtbench.conformance.entry import Entry, Kind, Outcome
from hhtbench.conformance.stability.study import SAFE, Stability
from hhtbench.conformance.stability.workers import cells_of
from hhtbench.protocol.errors import ProblemError
from hhtbench.report import COMPARISON, STABILITY, colours
from hhtbench.report.elements import html_table
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor

ABOUT = (
    "An axis is one parameter that is driven to its extremes. A cell is one solve with a budget of time. Its answer is "
    "judged by a closed solution, a certified reference or an invariant; only perturbed starts and fitted orders compare "
    "runs of a solver. The error that counts as right stands at each axis: under error control mostly a hundred times the "
    "tolerance, for prescribed steps the error of a method of second order. "
    f"A solver is safe on an axis where no cell is wrong with a success and at least {100 * SAFE:g} % are right. "
    "Tests named by rows M1 to M5 and M10 of the acceptance matrix hold the matrix of HHT's step, row S6 spans of 1e300 s. "
    "Maps of stability of the solvers of game engines are in arXiv 2504.19771 (2025)."
)
PALEST = 0.35
COLOURS = {  # distinct for colour-blind eyes; the letter of each kind tells it without colours
    Kind.right: "#009E73",
    Kind.named: "#56B4E9",
    Kind.budget: "#E69F00",
    Kind.warned: "#CC79A7",
    Kind.wrong: "#B3261E",
    Kind.crashed: "#000000",
    Kind.hung: "#777777",
}


def write_stability(found: Stability, folder: Path) -> Path:
    """Write the page into ``folder`` (made if missing), linked with the comparison if that is there.

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
    """Return the HTML of the page; ``compared``: the comparison is in the same folder."""
    report = files("hhtbench.report")
    style = Template(report.joinpath("comparison.css").read_text(encoding="utf-8"))
    template = Template(files("hhtbench.conformance.stability").joinpath("stability.html").read_text(encoding="utf-8"))
    return template.substitute(
        style=style.substitute(font=colours.FONT, text=colours.TEXT, height=0),
        comparison=f'<a href="{COMPARISON}">the comparison</a>' if compared else "",
        contents="\n".join(f'<a href="#{anchor(axis.id)}">{escape(axis.id)}</a>' for axis in found.axes),
        about=escape(ABOUT),
        classes="\n".join(
            f'<li><b class="cell" style="background:{colour}">{kind.letter}</b> {kind.label}: {escape(kind.text)}</li>'
            for kind, colour in COLOURS.items()
        ),
        sentences="\n".join(f"<p>{escape(found.sentence(solver))}</p>" for solver in found.solvers),
        counts=html_table(counts(found)),
        sections="\n".join(_section(found, axis) for axis in found.axes),
        seed=str(found.seed),
        minutes=f"{found.seconds / 60:.0f}",
        environment=escape(", ".join(f"{name} {value}" for name, value in found.environment.items())),
        script=report.joinpath("tables.js").read_text(encoding="utf-8"),
    )


def counts(found: Stability) -> Table:
    """Return the table of right cells per axis and solver, with the number of silently wrong ones."""
    rows: list[list[str | Cell]] = [
        [Cell(axis.id, detail=axis.sentence), *(_share(found.of(axis.id, solver)) for solver in found.solvers)]
        for axis in found.axes
    ]
    note = "Right cells of those that a solver can be asked, and how many are wrong with a success, crashed or hung."
    return make_table(["axis", *found.solvers], rows, note)


def _share(asked: list[Outcome]) -> Cell:
    right, wrong = (sum(x.kind is Kind.right for x in asked), sum(x.kind.misleading for x in asked))
    if not asked:
        return Cell("-")
    tone = "bad" if wrong else "good" if right == len(asked) else ""
    return Cell(f"{right} of {len(asked)}", tone, f"{wrong} wrong" if wrong else "")


def allowed(found: Stability, axis: Entry) -> dict[str, str]:
    """Map each line of the axis to what is expected and the smallest and largest allowed errors."""
    bounds: dict[str, dict[str, list[float]]] = {}
    for cell in cells_of(axis.id, found.seed):
        for name, known in cell.expected.items():
            bounds.setdefault(cell.line, {}).setdefault(name, []).append(known.most)
    return {
        line: "; ".join(f"{name} {' to '.join(dict.fromkeys((f'{min(x):.2g}', f'{max(x):.2g}')))}" for name, x in of.items())
        for line, of in bounds.items()
    }


def _section(found: Stability, axis: Entry) -> str:
    allowances = "\n".join(f"<li>{escape(line)}: {escape(most)}</li>" for line, most in allowed(found, axis).items())
    return f"""\
<section>
<h2 id="{anchor(axis.id)}">{escape(axis.id)}</h2>
<p class="lead">{escape(axis.sentence)}</p>
<ul>
{allowances}
</ul>
{axis_map(found.of(axis.id), axis.parameter)}
</section>"""


def axis_map(asked: list[Outcome], label: str) -> str:
    """Return the HTML map of an axis: one row per solver and request, one column per value, a coloured letter per cell."""
    columns = sorted({x.x for x in asked if x.x is not None})
    letters: dict[str, dict[float | None, str]] = {}
    for x in asked:
        line = letters.setdefault(f"{x.solver}, {x.line}", dict.fromkeys(columns, ""))
        line[x.x] += _letter(x)
    head = "".join(f"<th>{x:g}</th>" for x in columns)
    rows = (f"<tr><td>{escape(name)}</td><td>{'</td><td>'.join(line.values())}</td></tr>" for name, line in letters.items())
    body = "\n".join(rows)
    return f'<div class="scroll"><table><thead><tr><th>{escape(label)}</th>{head}</tr></thead>\n{body}</table></div>'


def _letter(x: Outcome) -> str:
    shown = f"opacity:{_opacity(x):.2g};background:{COLOURS[x.kind]}"
    return f'<b class="cell" style="{shown}" title="{_figures(x)}">{x.kind.letter}</b>'


def _opacity(x: Outcome) -> float:
    """Opacity of a right cell: full up to a hundredth of the allowed error, pale at all of it."""
    if x.kind is not Kind.right or not x.share:
        return 1.0
    return PALEST + (1.0 - PALEST) * min(max(-math.log10(x.share), 0.0), 2.0) / 2.0


def _figures(x: Outcome) -> str:
    """Text of a cell's tooltip."""
    parts = [f"{name} off by {error:.1e}" for name, error in x.errors.items()]
    parts += [f"{x.share:.2g} of what is allowed"] if x.share is not None else [f"{x.status}: {x.message[:160]}"]
    parts += [] if x.steps is None else [f"{x.steps} steps"]
    parts += [] if x.evaluations is None else [f"{x.evaluations} evaluations"]
    return escape("\n".join([x.kind.label, *parts, f"{x.seconds:.2g} s"]))
