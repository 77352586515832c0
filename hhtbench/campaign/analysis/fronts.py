"""Who reaches a given error most cheaply, and what the extended HHT-alpha method pays against the best other solver."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

from hhtbench.campaign.analysis.cells import SUBJECT, Point, by_problem, family, points, problems
from hhtbench.campaign.analysis.missing import UNKNOWN, UNREFINED, Missing, drifting, why_missing
from hhtbench.campaign.store.rows import RunRow

TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # achieved scaled errors, where the rows name none
BOUNDS = (None, 1e-6, 1e-10)  # of the drift: none, what many engineers need, what only projection and HHT keep
MEASURES = ("time", "evaluations")
STEADY = 1e-10  # drift, scaled, of both levels up to which a run holds the constraints
SAME = 0.995  # of the repeats of one solve that differ by less than what is level; 99 % of comparisons must


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What one solver pays for one error."""

    entry: str
    value: float  #: s or evaluations, interpolated in the logarithms between two runs
    bound: bool  #: its cheapest run is more accurate than asked; ``value`` is that run's, an upper bound
    run: Point  #: the run at the accurate end: its error is at most the target


@dataclass(frozen=True, kw_only=True)
class Front:
    """Costs of all solvers for one error on one problem."""

    problem: str
    measure: str  #: "time" or "evaluations"
    target: float
    costs: tuple[Cost, ...]  #: cheapest first
    missing: dict[str, Missing]  #: solver -> why it has no cost
    levels: tuple[str, ...]  #: :func:`constrained_levels` of the problem

    @property
    def entries(self) -> tuple[str, ...]:
        """Everybody who was run on the problem."""
        return (*(cost.entry for cost in self.costs), *self.missing)

    @property
    def subject(self) -> Cost | None:
        """The cheapest of the subject's entries."""
        return next((cost for cost in self.costs if family(cost.entry) == SUBJECT), None)


@dataclass(frozen=True, kw_only=True)
class Comparison(Front):
    """The best entry of the subject against the best other solver."""

    level: float = 1.0  #: factors up to it are level: repeats of one solve differ by as much

    @property
    def rival(self) -> Cost | None:
        """The cheapest of all others."""
        return next((cost for cost in self.costs if family(cost.entry) != SUBJECT), None)

    @property
    def factor(self) -> float | None:
        """The rival's cost over the subject's: above 1 the subject wins."""
        return None if self.subject is None or self.rival is None else self.rival.value / self.subject.value

    @property
    def outcome(self) -> str:
        """ "wins", "loses", "level"; "absent" (the subject does not reach it), "alone" (no other does), "unheld" (others
        only with more drift), "unknown" (nothing is known of one side).
        """
        if self.factor is not None:
            if 1 / self.level <= self.factor <= self.level:
                return "level"
            return "wins" if self.factor > 1 else "loses"
        known = {reason.kind for reason in self._reasons(own=self.subject is None)}
        if known <= set(UNKNOWN) or known & set(UNREFINED) or (self.subject is None and self.rival is None):
            return "unknown"
        if self.subject is None:
            return "absent"
        return "unheld" if "drifts" in known else "alone"

    @property
    def least_factor(self) -> float | None:
        """A lower bound of the dearer side's cost over the other's, where the dearer side does not get to the error."""
        winner = self.subject or self.rival
        bounds = [reason.bound for reason in self._reasons(own=self.subject is None) if reason.kind not in UNKNOWN]
        if winner is None or self.factor is not None or not bounds or None in bounds:
            return None
        return min(bound for bound in bounds if bound is not None) / winner.value

    @property
    def own_missing(self) -> Missing | None:
        """Why the subject has no cost: the reason of its entry that came nearest."""
        nearest = sorted(self._reasons(own=True), key=lambda reason: reason.error or math.inf)
        return nearest[0] if nearest and self.subject is None else None

    def _reasons(self, *, own: bool) -> list[Missing]:
        """Of the subject's entries, or of all others'."""
        return [reason for entry, reason in self.missing.items() if (family(entry) == SUBJECT) is own]


def pareto(runs: Iterable[Point], measure: str) -> tuple[Point, ...]:
    """Runs that no other run beats in both error and work; cheapest (and least accurate) first."""
    usable = [run for run in runs if run.error is not None and run.work(measure)]
    best: list[Point] = []
    for run in sorted(usable, key=lambda run: (run.work(measure), run.error)):
        if not best or _error(run) < _error(best[-1]):
            best.append(run)
    return tuple(best)


def cost_at(runs: Sequence[Point], target: float, measure: str) -> Cost | None:
    """Work of one solver at the error ``target``; None where no run reaches it."""
    best = pareto(runs, measure)
    reached = next((index for index, run in enumerate(best) if _error(run) <= target), None)
    if reached is None:
        return None
    run = best[reached]
    if reached == 0:
        exact = _error(run) == target
        return Cost(entry=run.entry, value=_work(run, measure), bound=not exact, run=run)
    value = _between(best[reached - 1], run, target, measure)
    return Cost(entry=run.entry, value=value, bound=False, run=run)


