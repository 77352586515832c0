"""Drift against cost at equal accuracy: on each problem what a solver pays beside HHT, and how far it drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.analysis.cells import SUBJECT, TYPICAL_ERROR, family
from hhtbench.analysis.fronts import Cost, fronts
from hhtbench.store.rows import RunRow


@dataclass(frozen=True, kw_only=True)
class DriftCost:
    """One solver on one problem, at one error."""

    problem: str
    cost: Cost
    own: Cost  #: of HHT's cheapest entry
    drift: float  #: the larger of position and velocity, scaled, of the run at the accurate end

    @property
    def ratio(self) -> float:
        """Its cost over that of HHT's cheapest entry."""
        return self.cost.value / self.own.value

    @property
    def bound(self) -> bool:
        """Whether either cost is only an upper bound, so that the ratio is none of costs at this error."""
        return self.cost.bound or self.own.bound


def drift_costs(rows: Sequence[RunRow], measure: str, target: float = TYPICAL_ERROR) -> dict[str, tuple[DriftCost, ...]]:
    """Entry -> one for each problem with constraints where both it and HHT reach ``target``."""
    found: dict[str, list[DriftCost]] = {}
    for front in fronts(rows, measure, (target,)):
        own = next((cost for cost in front.costs if family(cost.entry) == SUBJECT), None)
        if own is None:
            continue
        for cost in front.costs:
            levels = [value for value in (cost.run.position, cost.run.velocity) if value is not None]
            if levels:
                line = DriftCost(problem=front.problem, cost=cost, own=own, drift=max(levels))
                found.setdefault(cost.entry, []).append(line)
    return {entry: tuple(lines) for entry, lines in found.items()}
