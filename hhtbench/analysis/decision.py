"""Whom to take: solvers in order on all problems of a kind, at one error and one bound of the drift.

The order of two solvers follows from their own rows alone: a third that comes or goes does not change it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hhtbench.analysis.cells import SUBJECT, family
from hhtbench.analysis.fronts import Cost, Front, fronts
from hhtbench.analysis.kinds import Kind
from hhtbench.store.rows import RunRow


@dataclass(frozen=True, kw_only=True)
class Place:
    """One solver on the problems of a kind."""

    entry: str
    costs: Mapping[str, Cost]  #: by problem, of those where it reaches the error

    @property
    def mean(self) -> float:
        """Geometric mean of its costs."""
        return _mean([cost.value for cost in self.costs.values()])

    def ratio(self, other: Place) -> float | None:
        """Its cost over the other's, geometric mean over the problems where both reach the error; None where none is."""
        both = [name for name in self.costs if name in other.costs]
        return _mean([self.costs[name].value / other.costs[name].value for name in both]) if both else None


@dataclass(frozen=True, kw_only=True)
class Choice:
    """All solvers on one kind of problem, at one error, drift bound and measure."""

    kind: Kind
    target: float
    problems: tuple[str, ...]  #: on which the error can be judged, and with a bound the drift
    places: tuple[Place, ...]  #: who gets there on the most problems first, of these the cheapest first

    @property
    def subject(self) -> Place | None:
        """HHT's best."""
        return next((place for place in self.places if family(place.entry) == SUBJECT), None)


def decide(
    rows: Sequence[RunRow],
    kinds: Mapping[Kind, Sequence[str]],
    measure: str,
    targets: Sequence[float],
    held: float | None = None,
) -> tuple[Choice, ...]:
    """One choice for each kind and error; kinds without constraints are left out where the drift is bounded."""
    found = fronts(rows, measure, targets, held)
    choices = []
    for kind, problems in kinds.items():
        if held is not None and kind.constraints == "no constraints":
            continue
        for target in targets:
            own = [front for front in found if front.problem in problems and front.target == target and _judged(front)]
            if own:
                names = tuple(front.problem for front in own)
                choices.append(Choice(kind=kind, target=target, problems=names, places=_places(own)))
    return tuple(choices)


def _judged(front: Front) -> bool:
    """Whether the reference can judge this error: then somebody has a cost, or a reason of his own for none."""
    return bool(front.costs) or any(reason.kind != "unjudged" for reason in front.missing.values())


def _places(found: Sequence[Front]) -> tuple[Place, ...]:
    costs: dict[str, dict[str, Cost]] = {}
    for front in found:
        for cost in front.costs:
            costs.setdefault(cost.entry, {})[front.problem] = cost
    places = [Place(entry=entry, costs=own) for entry, own in costs.items()]
    return tuple(sorted(places, key=lambda place: (-len(place.costs), place.mean)))


def _mean(values: Sequence[float]) -> float:
    return math.exp(sum(map(math.log, values)) / len(values))
