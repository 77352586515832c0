"""Profiles: the share of all pairs of problem and error that a solver reaches within a given cost.

They are empirical distribution functions as those of COCO (Hansen et al. 2021).  A solver's curve rests on its own rows
alone, unlike those of Dolan and More (2002), whose order may change when a solver is added (Gould and Scott 2016).  Every
problem has the same weight, whatever the number of its errors that can be judged.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from hhtbench.campaign.analysis.cells import Point, by_problem, points
from hhtbench.campaign.analysis.fronts import targets_of
from hhtbench.campaign.store.rows import RunRow


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Cost of one solver to reach one error on one problem."""

    problem: str
    target: float
    entry: str
    weight: float  #: weight of the pair among all: the problem's equal share, divided by its number of errors
    cost: float | None  #: cost of the first run, loosest setting first, that reaches the error; None: none does


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Step function: the share ``share`` of all pairs is reached within ``cost``."""

    entry: str
    cost: tuple[float, ...]  #: rising
    share: tuple[float, ...]  #: share of all pairs, 0 to 1


def reaches(rows: Iterable[RunRow], measure: str, targets: Sequence[float] = ()) -> tuple[Reach, ...]:
    """Return one Reach per problem, judgeable error and solver; ``measure`` is "time" or "evaluations"."""
    found = points(rows)
    groups = by_problem(found)
    judged = {name: _judged(own, targets or targets_of(found)) for name, own in groups.items()}
    count = sum(bool(own) for own in judged.values())
    return tuple(
        _reach(runs, measure, target, 1.0 / (count * len(judged[name])))
        for name, own in groups.items()
        for target in judged[name]
        for runs in own.values()
    )


def _judged(groups: Mapping[str, Sequence[Point]], targets: Sequence[float]) -> list[float]:
    """Return the errors that the problem's reference can judge; none if no run was compared."""
    runs = [run for own in groups.values() for run in own]
    if all(run.error is None and run.doubted is None for run in runs):
        return []
    return [target for target in targets if target >= max(run.limit for run in runs)]


def _reach(runs: Sequence[Point], measure: str, target: float, weight: float) -> Reach:
    there = (run.work(measure) for run in runs if run.error is not None and run.error <= target and run.work(measure))
    return Reach(problem=runs[0].problem, target=target, entry=runs[0].entry, weight=weight, cost=next(there, None))


def profiles(found: Iterable[Reach]) -> tuple[Profile, ...]:
    """Return one profile per solver, by the cost of its runs."""
    reached: dict[str, list[Reach]] = {}
    for reach in found:
        reached.setdefault(reach.entry, []).extend([reach] if reach.cost is not None else [])
    ordered = {entry: sorted(own, key=lambda reach: reach.cost or 0.0) for entry, own in reached.items()}
    return tuple(
        Profile(
            entry=entry,
            cost=tuple(reach.cost or 0.0 for reach in own),
            share=tuple(accumulate(reach.weight for reach in own)),
        )
        for entry, own in ordered.items()
    )
