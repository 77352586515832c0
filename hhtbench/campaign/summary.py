"""Summaries of a campaign's rows as text and as plain values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hhtbench.campaign.analysis.outcomes import Failure, failures
from hhtbench.campaign.campaign import Done
from hhtbench.campaign.public import Runs
from hhtbench.campaign.store import RunRow
from hhtbench.solution.result import Status

MOST_SHOWN = 12  # kinds of failures on the terminal; the store holds all
ANY = "any"  # status that is neither success, event nor declined


def failure_lines(rows: Iterable[RunRow]) -> list[str]:
    """Return one line for each of the first ``MOST_SHOWN`` reasons of failure, and the number of further ones."""
    lines = list(map(_line, failures(rows)))
    return lines[:MOST_SHOWN] + ([f"... and {len(lines) - MOST_SHOWN} more lines"] if len(lines) > MOST_SHOWN else [])


def _line(failure: Failure) -> str:
    problems = _one_of(list(dict.fromkeys(row.problem for row in failure.rows)))
    solvers = _one_of(list(dict.fromkeys(row.solver for row in failure.rows)))
    cells = _asked(failure.rows[0].request) if len(failure.rows) == 1 else f"{len(failure.rows)} cells"
    return f"{failure.status:>14}  {problems}  {solvers}  {cells}: {failure.text}"


def failure_facts(rows: Iterable[RunRow]) -> list[dict[str, Any]]:
    """Return all reasons of failure with their cells as plain values, for JSON."""
    return [
        {"status": one.status, "message": one.message, "cells": [_cell(row) | {"message": row.message} for row in one.rows]}
        for one in failures(rows)
    ]


def _cell(row: RunRow) -> dict[str, Any]:
    return {"problem": row.problem, "solver": row.solver, **row.request}


def ended(rows: Iterable[RunRow]) -> str:
    """Return the numbers of rows by status as text, "12 success, 3 deadline"."""
    return ", ".join(f"{count} {status}" for status, count in Counter(row.status for row in rows).most_common())


def is_failure(row: RunRow, fail_on: tuple[str, ...]) -> bool:
    """True if a row ended with one of the statuses ``fail_on``; ``ANY``: neither well nor declined."""
    return row.status in fail_on or (ANY in fail_on and not row.success and row.status != Status.declined.label)


def text_of(done: Done, file: Path) -> str:
    """Summarise a campaign as text: failures, contradictions, number of cells by status, the store's file."""
    contradicted = [
        f"{row.problem}  {row.solver}  {_asked(row.request)}: came out otherwise a second time; the first row stays"
        for row in done.contradictions
    ]
    work = f"{done.ran} run now, {done.timed} timed now"
    summary = f"{done.cells} cells: {ended(done.rows)} ({work}); rows in {file}"
    return "\n".join([*failure_lines(done.rows), *contradicted, summary])


def facts_of(done: Done, file: Path, repairs: Sequence[str]) -> dict[str, Any]:
    """Summarise a campaign as plain values, with the numbers of every cell."""
    return {
        "store": str(file),
        "repairs": list(repairs),
        "cells": done.cells,
        "run": done.ran,
        "timed": done.timed,
        "ended": Counter(row.status for row in done.rows),
        "contradictions": [_cell(row) for row in done.contradictions],
        "rows": Runs(done.rows).table(),
    }


def _one_of(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def _asked(request: dict[str, Any]) -> str:
    return ", ".join(f"{name}={request[name]:g}" for name in ("rtol", "step", "steps") if request[name] is not None)
