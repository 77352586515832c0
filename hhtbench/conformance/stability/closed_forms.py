"""HHT's step on an oscillator against its closed forms: matrix over alpha and w h, radius, damping, period, overshoot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hhtbench.conformance.entry import Entry, Kind, Outcome, entries_of
from hhtbench.conformance.rows import method
from hhtbench.conformance.rows.method import EVERY_ALPHA, FREQUENCIES, MATRIX, step_errors
from hhtbench.conformance.subject import Subject
from hhtbench.report.tables import Cell, Table, make_table

SOLVER = "hht"
FORMS = ("M2", "M4", "M5")  # rows of the acceptance matrix about radius, damping and period, overshoot


@dataclass(frozen=True, kw_only=True)
class ClosedForms:
    """What was measured."""

    errors: Mapping[tuple[float, float], float]  #: by alpha and w h, of trace, sum of principal minors and determinant
    outcomes: tuple[tuple[Entry, Outcome], ...]  #: of the other forms

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        errors = [{"alpha": alpha, "w h": o, "error": error} for (alpha, o), error in self.errors.items()]
        forms = [{"id": x.id, "measured": x.message, "verdict": x.kind.label} for _, x in self.outcomes]
        return {"matrix": errors, "forms": forms}


def measure_closed_forms() -> ClosedForms:
    """Of the compiled loop; a second."""
    subject = Subject.column(SOLVER)
    forms = tuple((row, row.run(subject)) for row in entries_of(method) if row.id in FORMS)
    return ClosedForms(errors=step_errors(subject), outcomes=forms)


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
    lines = [[row.goes_in, row.sentence, _verdict(outcome)] for row, outcome in found.outcomes]
    return make_table(["what", "expected", "measured"], lines)


def _judged(error: float) -> Cell:
    return Cell(f"{error:.1e}", "good" if error <= MATRIX else "bad")


def _verdict(outcome: Outcome) -> Cell:
    return Cell(outcome.message, "good" if outcome.kind is Kind.right else "bad")