def _between(coarse: Point, fine: Point, target: float, measure: str) -> float:
    """Interpolated in the logarithms; an error of zero has none, so the finer run's work counts."""
    if _error(fine) == 0:
        return _work(fine, measure)
    share = math.log(_error(coarse) / target) / math.log(_error(coarse) / _error(fine))
    low, high = math.log(_work(coarse, measure)), math.log(_work(fine, measure))
    return math.exp(low + share * (high - low))


def targets_of(found: Iterable[Point]) -> tuple[float, ...]:
    """The errors that the campaign of these runs asked for, the loosest first."""
    asked = {accuracy for run in found if run.rules is not None for accuracy in run.rules.accuracies}
    return tuple(sorted(asked, reverse=True)) or TARGETS


def fronts(
    rows: Iterable[RunRow], measure: str, targets: Sequence[float] = (), held: float | None = None
) -> tuple[Front, ...]:
    """One front for each problem and target; with ``held`` of the runs whose position and velocity drift stay within it."""
    found = points(rows)
    targets = targets or targets_of(found)
    result = []
    for problem, groups in by_problem(found).items():
        limit = max((run.limit for group in groups.values() for run in group), default=0.0)
        result += [_front(problem, measure, target, groups, limit, held) for target in targets]
    return tuple(result)


def _front(
    problem: str, measure: str, target: float, groups: dict[str, list[Point]], limit: float, held: float | None
) -> Front:
    costs: list[Cost] = []
    missing: dict[str, Missing] = {}
    levels = constrained_levels(run for group in groups.values() for run in group)
    for entry, runs in groups.items():
        usable = runs if held is None else [run for run in runs if holds(run, levels, held)]
        cost = cost_at(usable, target, measure) if target >= limit else None
        accurate = [run for run in runs if run.work(measure) and _error(run) <= target]
        if cost is not None:
            costs.append(cost)
        elif target < limit:
            missing[entry] = Missing(kind="unjudged", text=f"the reference cannot judge errors below {limit:.0e}")
        elif held is not None and accurate:
            missing[entry] = drifting(accurate, held)
        else:
            missing[entry] = why_missing(runs, measure)
    ordered = tuple(sorted(costs, key=lambda cost: cost.value))
    return Front(problem=problem, measure=measure, target=target, costs=ordered, missing=missing, levels=levels)


def constrained_levels(runs: Iterable[Point]) -> tuple[str, ...]:
    """The levels, of position and velocity, that the constraints of these runs' problem have."""
    known = list(runs)
    return tuple(level for level in ("position", "velocity") if any(getattr(run, level) is not None for run in known))


def holds(run: Point, levels: Sequence[str], bound: float) -> bool:
    """Whether the run's drift was measured and is at most ``bound`` at all ``levels``."""
    return all(getattr(run, level) is not None and getattr(run, level) <= bound for level in levels)


def level_of(found: Iterable[Point]) -> float:
    """The factor within which ``SAME`` of all pairs of repeats of one solve lie: costs that differ by less are level.

    Every run is timed in several rounds over all of them, so that a round sees the machine at another time.
    """
    ratios = [max(a, b) / min(a, b) for run in found for a, b in combinations(run.repeats, 2)]
    return sorted(ratios)[math.ceil(SAME * len(ratios)) - 1] if ratios else 1.0


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What only all rows together tell."""

    level: float  #: :func:`level_of` their times
    targets: tuple[float, ...]  #: :func:`targets_of` them


def campaign_of(rows: Iterable[RunRow]) -> Campaign:
    """Of all rows of a report."""
    found = points(rows)
    return Campaign(level=level_of(found), targets=targets_of(found))


def compare(
    rows: Sequence[RunRow],
    targets: Sequence[float] = (),
    held: float | None = None,
    campaign: Campaign | None = None,
) -> tuple[Comparison, ...]:
    """For each problem, measure and target: the best of the family ``SUBJECT`` against the best of all others.

    With ``held`` only runs count whose position and velocity drift stay within it, and problems with constraints.  What is
    level, and the errors that were asked for, are those of the ``campaign``, which follows from ``rows`` if it is not given.
    """
    whole = campaign or campaign_of(rows)
    found = [
        Comparison(**vars(front), level=level)
        for measure, level in (("time", whole.level), ("evaluations", 1.0))
        for front in fronts(rows, measure, targets or whole.targets, held)
        if held is None or front.levels
    ]
    order = {problem: index for index, problem in enumerate(problems(rows))}
    return tuple(sorted(found, key=lambda line: order[line.problem]))


def _error(run: Point) -> float:
    return math.inf if run.error is None else run.error


def _work(run: Point, measure: str) -> float:
    return run.work(measure) or math.nan
