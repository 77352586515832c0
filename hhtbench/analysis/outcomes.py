"""What was counted, what failed and why, on which machine."""

from __future__ import annotations

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


@dataclass(frozen=True, kw_only=True)
class CounterRow:
    """Work of one run; a counter that was not reported is None, never zero."""

    point: Point
    counts: Mapping[str, float | None]
    provenance: str


@dataclass(frozen=True, kw_only=True)
class FailureRow:
    """Runs of one solver on one problem that ended in the same way."""

    problem: str
    entry: str
    status: str
    message: str
    settings: tuple[str, ...]  #: of the runs, loosest first as they came
    keys: tuple[str, ...]
    reached: float | None  #: largest fraction of the interval; None for runs that are not believed


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


def failures(rows: Iterable[RunRow]) -> tuple[FailureRow, ...]:
    """Every run that failed or is not believed, runs with the same outcome in one line."""
    groups: dict[tuple[str, str, str, str], list[tuple[Point, float | None]]] = {}
    for row in rows:
        if not row.success:
            run = point(row)
            own = groups.setdefault((run.problem, run.entry, run.status, run.message), [])
            own.append((run, None if row.status == DOUBTED else number(row.metrics, "reached")))
    return tuple(
        FailureRow(
            problem=problem,
            entry=entry,
            status=status,
            message=message,
            settings=tuple(run.setting.text for run, _ in runs),
            keys=tuple(run.key for run, _ in runs),
            reached=max((reached for _, reached in runs if reached is not None), default=None),
        )
        for (problem, entry, status, message), runs in groups.items()
    )


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
