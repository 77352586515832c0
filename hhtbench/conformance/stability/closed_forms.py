"""HHT's step on an oscillator against its closed forms: matrix over alpha and w h, radius, damping, period, overshoot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.studies.acceptance import method
from hhtbench.studies.acceptance.asked import ASKED
from hhtbench.studies.acceptance.method import EVERY_ALPHA, FREQUENCIES, MATRIX, step_errors
from hhtbench.studies.acceptance.rows import Outcome, Row, Verdict, rows_of

SOLVER = "hht"
FORMS = ("M2", "M4", "M5")  # rows of the acceptance matrix about radius, damping and period, overshoot


@dataclass(frozen=True, kw_only=True)
class ClosedForms:
    """What was measured."""

    errors: Mapping[tuple[float, float], float]  #: by alpha and w h, of trace, sum of principal minors and determinant
    outcomes: Mapping[Row, Outcome]  #: of the other forms

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        errors = [{"alpha": alpha, "w h": o, "error": error} for (alpha, o), error in self.errors.items()]
        forms = [{"id": x.id, "measured": x.measured, "verdict": x.verdict.value} for x in self.outcomes.values()]
        return {"matrix": errors, "forms": forms}


def measure_closed_forms() -> ClosedForms:
    """Of the compiled loop; a second."""
    asked = next(x for x in ASKED if x.name == SOLVER)
    rows = [row for row in rows_of(method) if row.id in FORMS]
    return ClosedForms(errors=step_errors(asked), outcomes={row: row.outcome(asked) for row in rows})


def matrix_table(found: ClosedForms) -> Table:
    """A line an alpha, a column a frequency."""
    lines: list[list[str | Cell]]
    lines = [[f"{alpha:.4g}", *(_judged(found.errors[alpha, o]) for o in FREQUENCIES)] for alpha in EVERY_ALPHA]
    note = (
        "By how much trace, sum of the principal minors and determinant of one step on y'' = -w^2 y - 2 zeta w y' are "
        f"off their closed forms, the largest for zeta = 0 and 0.05; at most {MATRIX:g} is allowed."
    )
    return make_table(["alpha", *(f"w h = {o:g}" for o in FREQUENCIES)], lines, note)


def forms_table(found: ClosedForms) -> Table:
    """A line each of the other forms."""
    lines: list[list[str | Cell]]
    lines = [[row.goes_in, row.expected, _verdict(outcome)] for row, outcome in found.outcomes.items()]
    return make_table(["what", "expected", "measured"], lines)


def _judged(error: float) -> Cell:
    return Cell(f"{error:.1e}", "good" if error <= MATRIX else "bad")


def _verdict(outcome: Outcome) -> Cell:
    return Cell(outcome.measured, "good" if outcome.verdict is Verdict.holds else "bad")
