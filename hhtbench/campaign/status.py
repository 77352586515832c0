"""Report what a store holds and what of a campaign is left to run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hhtbench.campaign.campaign import stands, untimed
from hhtbench.campaign.machine import clock_of
from hhtbench.campaign.plan import Campaign, Cell, Pair, plan_pairs
from hhtbench.campaign.references import references_there
from hhtbench.campaign.store import Reading, RunRow, read_store
from hhtbench.campaign.summary import ended, failure_facts, failure_lines

MADE_WITH = ("python", "hhtbench", "commit")  # entries of a row's environment that are reported beside the machine
MACHINE = "{processor}, {cores} cores, {memory_GiB} GiB, {system}; Python {python}, hhtbench {hhtbench} ({commit})"


@dataclass(frozen=True, kw_only=True)
class Left:
    """Work of a campaign that is not done yet.

    A pair of problem and solver that is refined asks for its next cell only after the last one, so the number of cells
    still to come is not known.
    """

    campaign: str
    pairs: int  #: number of pairs of problem and solver
    finished: int  #: number of pairs that ask for nothing more
    done: int  #: cells that the store holds
    next: int  #: cells that would be run at once
    untimed: int  #: successes that are there and have no times of this machine
    other: int  #: rows of the store that the campaign does not ask for: of others, or of files that have changed since

    def __str__(self) -> str:
        lines = [f"campaign {self.campaign}: cells done {self.done}, pairs finished {self.finished} of {self.pairs}"]
        if self.finished < self.pairs:
            lines.append(f"  left: cells to run now {self.next}, and those that their pairs ask for after them")
        lines += [f"  left: successes to time on this machine {self.untimed}"] if self.untimed else []
        lines += [f"  rows not of this campaign, or of files that have changed since: {self.other}"] if self.other else []
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class StoreStatus:
    """Content of a store as :func:`status_of` reports it."""

    file: Path
    reading: Reading
    left: Left | None  #: None where no campaign is named

    @property
    def rows(self) -> tuple[RunRow, ...]:
        """Rows that can be read."""
        return tuple(row for _, row in self.reading.sound)

    @property
    def span(self) -> tuple[str, str] | None:
        """Dates (UTC) of the first and the last row; None if there is none."""
        times = sorted(row.created for row in self.rows)
        return (times[0], times[-1]) if times else None

    @property
    def machines(self) -> list[dict[str, Any]]:
        """Machines and versions that made the rows, with the number of rows, in the order of first appearance."""
        found: list[dict[str, Any]] = []
        for row in self.rows:
            facts = clock_of(row.environment) | {key: row.environment.get(key) for key in MADE_WITH}
            same = next((machine for machine in found if machine["facts"] == facts), None)
            if same is None:
                found.append(same := {"facts": facts, "rows": 0})
            same["rows"] += 1
        return found

    def __str__(self) -> str:
        counted = f"{len(self.rows)} cells: {ended(self.rows)}" if self.rows else "no cells"
        lines = [f"{self.file}: {counted}", *failure_lines(self.rows)]
        lines += [f"made from {self.span[0]} to {self.span[1]}"] if self.span else []
        lines += [f"rows: {one['rows']}, by {MACHINE.format(**one['facts'])}" for one in self.machines]
        return "\n".join([*lines, *([] if self.left is None else [str(self.left)])])

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "schema": "hhtbench.status/1",
            "store": str(self.file),
            "cells": len(self.rows),
            "ended": Counter(row.status for row in self.rows),
            "failures": failure_facts(self.rows),
            "first": self.span[0] if self.span else None,
            "last": self.span[1] if self.span else None,
            "machines": self.machines,
            "damaged": list(self.reading.damaged),
            "fault": self.reading.fault,
            "left": None if self.left is None else asdict(self.left),
        }


def status_of(file: Path, name: str = "", campaign: Campaign | None = None) -> StoreStatus:
    """Report what the store ``file`` holds and, with a campaign called ``name``, what is left to run.  Nothing is run or
    written.

    Raises
    ------
    ProblemError
        There is no such file, or it is no store.
    """
    reading = read_store(file)
    left = None
    if campaign is not None:
        pairs = plan_pairs(campaign, references_there(campaign, file))
        left = _left(name, pairs, {row.key: row for _, row in reading.sound})
    return StoreStatus(file=file, reading=reading, left=left)


def _left(name: str, pairs: tuple[Pair, ...], rows: Mapping[str, RunRow]) -> Left:
    looked = [_asked(pair, rows) for pair in pairs]
    done = {cell.key for there, _ in looked for cell in there}
    return Left(
        campaign=name,
        pairs=len(pairs),
        finished=sum(not missing for _, missing in looked),
        done=len(done),
        next=sum(len(missing) for _, missing in looked),
        untimed=sum(untimed(rows[key]) for key in done),
        other=len(rows.keys() - {cell.key for cells in looked for some in cells for cell in some}),
    )


def _asked(pair: Pair, rows: Mapping[str, RunRow]) -> tuple[list[Cell], list[Cell]]:
    """Return the cells of a pair that the store holds, and those that it would run next."""
    there: list[Cell] = []
    while cells := pair.next_cells([rows[cell.key] for cell in there]):
        missing = [cell for cell in cells if cell.key not in rows or not stands(rows[cell.key], cell)]
        there += [cell for cell in cells if cell not in missing]
        if missing:
            return there, missing
    return there, []
