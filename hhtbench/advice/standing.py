"""Who is still worth a run: what each candidate has cost so far beside the cheapest, at the same error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.advice.criteria import Criteria
from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import Front
from hhtbench.campaign.analysis.missing import UNKNOWN
from hhtbench.campaign.store import RunRow

SEVERAL = 4.0  # times the cheapest: from there on a candidate is dropped; a single time beside other work is good to twice
OPEN = ("capped", *UNKNOWN)  #: reasons after which more time may help


@dataclass(frozen=True)
class Standing:
    """The candidates after some runs; every candidate that was run has its place in every front."""

    fronts: tuple[Front, ...]  #: one an accuracy, the loosest first

    @classmethod
    def of(cls, rows: Sequence[RunRow], criteria: Criteria) -> Standing:
        """From the rows of one problem."""
        return cls(analysis.fronts(rows, criteria.on, criteria.accuracies, criteria.drift) if rows else ())

    def hopeless(self, entry: str) -> str:
        """Why ``entry`` cannot win at any of the errors, or ""."""
        reasons = [_behind(front, entry) for front in self.fronts]
        return reasons[-1] if reasons and all(reasons) else ""

    def unfinished(self, entry: str) -> bool:
        """Whether more time could show more of ``entry``: a cap keeps it from an error that it is not too dear for."""
        return not self.fronts or any(
            entry in front.missing and front.missing[entry].kind in OPEN and not _behind(front, entry)
            for front in self.fronts
        )

    def best(self) -> float | None:
        """Cost at the tightest error that a candidate has reached."""
        return next((front.costs[0].value for front in reversed(self.fronts) if front.costs), None)


def _behind(front: Front, entry: str) -> str:
    """Why ``entry`` is out at this error, or "": it has ended without reaching it, or is several times too dear."""
    best, missing = front.costs[0].value if front.costs else math.inf, front.missing.get(entry)
    if missing is not None and missing.kind not in OPEN:
        return missing.text
    if missing is None:
        cost, least = next((cost.value for cost in front.costs if cost.entry == entry), None), ""
    else:
        cost, least = None if missing.kind in UNKNOWN else missing.bound, "at least "
    if cost is None or cost <= SEVERAL * best:
        return ""
    return f"costs {least}{cost / best:.2g} times the cheapest at {front.target:g}"
