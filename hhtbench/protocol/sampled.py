"""Inputs that are held between samples, as those of digital controllers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector, real_array, real_number, real_values
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.extended import INPUTS, STATES, states_and_inputs

SAME_TIME = 1e-9  # relative to a period: a delay this close to whole periods is that many


@dataclass(frozen=True)
class Sampled:
    """An input that is held between samples, as that of a digital controller.

    Parameters
    ----------
    law
        ``(t, q, v)`` to the input, a number or an array of the shape of ``start``.  JAX does not trace it.  With arguments
        ``x`` and ``u`` it also takes the states (k,) and all inputs as last sampled, such as its own memory.  Of inputs that
        are sampled at one time the first is sampled first.
    every
        Time [s] between samples; the first is at the start.
    delay
        Time [s] from a sample until it acts.
    start
        Input until the first sample acts: a number or (l,).
    name
        Of the events at the samples.
    """

    law: Callable[..., Any]
    every: float
    delay: float = 0.0
    start: Any = 0.0
    name: str = "sample"

    def __post_init__(self) -> None:
        if not callable(self.law):
            raise TypeError(f"the law of a sampled input must be callable as (t, q, v); got {type(self.law).__name__}.")
        if not real_number("every of a sampled input", self.every, unit=" [s]") > 0.0:
            raise ProblemError(f"every of a sampled input must be above 0 s; got {self.every}.")
        if real_number("delay of a sampled input", self.delay, unit=" [s]") < 0.0:
            raise ProblemError(f"delay of a sampled input must be at least 0 s; got {self.delay}.")
        start = real_array("start of a sampled input", self.start)
        if start.ndim > 1:
            raise ProblemError(f"start of a sampled input must be a number or (l,); got shape {start.shape}.")
        object.__setattr__(self, "start", start)

    @property
    def periods(self) -> tuple[int, float]:
        """Whole periods in the delay, and the rest [s]."""
        whole = int(self.delay / self.every + SAME_TIME)
        rest = self.delay - whole * self.every
        return whole, rest if rest > SAME_TIME * self.every else 0.0

    @property
    def waiting(self) -> int:
        """Number of samples that are stored until they act."""
        whole, rest = self.periods
        return whole + (rest > 0.0)

    @property
    def size(self) -> int:
        """Number of entries l."""
        return int(self.start.size)


def sampling_events(inputs: Sequence[Sampled], layout: Any) -> tuple[Event, ...]:
    """The events of extended coordinates, ordered as in ``layout``, that sample the inputs and let them act."""
    held, stored = layout.n + layout.states, layout.n + layout.states + layout.inputs
    places = []  #: of each input: where it acts, and the places through which its samples go, the newest first
    for one in inputs:
        acting = slice(held, held + one.size)
        through = [slice(at, at + one.size) for at in range(stored, stored + one.waiting * one.size, one.size)]
        places.append((acting, through if one.periods[1] > 0.0 else [*through, acting]))
        held, stored = held + one.size, stored + one.waiting * one.size
    newest, found = [through[0] for _, through in places], []
    for one, (acting, through) in zip(inputs, places, strict=True):
        found.append(Event.every(one.every, partial(_sampled, one, through, newest, layout), name=one.name))
        if one.periods[1] > 0.0:
            acts = partial(_acting, acting, through[-1])
            found.append(Event.every(one.every, acts, name=f"{one.name} acts", first=one.delay))
    return tuple(found)


def _sampled(
    one: Sampled, through: list[slice], newest: list[slice], layout: Any, t: float, q: Any, v: Any
) -> tuple[Vector, Vector]:
    """Change of (q, v) by a sample: stored samples move on by one place."""
    q, v = np.array(q), np.asarray(v)
    more = {STATES: layout.x(v), INPUTS: np.concatenate([q[place] for place in newest])}
    taken = {name: more[name] for name in states_and_inputs(one.law, 3)}
    value = real_values(f"the law of {one.name!r}", one.law(t, q[: layout.n], v[: layout.n], **taken))
    if value.shape != one.start.shape:
        raise ProblemError(f"the law of {one.name!r} must return shape {one.start.shape}, as start; got {value.shape}.")
    for place, before in zip(through[:0:-1], through[-2::-1], strict=True):
        q[place] = q[before]
    q[through[0]] = value
    return q, v


def _acting(acting: slice, oldest: slice, t: float, q: Any, v: Any) -> tuple[Vector, Vector]:
    """Change of (q, v) where the oldest stored sample begins to act."""
    q = np.array(q)
    q[acting] = q[oldest]
    return q, np.asarray(v)
