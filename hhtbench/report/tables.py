"""Tables as text, for pages and for Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from hhtbench.report.colours import solver_order


class Cell(NamedTuple):
    """Text of one cell; where it is a verdict its colour, good or bad; a second line in small print; a link."""

    text: str
    tone: str = ""
    detail: str = ""
    link: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Headers and rows of text."""

    headers: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Headers, of which several may read alike, and the texts of every row."""
        rows = [[" ".join(filter(None, (cell.text, cell.detail))) for cell in row] for row in self.rows]
        return {"headers": list(self.headers), "rows": rows}


def make_table(headers: Sequence[str], rows: Iterable[Sequence[str | Cell]], note: str = "") -> Table:
    """A table of strings and cells."""
    cells = tuple(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in rows)
    return Table(headers=tuple(headers), rows=cells, note=note)


def ordered(body: list[list[str | Cell]]) -> list[list[str | Cell]]:
    """Lines that begin with a solver, in the one order of solvers."""
    order = {entry: index for index, entry in enumerate(solver_order(str(line[0]) for line in body))}
    return sorted(body, key=lambda line: order[str(line[0])])
