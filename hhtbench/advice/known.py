"""What rows of a problem itself tell of one wish: who gets there, who has failed, and what of them cannot be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hhtbench.advice.database import foreign, versions_of
from hhtbench.advice.standing import Standing
from hhtbench.advice.verdict import as_run
from hhtbench.advice.wish import Wish
from hhtbench.analysis.fronts import Front
from hhtbench.analysis.missing import UNKNOWN
from hhtbench.analysis.outcomes import newest
from hhtbench.campaign.machine import clock_of
from hhtbench.campaign.plan import outdated
from hhtbench.store import RunRow, load_rows


@dataclass(frozen=True, kw_only=True)
class Known:
    """The rows of one problem, judged by one wish."""

    problem: str  #: canonical spec
    fronts: tuple[Front, ...]  #: one an accuracy, the loosest first; none without rows
    on: str  #: what the fronts compare
    refusal: str  #: why it is not time, where time was asked for, or ""
    failed: Mapping[str, str]  #: entry -> why it does not get there
    text: str  #: the evidence, for a reader

    @classmethod
    def of(cls, problem: str, store: Path, wish: Wish) -> Known:
        """Rows of ``store`` that today's files and libraries would make again."""
        rows = [row for row in load_rows(store) if row.problem == problem]
        stale = {row.key for row in outdated(rows)}
        kept = [row for row in rows if row.key not in stale]
        found = cls.from_rows(problem, kept, wish, f"{len(kept)} runs in {store.name}")
        left_out = f"; {len(stale)} of other sources or libraries left out" if stale else ""
        return replace(found, text=f"{found.text}{left_out}")

    @classmethod
    def from_rows(cls, problem: str, rows: Sequence[RunRow], wish: Wish, text: str) -> Known:
        """Times are left aside where they were taken elsewhere; ``text`` says what the rows are."""
        refusal = _foreign(rows) if wish.on == "time" else ""
        wish = replace(wish, on="evaluations") if refusal else wish
        fronts = as_run(Standing.of(newest(rows).rows, wish).fronts)
        failed = {entry: why.text for front in fronts for entry, why in front.missing.items() if why.kind not in UNKNOWN}
        if fronts and not any(front.costs for front in fronts):
            text += " do not get there" + "".join(f"; {entry}: {why}" for entry, why in failed.items())
        return cls(problem=problem, fronts=fronts, on=wish.on, refusal=refusal, failed=failed, text=text)


def _foreign(rows: Sequence[RunRow]) -> str:
    """Why the times of these rows say nothing here, or ""."""
    found = [
        foreign(row.timing.get("machine", clock_of(row.environment)), versions_of(row.environment))
        for row in rows
        if row.success
    ]
    others = [why for why in found if why]
    return f"{len(others)} of {len(found)} runs are of {others[0]}" if others else ""
