"""What was counted, what failed and why, on which machine."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hhtbench.analysis.cells import DOUBTED, Point, by_entry, number, point
from hhtbench.store.rows import RunRow

COUNTED = (
    "steps_accepted",
    "steps_rejected_error",
    "steps_rejected_newton",
    "newton_iterations",
    "residual_evaluations",
    "output_evaluations",
    "jacobian_evaluations",
    "factorisations",
    "linear_solves",
)


NUMBER = re.compile(
    r"(?<!exit code )(?<![\w.])[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\w])"
)  # alone: no part of RK45; no exit code


@dataclass(frozen=True, kw_only=True)
class CounterRow:
    """Work of one run; a counter that was not reported is None, never zero."""

    point: Point
    counts: Mapping[str, float | None]
    provenance: str


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Runs that failed or are not believed for one reason: of one status, and messages that differ by numbers at most."""

    status: str
    message: str  #: of the first
    rows: tuple[RunRow, ...]

    @property
    def text(self) -> str:
        """The message; said where those of the others have other numbers."""
        same = all(row.message == self.message for row in self.rows)
        return self.message if same else f"{self.message} (the first; numbers differ)"

    @property
    def reached(self) -> float | None:
        """Largest fraction of the interval; None for runs that are not believed."""
        known = [] if self.status == DOUBTED else [number(row.metrics, "reached") for row in self.rows]
        return max((value for value in known if value is not None), default=None)


@dataclass(frozen=True, kw_only=True)
class Machine:
    """One environment and how many rows were made in it."""

    environment: Mapping[str, Any]
    rows: int


def counters(rows: Iterable[RunRow]) -> tuple[CounterRow, ...]:
    """One line a row, in their order."""
    return tuple(
        CounterRow(
            point=point(row),
            counts={name: number(row.counters, name) for name in COUNTED},
            provenance=str(row.counters.get("provenance") or "not reported"),
        )
        for row in rows
    )


def silent(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Solvers that have successful runs and report the evaluations of none."""
    groups = by_entry(point(row) for row in rows if row.success)
    return tuple(entry for entry, runs in groups.items() if all(run.evaluations is None for run in runs))


def failures(rows: Iterable[RunRow]) -> tuple[Failure, ...]:
    """Every run that failed or is not believed, by reason; what was declined comes last."""
    groups: dict[tuple[str, str], list[RunRow]] = {}
    for row in rows:
        if not row.success:
            groups.setdefault((row.status, NUMBER.sub("#", row.message)), []).append(row)
    found = [Failure(status=status, message=own[0].message, rows=tuple(own)) for (status, _), own in groups.items()]
    return tuple(sorted(found, key=lambda failure: failure.status == "declined"))


def statuses(rows: Iterable[RunRow]) -> dict[str, int]:
    """How many rows ended with each status, most frequent first."""
    return dict(Counter(row.status for row in rows).most_common())


def machines(rows: Iterable[RunRow]) -> tuple[Machine, ...]:
    """The environments that occur, most rows first."""
    found: list[tuple[Mapping[str, Any], int]] = []
    for row in rows:
        for index, (environment, count) in enumerate(found):
            if environment == row.environment:
                found[index] = (environment, count + 1)
                break
        else:
            found.append((row.environment, 1))
    ordered = sorted(found, key=lambda pair: -pair[1])
    return tuple(Machine(environment=environment, rows=count) for environment, count in ordered)
