"""Whom to take: solvers in order on several problems, or at several errors of one.

First by how many they reach, then by the geometric mean of their costs there: the order of two solvers follows from the
problems and their own rows, and a third on the same problems does not change it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from hhtbench.campaign.analysis.fronts import Cost, Front, fronts
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.campaign.analysis.missing import NOT_RUN
from hhtbench.campaign.store.rows import RunRow

Goal = tuple[str, float]  # a problem and an error on it


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """The cost of one solver over another's, in the geometric mean of the goals that both reach."""

    value: float
    goals: int  #: that both reach
    at_most: bool  #: a cost above the line is an upper bound
    at_least: bool  #: one below it is

    def within(self, level: float) -> bool:
        """Whether the two are level: their costs, no bounds, differ by no more than this factor."""
        return 1 / level <= self.value <= level and not (self.at_most or self.at_least)


@dataclass(frozen=True, kw_only=True)
class Place:
    """One solver on several goals."""

    entry: str
    costs: Mapping[Goal, Cost]  #: of the goals that it reaches
    missing: Mapping[Goal, str]  #: why not the others: a kind of :class:`~hhtbench.campaign.analysis.Missing`

    @property
    def mean(self) -> float:
        """Geometric mean of the costs; infinite where nothing is reached."""
        return _mean(cost.value for cost in self.costs.values()) if self.costs else math.inf

    @property
    def at_most(self) -> bool:
        """Whether the mean rests on an upper bound."""
        return any(cost.bound for cost in self.costs.values())

    def over(self, other: Place) -> Ratio | None:
        """Where both reach something: what this one costs there over the other."""
        pairs = [(cost, other.costs[goal]) for goal, cost in self.costs.items() if goal in other.costs]
        if not pairs:
            return None
        return Ratio(
            value=_mean(own.value / its.value for own, its in pairs),
            goals=len(pairs),
            at_most=any(own.bound for own, _ in pairs),
            at_least=any(its.bound for _, its in pairs),
        )


@dataclass(frozen=True, kw_only=True)
class Choice:
    """All solvers on one kind of problem, at one error, drift bound and measure."""

    kind: Kind
    target: float
    problems: tuple[str, ...]  #: on which the error can be judged, and with a bound the drift
    places: tuple[Place, ...]  #: in order, of all that have rows


def _mean(values: Iterable[float]) -> float:
    logarithms = [math.log(value) for value in values]
    return math.exp(sum(logarithms) / len(logarithms))


def decide(
    rows: Sequence[RunRow],
    kinds: Mapping[Kind, Sequence[str]],
    measure: str,
    targets: Sequence[float],
    held: float | None = None,
) -> tuple[Choice, ...]:
    """One choice for each kind and error; problems without constraints are left out where the drift is bounded."""
    found = [
        front
        for front in fronts(rows, measure, targets, held)
        if (front.levels or held is None)
        and (front.costs or all(reason.kind != "unjudged" for reason in front.missing.values()))  # or nobody came so far
    ]
    choices = []
    for kind, problems in kinds.items():
        for target in targets:
            own = [front for front in found if front.problem in problems and front.target == target]
            judged = tuple(front.problem for front in own)
            choices += [Choice(kind=kind, target=target, problems=judged, places=places(own))] if own else []
    return tuple(choices)


def places(found: Sequence[Front]) -> tuple[Place, ...]:
    """Of all solvers of the fronts, who reaches the most first, of these the cheapest."""
    entries = dict.fromkeys(entry for front in found for entry in front.entries)
    return tuple(sorted((_place(entry, found) for entry in entries), key=lambda place: (-len(place.costs), place.mean)))


def _place(entry: str, found: Sequence[Front]) -> Place:
    costs = {(front.problem, front.target): cost for front in found for cost in front.costs if cost.entry == entry}
    missing = {
        (front.problem, front.target): front.missing[entry].kind if entry in front.missing else NOT_RUN
        for front in found
        if (front.problem, front.target) not in costs
    }
    return Place(entry=entry, costs=costs, missing=missing)
