"""Sentences and tables of one comparison, for the page, the summary and JSON alike: every table is made once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import Campaign, campaign_of
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.campaign.analysis.outcomes import machines
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report import contest, runs
from hhtbench.report.atlas import Atlas, failure_atlas
from hhtbench.report.decisions import choices_of, decisions, reading
from hhtbench.report.recommendations import recommendations
from hhtbench.report.rules import rules
from hhtbench.report.summary import older, summary
from hhtbench.report.tables import Table
from hhtbench.report.words import MEASURES, bounded

AGAINST = "HHT and the cheapest other solver"
RANKED: dict[str, Callable[[Sequence[RunRow], Campaign], Table]] = {
    AGAINST: contest.against,
    "The cheapest solvers at each error": contest.cheapest,
}
TITLE = "Accuracy, work and drift: extended HHT-alpha and other solvers"
ATLAS = "Failed runs by solver and cause"
FAILED = "Failed runs by reason"
TABLES: dict[str, Callable[[Sequence[RunRow]], Table]] = {
    "One run of each solver at similar accuracy": runs.one_run_each,
    FAILED: runs.failures_by_reason,
}


@dataclass(frozen=True, kw_only=True)
class Part:
    """All about one problem but its charts."""

    name: str
    rows: tuple[RunRow, ...]
    tables: Mapping[str, Table]  #: by caption


@dataclass(frozen=True, kw_only=True)
class Content:
    """Of one campaign."""

    rows: tuple[RunRow, ...]  #: that are reported
    losses: str  #: what could not be read, "" where all could
    sentences: tuple[str, ...]
    rules: tuple[str, ...]
    targets: tuple[float, ...]  #: errors that were asked for
    kinds: Mapping[Kind, tuple[str, ...]]  #: the problems of each
    recommendations: tuple[str, ...]  #: what to take, in sentences
    held_out: frozenset[str]  #: problems that played no part in the choice of defaults
    decisions: Mapping[tuple[str, float | None], Table]  #: by measure and bound of the drift
    reading: str  #: how they are to be read
    balance: Table
    against: Mapping[Kind, Table]
    atlas: Atlas
    parts: tuple[Part, ...]

    def as_dict(self) -> dict[str, Any]:
        """As plain values: tables as {headers, rows}."""
        return {
            "rows": len(self.rows),
            "losses": self.losses,
            "summary": list(self.sentences),
            "rules": list(self.rules),
            "reading": self.reading,
            "recommendations": list(self.recommendations),
            "decisions": {
                f"{MEASURES[by]}, {bounded(held)}": table.as_dict() for (by, held), table in self.decisions.items()
            },
            "against": {kind.text: table.as_dict() for kind, table in self.against.items()},
            "balance": self.balance.as_dict(),
            "atlas": self.atlas.as_dict(),
            "problems": {
                part.name: {"tables": {caption: table.as_dict() for caption, table in part.tables.items()}}
                for part in self.parts
            },
        }


def content_of(rows: Sequence[RunRow], losses: str = "") -> Content:
    """Of all rows of a store, older versions of a cell among them."""
    found = analysis.newest(rows)
    whole, kinds = campaign_of(found.rows), analysis.kinds(found.rows)
    choices = choices_of(found.rows, kinds, whole)
    held_out = frozenset(run.problem for run in analysis.points(found.rows) if run.held_out)
    return Content(
        rows=found.rows,
        losses=losses,
        sentences=(*summary(found.rows), *older(found)),
        rules=tuple(rules(found.rows)),
        targets=whole.targets,
        reading=reading(whole),
        kinds=kinds,
        recommendations=recommendations(choices, whole.level, held_out),
        held_out=held_out,
        decisions=decisions(choices, whole, held_out),
        balance=contest.balance(found.rows),
        against={kind: contest.against(_of(found.rows, names), whole) for kind, names in kinds.items()},
        atlas=failure_atlas(found.rows),
        parts=tuple(_part(name, _of(found.rows, [name]), whole) for name in analysis.problems(found.rows)),
    )


def _of(rows: Sequence[RunRow], problems: Collection[str]) -> list[RunRow]:
    return [row for row in rows if row.problem in problems]


def _part(name: str, rows: Sequence[RunRow], whole: Campaign) -> Part:
    tables = {caption: rank(rows, whole) for caption, rank in RANKED.items()}
    tables |= {caption: build(rows) for caption, build in TABLES.items()}
    return Part(name=name, rows=tuple(rows), tables=tables)


def environments(rows: Sequence[RunRow]) -> list[str]:
    """Machine and versions: a line for each environment that the rows came from, the commonest first."""
    found = machines(rows)
    lines = [{**({"rows": count} if len(found) > 1 else {}), **environment} for environment, count in found]
    return [", ".join(f"{name} {value}" for name, value in line.items()) for line in lines] or ["Not recorded."]


def period(rows: Sequence[RunRow]) -> str:
    """When the rows were made."""
    dates = sorted(row.created[:10] for row in rows if row.created)
    if not dates:
        return "an unknown date"
    return dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
