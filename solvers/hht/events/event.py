"""Events: what a user declares, and the sign changes of its function along one step's dense output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from hhtbench.arguments import Matrix, Vector, positive_integer, real_values
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue, ProblemError
from solvers.hht.dense import HermiteOutput

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)
CLOSE = 4.0  # spacings of floating-point times within which an event is at the end of a step
ZERO = 1e-12  # of the largest value in the step: what a start on the zero of an event function may be off
LEAVING = 1e-8  # of the step after a start or a change: there the side that the motion leaves to is looked up


@dataclass(frozen=True)
class Event:
    """A zero of a function of the state, looked for along the motion.

    The function is sampled at the end of each step and at ``samples`` points within it; a change of sign between two of
    these is an event.  So two zeros in one step are found where a sample lies between them; a zero without a change
    of sign is found only if a sample meets it.  A motion that begins on a zero has no event there; one that ends on a
    zero has.  A function that jumps is fine.

    Where an event neither stops the integration nor changes the state, its time is a zero along the dense output, and its
    state the dense output's.  Where it does, the step is taken again with the length at which the function is zero at the
    step's own end (or has just crossed it), to the last bits of time: the state there is as good as at every step.

    Parameters
    ----------
    function
        ``(t, q, v)`` with q, v (n,) to a number.  The native engine compiles one that JAX can trace and that refers to
        nothing that changes; any other keeps the steps in the host engine.
    direction
        1: only zeros with a rising function, along the integration, so also where time runs backward; -1: falling; 0: both.
    terminal
        True: the first occurrence stops the integration; a whole number: so does that one, and later ones where
        stepping goes on.
    change
        ``(t, q, v)`` to a new ``(q, v)``, an impact, say.  It is projected onto both levels of the constraints in the norm
        of the mass matrix, (H20), and the integration begins anew there, with new multipliers and step control.  Where
        several events change the state at one time they do so in the order in which they were given.  Changes that pile
        up at one time, as those of a ball that comes to rest, end the run with a status: let the change end the motion
        there instead, or make the event terminal.
    name
        For messages; the function's own name without one.
    samples
        Points within a step at which the function is looked at; where nothing else keeps steps short, ``max_step`` does.
    """

    function: Callable[..., Any]
    direction: int = 0
    terminal: bool | int = False
    change: Callable[..., Any] | None = None
    name: str = ""
    samples: int = 4

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise TypeError(f"an event's function must be callable as (t, q, v); got {type(self.function).__name__}.")
        if self.change is not None and not callable(self.change):
            raise TypeError(f"an event's change must be callable as (t, q, v); got {type(self.change).__name__}.")
        if isinstance(self.direction, bool) or self.direction not in (-1, 0, 1):
            raise ProblemError(f"an event's direction must be -1 (falling), 0 (both) or 1 (rising); got {self.direction!r}.")
        if not isinstance(self.terminal, (bool, np.bool_)):
            positive_integer("an event's terminal (True, False, or the number of the occurrence)", self.terminal)
        if not isinstance(self.name, str):
            raise TypeError(f"an event's name must be a string; got {self.name!r}.")
        positive_integer("an event's samples", self.samples)

    def ends(self, count: int) -> bool:
        """Whether occurrence number ``count`` stops the integration."""
        return bool(self.terminal) and count >= int(self.terminal)


@dataclass(frozen=True)
class Occurrence:
    """One event as it occurred."""

    index: int  #: in the list of events
    name: str
    t: float  #: [s]
    q: Vector  #: (n,) before a change
    v: Vector  #: (n,) before a change


@dataclass(frozen=True)
class Crossing:
    """A change of sign along the dense output of a step."""

    index: int  #: of the event
    t: float  #: [s]
    side: int  #: sign of the function before it
    bracket: tuple[float, float]  #: [s], samples around it


@dataclass(frozen=True)
class Scan:
    """What one step's dense output tells of the events."""

    crossings: tuple[Crossing, ...]  #: in order of time, those at one time in the order of the events
    values: Vector  #: (k,) event functions at the end of the step


def make_events(given: Any) -> tuple[Event, ...]:
    """Events from what the user gave: None, one, or several; each an :class:`Event` or a plain callable.

    A plain callable may carry SciPy's attributes ``direction`` and ``terminal``; nothing is written to it.

    Raises
    ------
    ProblemError, TypeError
        One is neither callable nor an Event, or its attributes are out of range.
    """
    listed = [] if given is None else list(given) if isinstance(given, (list, tuple)) else [given]
    return tuple(_named(_event(f"events[{i}]", one), f"events[{i}]") for i, one in enumerate(listed))


