"""Times of several actions, taken in turn so that all see the same machine."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Time:
    """Medians over the repeats [s]."""

    cpu: float  #: processor time, all threads together: on an idle core the time on the clock
    wall: float  #: on the clock


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


def in_turn(actions: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, Time]:
    """Medians of ``repeats`` rounds, each with every action once."""
    taken: dict[str, list[Time]] = {name: [] for name in actions}
    for _ in range(repeats):
        for name, action in actions.items():
            taken[name].append(once(action))
    return {name: median(times) for name, times in taken.items()}


def median(times: list[Time]) -> Time:
    """Of each clock by itself."""
    return Time(statistics.median(t.cpu for t in times), statistics.median(t.wall for t in times))
