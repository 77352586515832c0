"""Who is faster at equal error: HHT and its best rivals on one problem, by solves taken in turn.

What a solver pays for an error is interpolated between two of its runs; a round solves all of these once, so that every
round gives one ratio of what both sides pay.  Rounds go to what they can decide: a comparison that is decided takes no more
part.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from hhtbench.analysis import STEADY, Cost, race
from hhtbench.analysis.cells import Point, points
from hhtbench.analysis.fronts import constrained_levels, cost_at, holds, pareto
from hhtbench.store import RunRow
from tests.performance.engine.clock import UNDECIDED, estimate

LOOKS = (8, 16, 32)  # rounds after which a comparison may be decided
KINDS = ("holder", "other", "explicit")  # of rivals, as Race names them
FASTER, SLOWER = "faster", "slower"  # HHT is

Solve = Callable[[Point], float | None]  # processor time of one solve [s]; None where it failed


@dataclass
class Duel:
    """HHT and one rival at one error."""

    target: float
    kinds: list[str]
    sides: tuple[tuple[Point, ...], tuple[Point, ...]]  #: of HHT and the rival: the coarse run, the accurate one; or one run
    factors: list[float] = field(default_factory=list)  #: the rival's time over HHT's, of every round

    def runs(self) -> tuple[Point, ...]:
        return (*self.sides[0], *self.sides[1])

    def seconds(self) -> float:
        """Of one round, as far as it is known before [s]."""
        return sum(run.time or 0.0 for run in self.runs())

    def add(self, times: Mapping[str, float | None]) -> None:
        """The figure of one round."""
        costs = [cost_at([replace(run, time=times[run.key]) for run in side], self.target, "time") for side in self.sides]
        if all(cost is not None for cost in costs):
            self.factors.append(costs[1].value / costs[0].value)  # type: ignore[union-attr]

    def verdict(self) -> str:
        found = estimate(self.factors, LOOKS)
        return FASTER if found.low > 1.0 else SLOWER if found.high < 1.0 else UNDECIDED

    def lines(self) -> list[dict[str, Any]]:
        """One line a kind of rival."""
        ours, theirs = (side[-1] for side in self.sides)
        found = asdict(estimate(self.factors, LOOKS)) if self.factors else dict.fromkeys(("value", "low", "high", "count"))
        line = {"problem": ours.problem, "target": self.target, "subject": ours.entry, "rival": theirs.entry}
        return [
            {**line, "kind": kind, **found, "verdict": self.verdict() if self.factors else UNDECIDED} for kind in self.kinds
        ]


def duels(rows: Sequence[RunRow], solve: Solve, patience: float) -> list[dict[str, Any]]:
    """Every comparison of the tables, decided as far as ``patience`` suffices [s of processor time]."""
    known = _pairings(rows)
    end, affordable, spent = time.process_time() + patience, list[Duel](), 0.0
    for duel in sorted(known, key=Duel.seconds):
        spent += LOOKS[0] * duel.seconds()  # an upper bound: they share runs
        if spent <= patience:
            affordable.append(duel)
    rest = [duel for duel in known if duel not in affordable]
    _rounds(affordable, solve, end)
    _rounds(rest, solve, end, most=1)
    return [line for duel in known for line in duel.lines()]


def _rounds(open_ones: list[Duel], solve: Solve, end: float, most: int = LOOKS[-1]) -> None:
    for count in range(1, most + 1):
        runs = list({run.key: run for duel in open_ones for run in duel.runs()}.values())
        if not runs or time.process_time() > end:
            return
        times = {run.key: solve(run) for run in (runs if count % 2 else reversed(runs))}
        for duel in open_ones:
            duel.add(times)
        if count in LOOKS:
            open_ones = [duel for duel in open_ones if duel.verdict() == UNDECIDED]


def _pairings(rows: Sequence[RunRow]) -> list[Duel]:
    """HHT and each kind of rival at each error where both get there."""
    found: dict[Any, Duel] = {}
    known = points(rows)
    for line in race(rows):
        for kind in KINDS:
            rival: Cost | None = getattr(line, kind)
            if line.subject is None or rival is None:
                continue
            ours = _side(known, line.subject, line.target, held=line.steady)
            theirs = _side(known, rival, line.target, held=kind == "holder")
            keys = line.target, tuple(run.key for run in (*ours, *theirs))
            found.setdefault(keys, Duel(line.target, [], (ours, theirs))).kinds.append(kind)
    return list(found.values())


def _side(known: Sequence[Point], cost: Cost, target: float, *, held: bool) -> tuple[Point, ...]:
    """The runs between which ``cost`` is interpolated, the accurate one last."""
    levels = constrained_levels(known)
    own = [run for run in known if run.entry == cost.entry and (not held or holds(run, levels, STEADY))]
    best = pareto(own, "time")
    place = next(i for i, run in enumerate(best) if run.key == cost.run.key)
    return best[max(place - 1, 0) : place + 1]