def _event(place: str, given: Any) -> Event:
    if isinstance(given, Event):
        return given
    if not callable(given):
        raise TypeError(f"{place} must be an Event or a callable (t, q, v); got {type(given).__name__}.")
    direction = np.sign(getattr(given, "direction", 0))
    return Event(given, direction=int(direction), terminal=getattr(given, "terminal", False) or False)


def _named(event: Event, place: str) -> Event:
    own = getattr(event.function, "__name__", "<lambda>")
    return event if event.name else replace(event, name=place if own == "<lambda>" else own)


def value_of(event: Event, t: float, q: Vector, v: Vector, work: Work) -> float:
    """The event function at one point.

    Raises
    ------
    NonFiniteValue
        It is NaN or infinite.
    TypeError
        It is no number.
    """
    work.add("event_evaluations")
    got = event.function(t, _read_only(q), _read_only(v))
    array = np.asarray(got)
    if array.ndim != 0 or array.dtype.kind not in "fiu":
        what = f"an array of shape {array.shape}" if array.ndim else repr(got)
        raise TypeError(f"event {event.name!r} must return one real number that changes its sign at the event; got {what}.")
    value = float(array)
    if not np.isfinite(value):
        raise NonFiniteValue(f"event {event.name!r}", (), value, t)
    return value


def changed_by(event: Event, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
    """The new (q, v) of an event with a change.

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
        if not np.isfinite(new).all():
            i = int(np.argmin(np.isfinite(new)))
            raise NonFiniteValue(f"{name} from {whose}", (i,), float(new[i]), t)
    return pair


def scan(events: Sequence[Event], start: Vector | None, output: HermiteOutput, work: Work) -> Scan:
    """The changes of sign along ``output``, which is one step.

    ``start`` (k,) are the values at its beginning; None after a start or a change: there a value near zero counts as
    zero, and the motion leaves it without an event.
    """
    found: list[Crossing] = []
    ends = np.zeros(len(events))
    for index, event in enumerate(events):
        times, values = _sampled(event, None if start is None else float(start[index]), output, work)
        found += _crossings(index, event, times, values, output, work)
        ends[index] = values[-1]
    direction = 1.0 if output.t[-1] > output.t[0] else -1.0
    return Scan(tuple(sorted(found, key=lambda crossing: direction * crossing.t)), ends)


def _sampled(event: Event, start: float | None, output: HermiteOutput, work: Work) -> tuple[Vector, Vector]:
    """Times along the step and values there; the first, at its beginning, is zero where the motion begins on a zero."""
    t0, t1 = output.t
    shares = np.arange(1, event.samples + 1) / (event.samples + 1)
    times = t0 + np.concatenate([[0.0], [LEAVING] if start is None else [], shares, [1.0]]) * (t1 - t0)
    times[-1] = t1
    states: tuple[Matrix, Matrix] = output(times)
    first = 0 if start is None else 1
    values = [value_of(event, float(times[i]), states[0][i], states[1][i], work) for i in range(first, times.size)]
    if start is not None:
        return times, np.array([start, *values])
    if abs(values[0]) <= ZERO * max(abs(x) for x in values):
        values[0] = 0.0
    return times, np.array(values)


def _crossings(index: int, event: Event, times: Vector, values: Vector, output: HermiteOutput, work: Work) -> list[Crossing]:
    """Where the sign changes, or zero is reached, in the direction asked for."""
    found = []
    side = int(np.sign(values[0]))
    for i in range(1, times.size):
        now = int(np.sign(values[i]))
        if side != 0 and now != side and event.direction in (0, -side):
            bracket = float(times[i - 1]), float(times[i])
            t = bracket[1] if now == 0 else _zero(event, bracket, (values[i - 1], values[i]), output, work)
            t = float(output.t[-1]) if near(t, float(output.t[-1])) else t
            found.append(Crossing(index, t, side, bracket))
        side = now
    return found


def _zero(event: Event, bracket: tuple[float, float], ends: tuple[float, float], output: HermiteOutput, work: Work) -> float:
    """The zero of the event function along ``output``, to the last bits of time."""
    known = dict(zip(bracket, ends, strict=True))

    def value(t: float) -> float:
        return known[t] if t in known else value_of(event, t, *output(t), work)

    return zero(value, *bracket)


def zero(value: Callable[[float], float], low: float, high: float) -> float:
    """A time between ``low`` and ``high`` at which ``value`` changes its sign, to the last bits."""
    return float(
        brentq(value, low, high, xtol=max(float(np.spacing(abs(high))), TINY), rtol=4 * EPS, maxiter=200, disp=False)
    )


def near(t: float, end: float) -> bool:
    """Whether the two times are one but for roundoff."""
    return abs(t - end) <= CLOSE * float(np.spacing(abs(end)))


def _read_only(x: Vector) -> Vector:
    copy = np.array(x)
    copy.setflags(write=False)
    return copy
