"""From rows to one sentence: whom to take, at which setting, what to expect, and what the second choice costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hhtbench.advice.wish import Wish
from hhtbench.analysis.cells import spec_of
from hhtbench.analysis.decision import places
from hhtbench.analysis.fronts import Cost, Front
from hhtbench.report.words import seconds, shown

CLEARLY = 1.3  # times dearer at one error: the sentence names who is cheaper there


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Who is the cheapest at one error, and the next of another kind."""

    accuracy: float
    best: Cost
    second: Cost | None

    @property
    def solver(self) -> str:
        """The cheapest as ``hb.solve`` takes it; ``best.run.setting`` is what it was given."""
        return spec_of(self.best.run)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "accuracy": self.accuracy,
            **_plain(self.best),
            "second": None if self.second is None else _plain(self.second),
        }


def _plain(cost: Cost) -> dict[str, Any]:
    run = cost.run
    numbers = {name: getattr(run, name) for name in ("error", "time", "evaluations", "position", "velocity")}
    return {"solver": spec_of(run), "setting": run.setting.text, "cost": cost.value, **numbers}


def choices_of(fronts: Sequence[Front]) -> tuple[Choice, ...]:
    """One for every error that somebody reaches."""
    return tuple(
        Choice(accuracy=front.target, best=front.costs[0], second=next(iter(front.costs[1:]), None))
        for front in fronts
        if front.costs
    )


def as_run(fronts: Sequence[Front]) -> tuple[Front, ...]:
    """The same by what the runs took whose settings are told, not by what a run between two of them might take."""
    return tuple(replace(front, costs=_as_run(front)) for front in fronts)


def _as_run(front: Front) -> tuple[Cost, ...]:
    told = [replace(cost, value=cost.run.work(front.measure) or cost.value) for cost in front.costs]
    return tuple(sorted(told, key=lambda cost: cost.value))


def ranking(fronts: Sequence[Front]) -> tuple[tuple[str, float], ...]:
    """Entries that reach all errors that anybody reaches, with their mean cost over the first's (geometric), best first.

    These are all that reach the tightest: the run that does reaches the others too.
    """
    reached = [front for front in fronts if front.costs]
    ranked = [place for place in places(reached) if len(place.costs) == len(reached)]
    return tuple((place.entry, place.mean / ranked[0].mean) for place in ranked)


def sentence(fronts: Sequence[Front], wish: Wish) -> str:
    """The one sentence; "" where nobody reaches anything."""
    reached, ranked = [front for front in fronts if front.costs], ranking(fronts)
    if not ranked:
        return ""
    (taken, _), last = ranked[0], reached[-1]
    text = f"Take {taken}: {_expected(next(cost for cost in last.costs if cost.entry == taken), last.target)}"
    if len(ranked) > 1:
        other, mean = ranked[1]
        text += f"; the second choice, {other}, costs {mean:.2g} times as much"
        text += " in the mean of the errors" if len(reached) > 1 else ""
    else:
        text += "; nobody else got there"
    return text + _exceptions(reached, taken) + _unreached(fronts, wish) + "."


def _expected(cost: Cost, target: float) -> str:
    run = cost.run
    drift = [f"{name} drift {value:.1e}" for name in ("position", "velocity") if (value := getattr(run, name)) is not None]
    told = [
        f"an error of {shown(run.error)} (asked: {target:g})",
        f"{seconds(run.time)}",
        f"{shown(run.evaluations)} evaluations",
    ]
    return f"{run.setting.text} gives {', '.join([*told, *drift])}"


def _exceptions(reached: Sequence[Front], taken: str) -> str:
    """Errors at which another is clearly cheaper."""
    dearer: dict[str, list[float]] = {}
    for front in reached:
        own = next(cost.value for cost in front.costs if cost.entry == taken)
        if own > CLEARLY * front.costs[0].value:
            dearer.setdefault(front.costs[0].entry, []).append(front.target)
    return "".join(
        f"; at {' and '.join(f'{target:g}' for target in targets)} {entry} is cheaper" for entry, targets in dearer.items()
    )


def _unreached(fronts: Sequence[Front], wish: Wish) -> str:
    missed = [front.target for front in fronts if not front.costs]
    held = "" if wish.drift is None else f" within a drift of {wish.drift:g}"
    return f"; {', '.join(f'{target:g}' for target in missed)} was reached by nobody{held}" if missed else ""


HINTS = {
    "declined": "`hhtbench check` and `hhtbench describe` tell what the problem's functions do",
    "deadline": "give more seconds, or a shorter span",
    "unreliable": "`hhtbench check` compares derivatives, starts and energy; a wrong one makes every solver doubtful",
    "user_exception": "mend the function that raised",
    "nonfinite_callback": "mend the function that returned a value that is not finite",
}
GENERAL = "`hhtbench check` looks for mistakes in the problem; looser errors or more seconds may be reached"


def failure(said: Mapping[str, str], statuses: Sequence[str], told: str) -> str:
    """What each candidate said where none has a cost, and what to try; ``told``: why there is no reference, or ""."""
    lines = [f"  {entry}: {text}" for entry, text in said.items()]
    known = [HINTS[status] for status in dict.fromkeys(statuses) if status in HINTS]
    tries = "; ".join(known) or GENERAL
    return "\n".join([f"Cannot tell: no candidate has a cost. {told}".rstrip(), *lines, f"What to try: {tries}."])
