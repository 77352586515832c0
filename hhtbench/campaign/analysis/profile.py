"""Performance profiles: the share of all pairs of problem and error that a solver reaches within a given cost.

Absolute ones are empirical distribution functions as in COCO (Hansen et al. 2021): a solver's curve depends on its own
rows only.  Those of Dolan and More (2002) are relative to the best, so that their order may change with the set of solvers
(Gould and Scott 2016).  Every problem has the same weight, whatever the number of its errors that can be judged.
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
    weight: float  #: of the pair among all: the problem's equal share, divided by its errors
    cost: float | None  #: of the first run, loosest setting first, that reaches the error; None: none does
    search: float | None  #: of this and all runs before it, failed ones included; None too where that of one is not known


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Step function: the share ``share`` of all pairs is reached within ``cost``."""

    entry: str
    cost: tuple[float, ...]  #: rising
    share: tuple[float, ...]  #: of all pairs, 0 to 1


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
    cost = search = None
    for index, run in enumerate(runs):
        if run.error is not None and run.error <= target and run.work(measure):
            cost, spent = run.work(measure), [_spent(run, measure) for run in runs[: index + 1]]
            search = None if None in spent else sum(value for value in spent if value is not None)
            break
    return Reach(problem=runs[0].problem, target=target, entry=runs[0].entry, weight=weight, cost=cost, search=search)


def _spent(run: Point, measure: str) -> float | None:
    """Return the cost of a run, successful or not; its time limit if the time is not known."""
    if run.status == "declined":
        return 0.0
    return run.work(measure) or (run.spent or run.allowed if measure == "time" else None)


def profiles(found: Iterable[Reach], cost: str = "cost") -> tuple[Profile, ...]:
    """Return one absolute profile per solver, by ``cost`` (the run alone) or ``search`` (with all runs before it)."""
    return tuple(
        _profile(entry, [(value, reach.weight) for reach in own if (value := getattr(reach, cost)) is not None])
        for entry, own in _by_entry(found).items()
    )


def relative_profiles(found: Sequence[Reach]) -> tuple[Profile, ...]:
    """Return Dolan and More's profiles: by the cost divided by that of the best solver on the same pair."""
    best: dict[tuple[str, float], float] = {}
    for reach in found:
        if reach.cost is not None:
            pair = (reach.problem, reach.target)
            best[pair] = min(best.get(pair, reach.cost), reach.cost)
    return tuple(
        _profile(entry, [(r.cost / best[r.problem, r.target], r.weight) for r in own if r.cost is not None])
        for entry, own in _by_entry(found).items()
    )


def _by_entry(found: Iterable[Reach]) -> dict[str, list[Reach]]:
    groups: dict[str, list[Reach]] = {}
    for reach in found:
        groups.setdefault(reach.entry, []).append(reach)
    return groups


def _profile(entry: str, values: Sequence[tuple[float, float]]) -> Profile:
    ordered = sorted(values)
    share = tuple(accumulate(weight for _, weight in ordered))
    return Profile(entry=entry, cost=tuple(cost for cost, _ in ordered), share=share)
