"""Group failures by reason, list machines, and keep the newest of rows of the same cell."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.campaign.analysis.cells import DOUBTED, by_entry, point
from hhtbench.campaign.store.rows import RunRow

ASKED = ("rtol", "atol", "step", "steps")  # what makes two requests the same point of a curve
# Alone: no part of RK45; no exit code.
NUMBER = re.compile(r"(?<!exit code )(?<![\w.])[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\w])")


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Failed or rejected runs with one reason: one status, and messages that differ in numbers at most."""

    status: str
    message: str  #: message of the first run
    rows: tuple[RunRow, ...]

    @property
    def text(self) -> str:
        """The first message, marked if the others have other numbers."""
        same = all(row.message == self.message for row in self.rows)
        return self.message if same else f"{self.message} (the first; numbers differ)"

    @property
    def reached(self) -> float | None:
        """Largest fraction of the interval reached; None for runs whose result was rejected."""
        known = [] if self.status == DOUBTED else [point(row).reached for row in self.rows]
        return max((value for value in known if value is not None), default=None)


def silent(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Return the solvers that have successful runs but report no evaluations."""
    groups = by_entry(point(row) for row in rows if row.success)
    return tuple(entry for entry, runs in groups.items() if all(run.evaluations is None for run in runs))


def failures(rows: Iterable[RunRow]) -> tuple[Failure, ...]:
    """Group all runs that failed or were rejected by reason; declined ones come last."""
    groups: dict[tuple[str, str], list[RunRow]] = {}
    for row in rows:
        if not row.success:
            groups.setdefault((row.status, NUMBER.sub("#", row.message)), []).append(row)
    found = [Failure(status=status, message=own[0].message, rows=tuple(own)) for (status, _), own in groups.items()]
    return tuple(sorted(found, key=lambda failure: failure.status == "declined"))


def statuses(rows: Iterable[RunRow]) -> dict[str, int]:
    """Count the rows by status, most frequent first."""
    return dict(Counter(row.status for row in rows).most_common())


def machines(rows: Sequence[RunRow]) -> list[tuple[Mapping[str, Any], int]]:
    """Return the environments that occur with their numbers of rows, most rows first."""
    kept = {str(sorted(row.environment.items())): row.environment for row in rows}
    counted = Counter(str(sorted(row.environment.items())) for row in rows)
    return [(kept[text], count) for text, count in counted.most_common()]


@dataclass(frozen=True, kw_only=True)
class Newest:
    """Rows to report, and numbers of those left out."""

    rows: tuple[RunRow, ...]
    left_out: int  #: older rows of cells that exist more than once
    cells: int  #: how many cells those are
    versions: int  #: most versions of one cell; a version is a key, the hash of specs, request, sources and libraries


def newest(rows: Iterable[RunRow]) -> Newest:
    """Select the newest row of each (problem, solver, request), in the order of first appearance."""
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
