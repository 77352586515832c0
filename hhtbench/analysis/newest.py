"""One row a cell: a store that was resumed may hold a cell twice, from older sources."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hhtbench.store.rows import RunRow

ASKED = ("rtol", "atol", "step", "steps")  # what makes two requests the same point of a curve


@dataclass(frozen=True, kw_only=True)
class Newest:
    """The rows to report, and what was left out."""

    rows: tuple[RunRow, ...]
    left_out: int  #: older rows of cells that exist more than once
    cells: int  #: how many cells those are
    versions: int  #: most versions of one cell; a version is a key, the hash of specs, request, sources and libraries


def newest(rows: Iterable[RunRow]) -> Newest:
    """Of each (problem, solver, request) the row made last, in the order of first appearance."""
    groups: dict[tuple[str, ...], list[RunRow]] = {}
    for row in rows:
        groups.setdefault((row.problem, row.solver, *(str(row.request.get(name)) for name in ASKED)), []).append(row)
    again = [group for group in groups.values() if len(group) > 1]
    return Newest(
        rows=tuple(max(enumerate(group), key=lambda pair: (pair[1].created, pair[0]))[1] for group in groups.values()),
        left_out=sum(len(group) - 1 for group in again),
        cells=len(again),
        versions=max((len({row.key for row in group}) for group in again), default=1),
    )
