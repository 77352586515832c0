"""Find the solver that reaches a given error most cheaply, and compare HHT with the best other solver."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

from hhtbench.campaign.analysis.cells import SUBJECT, Point, by_problem, family, points, problems
from hhtbench.campaign.analysis.missing import UNKNOWN, UNREFINED, Missing, drifting, why_missing
from hhtbench.campaign.store.rows import RunRow

TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # achieved scaled errors, where the rows name none
BOUNDS = (None, 1e-6, 1e-10)  # drift bounds: none, what many engineers need, what only projection and HHT keep
MEASURES = ("time", "evaluations")
STEADY = 1e-10  # scaled drift of both levels up to which a run counts as holding the constraints
SAME = 0.995  # share of pairs of repeats of one solve within the level factor; 99 % of comparisons must


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Cost of one solver for one error."""

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
        """All solvers that were run on the problem."""
        return (*(cost.entry for cost in self.costs), *self.missing)

    @property
    def subject(self) -> Cost | None:
        """Cost of HHT's cheapest entry; None if none reaches the error."""
        return next((cost for cost in self.costs if family(cost.entry) == SUBJECT), None)


@dataclass(frozen=True, kw_only=True)
class Comparison(Front):
    """Comparison of HHT's (``SUBJECT``) cheapest entry with the cheapest other solver."""

    level: float = 1.0  #: factors up to it are level: repeats of one solve differ by as much

    @property
    def rival(self) -> Cost | None:
        """Cost of the cheapest other solver; None if none reaches the error."""
        return next((cost for cost in self.costs if family(cost.entry) != SUBJECT), None)

    @property
    def factor(self) -> float | None:
        """Cost of the best other solver divided by HHT's: above 1 HHT is cheaper."""
        return None if self.subject is None or self.rival is None else self.rival.value / self.subject.value

    @property
    def outcome(self) -> str:
        """Result for HHT: "wins", "loses", "level"; or why there is no factor.

        "absent": HHT does not reach the error; "alone": no other solver does; "unheld": others do with too much drift only;
        "unknown": one side was not run, counted, judged or refined.
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
        """Lower bound of the cost ratio if one side does not reach the error; None otherwise."""
        winner = self.subject or self.rival
        bounds = [reason.bound for reason in self._reasons(own=self.subject is None) if reason.kind not in UNKNOWN]
        if winner is None or self.factor is not None or not bounds or None in bounds:
            return None
        return min(bound for bound in bounds if bound is not None) / winner.value

    @property
    def own_missing(self) -> Missing | None:
        """Reason why HHT has no cost: that of its entry with the smallest error."""
        nearest = sorted(self._reasons(own=True), key=lambda reason: reason.error or math.inf)
        return nearest[0] if nearest and self.subject is None else None

    def _reasons(self, *, own: bool) -> list[Missing]:
        """Return the reasons of HHT's entries (``own``) or of all others for having no cost."""
        return [reason for entry, reason in self.missing.items() if (family(entry) == SUBJECT) is own]


def pareto(runs: Iterable[Point], measure: str) -> tuple[Point, ...]:
    """Return the runs that no other run beats in both error and work, cheapest first."""
    usable = [run for run in runs if run.error is not None and run.work(measure)]
    best: list[Point] = []
    for run in sorted(usable, key=lambda run: (run.work(measure), run.error)):
        if not best or _error(run) < _error(best[-1]):
            best.append(run)
    return tuple(best)


def cost_at(runs: Sequence[Point], target: float, measure: str) -> Cost | None:
    """Return the work of one solver at the error ``target``, interpolated; None if no run reaches it."""
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
    """Interpolate the work between two runs log-log in the error; the finer run's work if its error is zero."""
    if _error(fine) == 0:
        return _work(fine, measure)
    share = math.log(_error(coarse) / target) / math.log(_error(coarse) / _error(fine))
    low, high = math.log(_work(coarse, measure)), math.log(_work(fine, measure))
    return math.exp(low + share * (high - low))


def targets_of(found: Iterable[Point]) -> tuple[float, ...]:
    """Return the errors that the campaign of these runs asked for, loosest first."""
    asked = {accuracy for run in found if run.rules is not None for accuracy in run.rules.accuracies}
    return tuple(sorted(asked, reverse=True)) or TARGETS


def fronts(
    rows: Iterable[RunRow], measure: str, targets: Sequence[float] = (), held: float | None = None
) -> tuple[Front, ...]:
    """Return one front per problem and target; with ``held`` only runs count whose drift stays within it."""
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
    """Return the levels ("position", "velocity") of the problem's constraints, as far as these runs measured drift."""
    known = list(runs)
    return tuple(level for level in ("position", "velocity") if any(getattr(run, level) is not None for run in known))


def holds(run: Point, levels: Sequence[str], bound: float) -> bool:
    """True if the run's drift was measured and is at most ``bound`` at all ``levels``."""
    return all(getattr(run, level) is not None and getattr(run, level) <= bound for level in levels)


def level_of(found: Iterable[Point]) -> float:
    """Return the factor within which the share ``SAME`` of all pairs of repeats lie; costs that differ by less are level.

    Every run is timed in several rounds over all of them, so that its repeats are spread over time.
    """
    ratios = [max(a, b) / min(a, b) for run in found for a, b in combinations(run.repeats, 2)]
    return sorted(ratios)[math.ceil(SAME * len(ratios)) - 1] if ratios else 1.0


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Values that follow only from all rows together: the level factor and the target errors."""

    level: float  #: :func:`level_of` their times
    targets: tuple[float, ...]  #: :func:`targets_of` them


def campaign_of(rows: Iterable[RunRow]) -> Campaign:
    """Compute the :class:`Campaign` values from all rows of a report."""
    found = points(rows)
    return Campaign(level=level_of(found), targets=targets_of(found))


def compare(
    rows: Sequence[RunRow],
    targets: Sequence[float] = (),
    held: float | None = None,
    campaign: Campaign | None = None,
) -> tuple[Comparison, ...]:
    """Compare HHT's best entry (family ``SUBJECT``) with the best other solver for each problem, measure and target.

    With ``held`` only runs count whose position and velocity drift stay within it, and only problems with constraints.  The
    level factor and the targets are those of ``campaign``, which is computed from ``rows`` if not given.
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
