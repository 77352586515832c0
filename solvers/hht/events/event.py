"""Occurrences of events, and values and changes that their functions return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhtbench.protocol.arguments import Vector, real_values
from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers._finite import expect_finite


@dataclass(frozen=True)
class Occurrence:
    """One occurrence of an event."""

    index: int  #: in the list of events
    name: str
    t: float  #: [s]
    q: Vector  #: (n,) before a change
    v: Vector  #: (n,) before a change
    note: str = ""  #: constraint violation, if the state could not be projected onto the constraints


def number_of(event: Event, t: float, q: Vector, v: Vector) -> float:
    """Value of the event function at one point.

    Raises
    ------
    NonFiniteValue
        It is NaN or infinite.
    TypeError
        It is no number.
    """
    got = event.function(t, _read_only(q), _read_only(v))
    array = np.asarray(got)
    if array.ndim != 0 or array.dtype.kind not in "fiu":
        what = f"an array of shape {array.shape}" if array.ndim else repr(got)
        raise TypeError(f"event {event.name!r} must return one real number that changes its sign at the event; got {what}.")
    value = float(array)
    if not np.isfinite(value):
        raise NonFiniteValue(f"event {event.name!r}", (), value, t)
    return value


def value_of(event: Event, t: float, q: Vector, v: Vector, work: Work) -> float:
    """:func:`number_of`, with the evaluation counted."""
    work.add("event_evaluations")
    return number_of(event, t, q, v)


def changed_by(event: Event, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
    """The new (q, v) that the event's change returns.

    Raises
    ------
    NonFiniteValue
        An entry is NaN or infinite.
    ProblemError, TypeError
        It is no pair of vectors (n,).
    """
    whose = f"the change of event {event.name!r}"
    got = event.change(t, _read_only(q), _read_only(v))  # type: ignore[misc]
    if not isinstance(got, (tuple, list)) or len(got) != 2:
        raise TypeError(f"{whose} must return (q, v), two vectors ({q.size},); got {type(got).__name__}.")
    pair = real_values(f"{whose}: q", got[0]), real_values(f"{whose}: v", got[1])
    for name, new in zip("qv", pair, strict=True):
        if new.shape != q.shape:
            raise ProblemError(f"{whose} must return {name} of shape {q.shape}; got {new.shape}.")
        expect_finite(f"{name} from {whose}", new, t)
    return pair


def _read_only(x: Vector) -> Vector:
    copy = np.array(x)
    copy.setflags(write=False)
    return copy
