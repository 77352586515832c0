"""The next cell of a pair, from its rows alone."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench.analysis.cells import points
from hhtbench.analysis.ladder import End, next_setting
from hhtbench.campaign.plan import Cell, Pair
from hhtbench.store.rows import RunRow

__all__ = ["End", "next_cells", "next_request"]


def next_request(rows: Sequence[RunRow], pair: Pair) -> Cell | End:
    """What to run after ``rows``, the pair's own so far, or why nothing more is run.

    Nothing else is looked at: a resumed campaign that holds the rows asks for nothing, and the report calls the same
    function (:mod:`hhtbench.analysis.ladder`) to say why an error was not reached.
    """
    found = next_setting(points(rows), pair.rules, pair.kind)
    if isinstance(found, End):
        return found
    asked = {"rtol": found.value} if pair.kind == "rtol" else {"steps": round(1.0 / found.value)}
    return pair.cell(asked, found.seconds)


def next_cells(pair: Pair, rows: Sequence[RunRow]) -> Sequence[Cell]:
    """The cells to run after ``rows``; none where there is nothing more to run."""
    if not pair.kind:
        return () if rows else pair.cells()
    found = next_request(rows, pair)
    return () if isinstance(found, End) else (found,)
