"""The small cells of every axis as checks of a solver."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hhtbench.testing.extremes.cell import Cell, Kind, measure
from hhtbench.testing.extremes.table import AXES
from hhtbench.testing.subject import Declined, Subject, expect


def extreme_checks() -> list[tuple[str, str, Callable[[Subject], None]]]:
    """Name, sentence and measurement of each: "stiffness/h = 0.01 s/1e+12"."""
    return [
        (f"{axis.name}/{cell.line}/{cell.x:g}", axis.sentence, partial(_holds, cell))
        for axis in AXES
        for cell in axis.cells()
        if cell.small
    ]


def _holds(cell: Cell, subject: Subject) -> None:
    """It arrives within the expected error, or ends early, out of its budget too, and says so."""
    if not cell.is_about(subject.spec):
        raise Declined(f"it is about {' and '.join(cell.families)}.")
    found = measure(cell, subject.spec)
    if found.kind is Kind.declined:
        raise Declined(found.message)
    errors = ", ".join(f"{name} off by {error:.2g}" for name, error in found.errors.items())
    allowed = "; ".join(f"{known.most:.2g} of {name}" for name, known in cell.expected.items())
    told = f"success, but {errors}; allowed are {allowed}" if found.kind is Kind.wrong else found.message
    expect(not found.kind.misleading, told)
