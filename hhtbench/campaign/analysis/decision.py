"""Rank solvers on several problems, or at several errors of one problem.

First by the number of goals they reach, then by the geometric mean of their costs there: the order of two solvers follows
from the problems and their own rows, and a third solver does not change it.
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
    """Geometric mean of the cost ratio of two solvers over the goals that both reach."""

    value: float
    goals: int  #: that both reach
    at_most: bool  #: a cost above the line is an upper bound
    at_least: bool  #: one below it is

    def within(self, level: float) -> bool:
        """True if the two are level: their costs are no bounds and differ by at most the factor ``level``."""
        return 1 / level <= self.value <= level and not (self.at_most or self.at_least)


@dataclass(frozen=True, kw_only=True)
class SolverCosts:
    """Result of one solver on several goals: costs of those reached, reasons for the others."""

    entry: str
    costs: Mapping[Goal, Cost]  #: costs at the goals that it reaches
    missing: Mapping[Goal, str]  #: why not the others: a kind of :class:`~hhtbench.campaign.analysis.Missing`

    @property
    def mean(self) -> float:
        """Geometric mean of the costs; infinite if nothing is reached."""
        return _mean(cost.value for cost in self.costs.values()) if self.costs else math.inf

    @property
    def at_most(self) -> bool:
        """True if the mean contains an upper bound."""
        return any(cost.bound for cost in self.costs.values())

    def over(self, other: SolverCosts) -> Ratio | None:
        """Return the cost ratio to ``other`` on the goals that both reach; None if there are none."""
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
    """Ranking of all solvers on one kind of problem, at one error, drift bound and measure."""

    kind: Kind
    target: float
    problems: tuple[str, ...]  #: on which the error can be judged, and with a bound the drift
    places: tuple[SolverCosts, ...]  #: in order, of all that have rows


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
    """Rank the solvers for each kind of problem and error; with a drift bound only on problems with constraints."""
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


def places(found: Sequence[Front]) -> tuple[SolverCosts, ...]:
    """Rank the solvers of the fronts: by the number of goals reached, then by mean cost."""
    entries = dict.fromkeys(entry for front in found for entry in front.entries)
    return tuple(sorted((_place(entry, found) for entry in entries), key=lambda place: (-len(place.costs), place.mean)))


def _place(entry: str, found: Sequence[Front]) -> SolverCosts:
    costs = {(front.problem, front.target): cost for front in found for cost in front.costs if cost.entry == entry}
    missing = {
        (front.problem, front.target): front.missing[entry].kind if entry in front.missing else NOT_RUN
        for front in found
        if (front.problem, front.target) not in costs
    }
    return SolverCosts(entry=entry, costs=costs, missing=missing)
