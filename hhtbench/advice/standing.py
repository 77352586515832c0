"""Decide which candidates are worth another run, from their costs so far beside the cheapest at the same error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.advice.criteria import Criteria
from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import Front
from hhtbench.campaign.analysis.missing import UNKNOWN
from hhtbench.campaign.store import RunRow

SEVERAL = 4.0  # a candidate above this ratio to the cheapest is dropped; a time beside other work is good to a factor 2
OPEN = ("capped", *UNKNOWN)  #: reasons after which more time may help


@dataclass(frozen=True)
class CostsSoFar:
    """Costs of the candidates after some runs, one front per accuracy."""

    fronts: tuple[Front, ...]  #: one an accuracy, the loosest first

    @classmethod
    def of(cls, rows: Sequence[RunRow], criteria: Criteria) -> CostsSoFar:
        """Compute the fronts from the rows of one problem."""
        return cls(analysis.fronts(rows, criteria.on, criteria.accuracies, criteria.drift) if rows else ())

    def hopeless(self, entry: str) -> str:
        """Return why ``entry`` cannot be the cheapest at any of the errors, or ""."""
        reasons = [_behind(front, entry) for front in self.fronts]
        return reasons[-1] if reasons and all(reasons) else ""

    def unfinished(self, entry: str) -> bool:
        """True if more time could help ``entry``: only a cap keeps it from an error at which it is not too expensive."""
        return not self.fronts or any(
            entry in front.missing and front.missing[entry].kind in OPEN and not _behind(front, entry)
            for front in self.fronts
        )

    def best(self) -> float | None:
        """Return the lowest cost at the tightest error reached; None if none is reached."""
        return next((front.costs[0].value for front in reversed(self.fronts) if front.costs), None)


def _behind(front: Front, entry: str) -> str:
    """Return why ``entry`` is out at this error: it ended without reaching it, or costs several times the cheapest; else
    "".
    """
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
