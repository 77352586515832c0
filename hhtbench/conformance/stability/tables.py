"""What the study found as tables: counts of axis by solver, and every line of an axis as letters."""

from __future__ import annotations

from collections.abc import Mapping

from hhtbench.conformance.entry import Entry, Kind
from hhtbench.conformance.stability.closed_forms import forms_table, matrix_table
from hhtbench.conformance.stability.newton import newton_table
from hhtbench.conformance.stability.study import SAFE, WORDS, Stability, letters
from hhtbench.conformance.stability.workers import cells_of
from hhtbench.report.markdown import escape_text, markdown_table
from hhtbench.report.tables import Cell, Table, make_table

STEP = "HHT's step against closed forms"
TITLE = "Stability at the extremes"
KEY = "; ".join(f"{kind.letter} {kind.text}" for kind in (*WORDS, Kind.declined))
ABOUT = (
    "Each axis drives one parameter to its extremes. A cell is one solve with a budget of time; its answer is judged "
    "by a closed solution, a certified reference or an invariant; only perturbed starts and fitted orders compare "
    "runs of a solver. What is allowed stands beside every line of an axis: under error control mostly a hundred "
    "times the tolerance, for prescribed steps the error of a method of second order, capped where a motion that "
    "stands still or has lost its phase would pass. A solver is safe on an axis where no cell misleads and at least "
    f"{100 * SAFE:g} % are right. Steps on an oscillator are compared with rows of the closed recurrence; the condition "
    "of HHT's Newton matrix is in tests/hht/test_discretise.py, by how much error control lets its steps grow in row M10 of "
    "hhtbench study acceptance, spans of 1e300 s in row S6. "
    "Maps of stability of the closed-loop solvers of game engines are in arXiv 2504.19771 (2025); new here: typed ends, "
    "solvers with error control and prescribed steps through the same cases, and wrong answers that say success apart."
)


def counts(found: Stability) -> Table:
    """A line an axis, a column a solver: right cells of those that it can be asked, and how many are silently wrong."""
    rows: list[list[str | Cell]] = [
        [axis.id, *(_share(found.counts(axis.id, solver)) for solver in found.solvers)] for axis in found.axes
    ]
    note = "Right of all cells that it can be asked; below it those that are silently wrong, crashed or hung."
    return make_table(["axis", *found.solvers], rows, note)


def _share(found: Mapping[Kind, int]) -> Cell:
    asked = sum(count for kind, count in found.items() if kind is not Kind.declined)
    wrong = sum(count for kind, count in found.items() if kind.misleading)
    if not asked:
        return Cell("-")
    tone = "bad" if wrong else "good" if found.get(Kind.right, 0) == asked else ""
    return Cell(f"{found.get(Kind.right, 0)} of {asked}", tone, f"{wrong} wrong" if wrong else "")


def allowed(found: Stability, axis: Entry) -> dict[str, str]:
    """Line of the axis -> what is expected, and the largest errors that count as right, least to most."""
    bounds: dict[str, dict[str, list[float]]] = {}
    for cell in cells_of(axis.id, found.seed):
        for name, known in cell.expected.items():
            bounds.setdefault(cell.line, {}).setdefault(name, []).append(known.most)
    return {
        line: "; ".join(f"{name} {_between(min(most), max(most))}" for name, most in of_line.items())
        for line, of_line in bounds.items()
    }


def _between(low: float, high: float) -> str:
    return f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"


def lines(found: Stability, axis: Entry) -> Table:
    """A line for every solver and every line of the axis: a letter a cell along the parameter, and what is allowed."""
    spelled, bounds = letters(found.of(axis.id)), allowed(found, axis)
    rows = [
        [solver, line, text, bounds.get(line, "")]
        for solver, of_solver in spelled.items()
        for line, text in of_solver.items()
        if set(text) != {Kind.declined.letter}
    ]
    return make_table(["solver", "asked", "along the parameter", "allowed"], rows)


def points(found: Stability, axis: Entry) -> str:
    """The values of the parameter."""
    return ", ".join(f"{x:g}" for x in sorted({x.x for x in found.of(axis.id)}))


def markdown(found: Stability) -> str:
    """The whole as text."""
    parts = [f"# {TITLE}", ABOUT, f"Made by `hhtbench study stability`, seed {found.seed}.", f"Letters: {KEY}."]
    parts += ["## Where each solver is safe"]
    parts += ["\n".join(f"- {escape_text(found.sentence(solver))}" for solver in found.solvers)]
    parts += ["## Right cells", *markdown_table(counts(found))]
    parts += ["## Newton's iterations", *markdown_table(newton_table(found))]
    if found.closed_forms is not None:
        parts += [f"## {STEP}", *markdown_table(matrix_table(found.closed_forms))]
        parts += markdown_table(forms_table(found.closed_forms))
    for axis in found.axes:
        parts += [f"## {axis.id}", escape_text(axis.sentence), f"Parameter: {axis.parameter}; {points(found, axis)}."]
        parts += markdown_table(lines(found, axis))
    made = ", ".join(f"{name} {value}" for name, value in found.environment.items())
    return "\n\n".join([*parts, f"{found.seconds / 60:.0f} minutes; {made}."]) + "\n"
