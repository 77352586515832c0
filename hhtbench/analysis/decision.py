"""Whom to take: solvers in order on several problems, or at several errors of one.

First by how many they reach, then by the geometric mean of their costs.  The order of two solvers follows from their own
rows alone: a third that comes or goes does not change it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hhtbench.analysis.fronts import Cost, Front, fronts
from hhtbench.analysis.kinds import Kind
from hhtbench.analysis.missing import NOT_RUN, UNKNOWN
from hhtbench.store.rows import RunRow

Goal = tuple[str, float]  # a problem and an error on it


@dataclass(frozen=True, kw_only=True)
class Place:
    """One solver on several goals: each is reached, or missed, or it is not known which."""

    entry: str
    costs: Mapping[Goal, Cost]  #: of the goals that it reaches
    missed: Mapping[Goal, float]  #: of those that it does not reach, what counts: a lower bound of the cost
    unknown: Mapping[Goal, str]  #: of the others, why it is not known: a kind of ``UNKNOWN``

    @property
    def mean(self) -> float:
        """Geometric mean of what counts; infinite where nothing is known."""
        counted = [*(cost.value for cost in self.costs.values()), *self.missed.values()]
        return math.exp(sum(map(math.log, counted)) / len(counted)) if counted else math.inf

    @property
    def at_most(self) -> bool:
        """Whether the mean rests on an upper bound."""
        return any(cost.bound for cost in self.costs.values())

    @property
    def at_least(self) -> bool:
        """Whether the mean rests on a lower bound."""
        return bool(self.missed)

    def beside(self, other: Place) -> tuple[Place, Place]:
        """Both on the goals that both reach."""
        both = [goal for goal in self.costs if goal in other.costs]
        mine, theirs = (
            Place(entry=one.entry, costs={goal: one.costs[goal] for goal in both}, missed={}, unknown={})
            for one in (self, other)
        )
        return mine, theirs


@dataclass(frozen=True, kw_only=True)
class Choice:
    """All solvers on one kind of problem, at one error, drift bound and measure."""

    kind: Kind
    target: float
    problems: tuple[str, ...]  #: on which the error can be judged, and with a bound the drift
    places: tuple[Place, ...]  #: in order, of who gets there on some and is known on all
    others: tuple[Place, ...]  #: of all others who have rows


def decide(
    rows: Sequence[RunRow],
    kinds: Mapping[Kind, Sequence[str]],
    measure: str,
    targets: Sequence[float],
    held: float | None = None,
) -> tuple[Choice, ...]:
    """One choice for each kind and error; problems without constraints are left out where the drift is bounded."""
    found = [front for front in fronts(rows, measure, targets, held) if _judged(front) and (held is None or front.levels)]
    choices = []
    for kind, problems in kinds.items():
        for target in targets:
            own = [front for front in found if front.problem in problems and front.target == target]
            if own:
                choices.append(_choice(kind, own))
    return tuple(choices)


def _judged(front: Front) -> bool:
    """Whether an error is known here, or nobody has come so far that it could be missing."""
    return bool(front.costs) or all(reason.kind != "unjudged" for reason in front.missing.values())


def _choice(kind: Kind, own: Sequence[Front]) -> Choice:
    found = places(own)
    return Choice(
        kind=kind,
        target=own[0].target,
        problems=tuple(front.problem for front in own),
        places=tuple(place for place in found if place.costs and not place.unknown),
        others=tuple(place for place in found if not place.costs or place.unknown),
    )


def places(found: Sequence[Front]) -> tuple[Place, ...]:
    """Of all solvers of the fronts, who reaches the most first, of these the cheapest."""
    entries = dict.fromkeys(entry for front in found for entry in front.allowed)
    return tuple(sorted((_place(entry, found) for entry in entries), key=lambda place: (-len(place.costs), place.mean)))


def _place(entry: str, found: Sequence[Front]) -> Place:
    costs: dict[Goal, Cost] = {}
    missed: dict[Goal, float] = {}
    unknown: dict[Goal, str] = {}
    for front in found:
        goal, reason = (front.problem, front.target), front.missing.get(entry)
        if entry not in front.allowed:
            unknown[goal] = NOT_RUN
        elif reason is None:
            costs[goal] = next(cost for cost in front.costs if cost.entry == entry)
        elif reason.kind in UNKNOWN:
            unknown[goal] = reason.kind
        else:
            missed[goal] = max(front.allowed[entry], reason.bound or 0.0)
    return Place(entry=entry, costs=costs, missed=missed, unknown=unknown)
