"""Whom to take: solvers in order on several problems, or at several errors of one, by the geometric mean of their costs.

The order of two solvers follows from their own rows and the problems alone: a third that comes or goes does not change it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from hhtbench.analysis.fronts import Campaign, Cost, Front, campaign_of, fronts
from hhtbench.analysis.kinds import Kind
from hhtbench.analysis.missing import UNKNOWN
from hhtbench.store.rows import RunRow

Goal = tuple[str, float]  # a problem and an error on it


@dataclass(frozen=True, kw_only=True)
class Place:
    """One solver on several goals."""

    entry: str
    costs: Mapping[Goal, Cost]  #: of the goals that it reaches
    missed: Mapping[Goal, float]  #: of those that it was run for and does not reach: what counts as its cost

    @property
    def counted(self) -> dict[Goal, float]:
        """What counts on every goal of which it is known whether it reaches it."""
        return {goal: cost.value for goal, cost in self.costs.items()} | dict(self.missed)

    @property
    def mean(self) -> float:
        """Geometric mean of what counts."""
        return _mean(self.counted.values())

    @property
    def bound(self) -> bool:
        """Whether a cost is an upper bound."""
        return any(cost.bound for cost in self.costs.values())

    def ratio(self, other: Place) -> float | None:
        """Its cost over the other's: geometric mean over the goals where both are known; None where there is none."""
        mine, theirs = self.counted, other.counted
        both = [goal for goal in mine if goal in theirs]
        return _mean(mine[goal] / theirs[goal] for goal in both) if both else None


@dataclass(frozen=True, kw_only=True)
class Choice:
    """All solvers on one kind of problem, at one error, drift bound and measure."""

    kind: Kind
    target: float
    problems: tuple[str, ...]  #: on which the error can be judged, and with a bound the drift
    places: tuple[Place, ...]  #: of who was run on all of them and gets there on some, the cheapest first
    others: tuple[Place, ...]  #: of all others who have rows

    @property
    def partial(self) -> tuple[Place, ...]:
        """Of the others those who get there on some, but were not run on all."""
        return tuple(place for place in self.others if place.costs)


def decide(
    rows: Sequence[RunRow],
    kinds: Mapping[Kind, Sequence[str]],
    measure: str,
    targets: Sequence[float],
    held: float | None = None,
    campaign: Campaign | None = None,
) -> tuple[Choice, ...]:
    """One choice for each kind and error; kinds without constraints are left out where the drift is bounded."""
    found, allowed = fronts(rows, measure, targets, held), (campaign or campaign_of(rows)).allowed(measure)
    choices = []
    for kind, problems in kinds.items():
        if held is not None and kind.constraints == "no constraints":
            continue
        for target in targets:
            own = [front for front in found if front.problem in problems and front.target == target and _judged(front)]
            if own:
                choices.append(_choice(kind, own, places(own, allowed)))
    return tuple(choices)


def _judged(front: Front) -> bool:
    """Whether an error is known here, or nobody has come so far that it could be missing."""
    return bool(front.costs) or all(reason.kind != "unjudged" for reason in front.missing.values())


def _choice(kind: Kind, own: Sequence[Front], found: Sequence[Place]) -> Choice:
    ranked = tuple(place for place in found if place.costs and len(place.counted) == len(own))
    return Choice(
        kind=kind,
        target=own[0].target,
        problems=tuple(front.problem for front in own),
        places=ranked,
        others=tuple(place for place in found if place not in ranked),
    )


def places(found: Sequence[Front], allowed: float) -> tuple[Place, ...]:
    """Of all solvers of the fronts, the cheapest first; on a goal that one does not reach, ``allowed`` counts at least."""
    costs: dict[str, dict[Goal, Cost]] = {}
    missed: dict[str, dict[Goal, float]] = {}
    for front in found:
        for cost in front.costs:
            costs.setdefault(cost.entry, {})[front.problem, front.target] = cost
        for entry, reason in front.missing.items():
            own = missed.setdefault(entry, {})
            if reason.kind not in UNKNOWN:
                own[front.problem, front.target] = max(allowed, reason.bound or 0.0)
    entries = dict.fromkeys([*costs, *missed])
    whole = [Place(entry=entry, costs=costs.get(entry, {}), missed=missed.get(entry, {})) for entry in entries]
    return tuple(sorted(whole, key=lambda place: place.mean))


def _mean(values: Iterable[float]) -> float:
    """Infinite where there is none."""
    logarithms = [math.log(value) for value in values]
    return math.exp(sum(logarithms) / len(logarithms)) if logarithms else math.inf
