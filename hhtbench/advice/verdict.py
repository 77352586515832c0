"""Summarise a trade in one sentence: the solver to take, its setting, its cost, and what the second choice costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hhtbench.advice.criteria import Criteria
from hhtbench.campaign.analysis.cells import spec_of
from hhtbench.campaign.analysis.decision import places
from hhtbench.campaign.analysis.fronts import Cost, Front
from hhtbench.report.words import seconds, shown

CLEARLY = 1.3  # cost ratio at one error above which the sentence names the cheaper solver there


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The cheapest solver at one error, and the next one."""

    accuracy: float
    best: Cost
    second: Cost | None

    @property
    def solver(self) -> str:
        """Spec of the cheapest solver for ``hb.solve``; ``best.run.setting`` is its tolerance or step."""
        return spec_of(self.best.run)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        second = None if self.second is None else _plain(self.second)
        return {"accuracy": self.accuracy, **_plain(self.best), "second": second}


def _plain(cost: Cost) -> dict[str, Any]:
    run = cost.run
    numbers = {name: getattr(run, name) for name in ("error", "time", "evaluations", "position", "velocity")}
    return {"solver": spec_of(run), "setting": run.setting.text, "cost": cost.value, **numbers}


def choices_of(fronts: Sequence[Front]) -> tuple[Choice, ...]:
    """Return the cheapest solver and the next one at every error that a candidate reaches."""
    return tuple(
        Choice(accuracy=front.target, best=front.costs[0], second=next(iter(front.costs[1:]), None))
        for front in fronts
        if front.costs
    )


def as_run(fronts: Sequence[Front]) -> tuple[Front, ...]:
    """Replace interpolated costs by those of the runs that reach the error."""
    found = []
    for front in fronts:
        costs = [replace(cost, value=cost.run.work(front.measure) or cost.value) for cost in front.costs]
        found.append(replace(front, costs=tuple(sorted(costs, key=lambda cost: cost.value))))
    return tuple(found)


def ranking(fronts: Sequence[Front]) -> tuple[tuple[str, float], ...]:
    """Rank the entries that reach all errors reached by any, by geometric mean cost relative to the first.

    These are all that reach the tightest error, since the run that reaches it reaches the others too.
    """
    reached = [front for front in fronts if front.costs]
    ranked = [place for place in places(reached) if len(place.costs) == len(reached)]
    return tuple((place.entry, place.mean / ranked[0].mean) for place in ranked)


def sentence(fronts: Sequence[Front], criteria: Criteria) -> str:
    """Return the recommendation as one sentence; "" if no candidate reaches an error."""
    reached, ranked = [front for front in fronts if front.costs], ranking(fronts)
    if not ranked:
        return ""
    taken = ranked[0][0]
    own = [next(cost for cost in front.costs if cost.entry == taken) for front in reached]
    parts = [f"Take {taken}: {_expected(own[-1], reached[-1].target)}", "nobody else got there"]
    if len(ranked) > 1:
        mean = " in the mean of the errors" if len(reached) > 1 else ""
        parts[1] = f"the second choice, {ranked[1][0]}, costs {ranked[1][1]:.2g} times as much{mean}"
    dearer: dict[str, list[str]] = {}
    for front, cost in zip(reached, own, strict=True):
        if cost.value > CLEARLY * front.costs[0].value:
            dearer.setdefault(front.costs[0].entry, []).append(f"{front.target:g}")
    parts += [f"at {' and '.join(targets)} {entry} is cheaper" for entry, targets in dearer.items()]
    if missed := [f"{front.target:g}" for front in fronts if not front.costs]:
        held = "" if criteria.drift is None else f" within a drift of {criteria.drift:g}"
        parts.append(f"{', '.join(missed)} was reached by nobody{held}")
    return "; ".join(parts) + "."


def _expected(cost: Cost, target: float) -> str:
    run = cost.run
    drift = [f"{name} drift {value:.1e}" for name in ("position", "velocity") if (value := getattr(run, name)) is not None]
    found = [
        f"an error of {shown(run.error)} (asked: {target:g})",
        seconds(run.time),
        f"{shown(run.evaluations)} evaluations",
    ]
    return f"{run.setting.text} gives {', '.join([*found, *drift])}"


HINTS = {
    "declined": "run `hhtbench check` and `hhtbench describe` on the problem",
    "deadline": "give more seconds, or a shorter span",
    "unreliable": "`hhtbench check` compares derivatives, starts and energy; a wrong one makes every solver doubtful",
    "untried": "give more seconds: no candidate could begin in time",
    "user_exception": "mend the function that raised",
    "nonfinite_callback": "mend the function that returned a value that is not finite",
}
GENERAL = "`hhtbench check` looks for mistakes in the problem; looser errors or more seconds may be reached"


def failure(said: Mapping[str, str], statuses: Sequence[str], unknown: str) -> str:
    """Return what each candidate reported if none has a cost, and what to try; ``unknown``: why there is no reference, or
    "".
    """
    lines = [f"  {entry}: {text}" for entry, text in said.items()]
    known = [HINTS[status] for status in dict.fromkeys(statuses) if status in HINTS]
    tries = "; ".join(known) or GENERAL
    return "\n".join([f"Cannot tell: no candidate has a cost. {unknown}".rstrip(), *lines, f"What to try: {tries}."])
