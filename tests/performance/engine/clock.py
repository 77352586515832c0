"""Times of several actions, taken in turn so that all see the same machine, and what they decide.

One round has every action once, the next one in the opposite order.  A round gives one figure, as the ratio of two of its
times; the result is the median of the figures with a distribution-free interval (order statistics, the sign test inverted:
W. J. Conover, Practical Nonparametric Statistics, Wiley 1999, section 3.2).  Rounds are added until the interval lies on
one side of the limit, or the time is up.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.stats import binom

CONFIDENCE = 0.95  # of an interval, at whichever of the looks it is taken
LOOKS = (8, 16, 32, 64, 128, 256)  # rounds after which the interval is looked at
PATIENCE = 20.0  # seconds after which no round is begun
HOLDS, BROKEN, UNDECIDED, UNMEASURED = "holds", "BROKEN", "not decided", "not measured"

Actions = Mapping[str, Callable[[], object]]
Figure = Callable[[Mapping[str, float]], float]  # seconds of every action of one round -> what is compared with the limit


@dataclass(frozen=True)
class Time:
    """One action [s]."""

    cpu: float  #: processor time, all threads together: on an idle core the time on the clock
    wall: float  #: on the clock


@dataclass(frozen=True)
class Estimate:
    """A median and what holds it at the level ``CONFIDENCE``."""

    value: float
    low: float  #: -inf where the values are too few
    high: float  #: +inf where the values are too few
    count: int  #: of values

    def verdict(self, limit: float) -> str:
        """Whether all of the interval is on one side of ``limit``."""
        return HOLDS if self.high <= limit else BROKEN if self.low > limit else UNDECIDED


@dataclass(frozen=True)
class Compared:
    """Rounds of one comparison."""

    figure: Estimate  #: of the processor times
    limit: float
    on_clock: float  #: median of the same figure by the clock
    rounds: Sequence[Mapping[str, Time]]

    def cpu(self, name: str) -> float:
        """Median processor time of one action [s]."""
        return statistics.median(found[name].cpu for found in self.rounds)

    def line(self) -> dict[str, Any]:
        """What every table shows of a comparison."""
        found = asdict(self.figure)
        return {**found, "clock": self.on_clock, "limit": self.limit, "verdict": self.figure.verdict(self.limit)}


def unmeasured(limit: float, note: str) -> dict[str, Any]:
    """The same of one that could not be made."""
    return {**dict.fromkeys(("value", "low", "high", "count", "clock")), "limit": limit, "verdict": UNMEASURED, "note": note}


def compare(
    actions: Actions, figure: Figure, limit: float, patience: float = PATIENCE, looks: Sequence[int] = LOOKS
) -> Compared:
    """``figure`` of rounds of ``actions`` beside ``limit``, after one round that does not count."""
    _round(actions)
    gc.collect()
    gc.freeze()  # JAX's objects, also of that round: every later collection would walk through them, 0.1 s each time
    rounds: list[Mapping[str, Time]] = []

    def one() -> float:
        rounds.append(_round(actions if len(rounds) % 2 == 0 else dict(reversed(actions.items()))))
        return figure({name: took.cpu for name, took in rounds[-1].items()})

    found = decide(one, (limit,), patience, looks)
    clock = statistics.median(figure({name: took.wall for name, took in taken.items()}) for taken in rounds)
    return Compared(found, limit, clock, rounds)


def decide(
    sample: Callable[[], float], limits: Iterable[float], patience: float = PATIENCE, looks: Sequence[int] = LOOKS
) -> Estimate:
    """The median of samples, until its interval holds none of ``limits``, the last look is over, or ``patience`` is [s]."""
    values: list[float] = []
    end = time.perf_counter() + patience
    while True:
        values.append(sample())
        up = time.perf_counter() > end
        if len(values) in looks or up:
            found = estimate(values, looks)
            if up or len(values) == looks[-1] or not any(found.low <= limit < found.high for limit in limits):
                return found


def estimate(values: Sequence[float], looks: Sequence[int] = LOOKS) -> Estimate:
    """The median with its interval, where every one of ``looks`` has its part of the chance to err."""
    ordered, n = sorted(values), len(values)
    left_out = int(binom.ppf((1.0 - CONFIDENCE) / len(looks) / 2.0, n, 0.5))  # values at either end
    if binom.cdf(left_out, n, 0.5) > (1.0 - CONFIDENCE) / len(looks) / 2.0:
        left_out -= 1
    low, high = (ordered[left_out], ordered[n - 1 - left_out]) if left_out >= 0 else (-float("inf"), float("inf"))
    return Estimate(statistics.median(ordered), low, high, n)


def once(action: Callable[[], object]) -> Time:
    """One run of ``action``."""
    gc.collect()
    gc.disable()
    try:
        wall, cpu = time.perf_counter(), time.process_time()
        action()
        return Time(time.process_time() - cpu, time.perf_counter() - wall)
    finally:
        gc.enable()


def _round(actions: Actions) -> dict[str, Time]:
    return {name: once(action) for name, action in actions.items()}
