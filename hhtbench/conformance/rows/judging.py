"""Judge a row from its cases, each a fault or a number with its bound."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Iterator
from functools import partial, wraps
from typing import Any, NamedTuple

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Entry, Finding, Known, Lane
from hhtbench.conformance.subject import Declined, Subject

Cases = Iterator[tuple[str, "str | Number | Declined"]]  # name of a case, and what was found of it; "" is as expected


class Number(NamedTuple):
    """A measured value and the largest allowed one; NaN is too large."""

    value: float
    most: float
    what: str

    def __str__(self) -> str:
        return f"{self.what} {self.value:.3g} of {self.most:g} allowed".strip()


def within(value: Any, most: float, what: str = "off by") -> Number:
    """Return a number that must not be larger than ``most``."""
    return Number(float(value), most, what)


def row(
    id: str,
    goes_in: str,
    expected: str,
    *,
    seconds: float = math.inf,
    most_failing: float = 0.0,
    lane: Lane = Lane.fast,
    gap: str = "",
    known: Known | None = None,
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator that makes a measurement the row ``id`` of its module.

    The function yields its cases, or returns a :class:`Finding`.  A function of two arguments, ``(subject, request)``, is
    called for each request of :meth:`Subject.ways`.  ``seconds``: time limit of each solve on an unloaded machine;
    ``most_failing``: share of the cases that may fail.
    """

    def register(cases: Callable[..., Any]) -> Any:
        collected = partial(_every_way, cases) if len(inspect.signature(cases).parameters) == 2 else cases

        @wraps(cases)
        def measure(subject: Subject) -> Finding:
            found = collected(subject)
            return found if isinstance(found, Finding) else judged(found, subject, seconds, most_failing)

        made = Entry(id=id, sentence=expected, goes_in=goes_in, measure=measure, lane=lane, gap=gap, known=known or {})
        measure.entry, measure.cases = made, collected  # type: ignore[attr-defined]
        return measure

    return register


def fault_of(found: str | Number | Declined) -> str:
    """Return what is wrong with a case, or ""; a declined case is wrong if others are not declined."""
    if isinstance(found, Declined):
        return f"declined: {found}"
    return "" if isinstance(found, Number) and found.value <= found.most else str(found)


def _every_way(cases: Callable[..., Cases], subject: Subject) -> Cases:
    for way, request in subject.ways().items():
        yield from ((f"{case} {way}".strip(), found) for case, found in cases(subject, request))


def judged(cases: Cases, subject: Subject, seconds: float = math.inf, most_failing: float = 0.0) -> Finding:
    """Judge all cases: number as expected, largest numbers of each kind, and the first two faults.

    ``most_failing``: share of the cases that may fail.
    """
    subject.took.clear()
    found = dict(cases)
    declined = [x for x in found.values() if isinstance(x, Declined)]
    if declined and len(declined) == len(found):
        raise declined[0]
    faults = {case: text for case, x in found.items() if (text := fault_of(x))}
    slowest = max(subject.took, default=0.0)
    numbers = [x for x in found.values() if isinstance(x, Number)]
    largest = {(x.most, x.what): x for x in sorted(numbers, key=lambda x: x.value)}
    texts = [f"{len(found) - len(faults)} of {len(found)} cases", *map(str, largest.values())]
    texts += [f"slowest {slowest:.2g} s of {seconds:g} allowed"] * math.isfinite(seconds)
    texts += [f"{case}: {fault}".strip(": ") for case, fault in list(faults.items())[:2]]
    holds = bool(found) and len(faults) <= most_failing * len(found)
    return Finding(measured="; ".join(texts), holds=holds, in_time=slowest <= seconds, failing=tuple(faults))


def ends(solution: hb.Solution, *expected: hb.Status, words: tuple[str, ...] = ()) -> str:
    """Return "" if the status is one of ``expected`` and message or diagnosis contain the ``words``; else the fault."""
    if solution.status not in expected:
        return f"ends with {solution.status.label}: {solution.message[:90]}"
    text = f"{solution.message} {solution.diagnose()}" if words else ""
    missing = [word for word in words if word not in text]
    return f"{solution.status.label} does not name {', '.join(missing)}: {solution.message[:90]}" if missing else ""


def arrives(solution: hb.Solution) -> str:
    """Return "" if the solve succeeded; else the fault."""
    return ends(solution, hb.Status.success)


def warns(solve: Callable[[], hb.Solution], *words: str) -> str:
    """Return "" if a warning or the message contains one of the ``words``; else the fault."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        texts = [solve().message, *(str(x.message) for x in caught)]
    return "" if any(word in text for word in words for text in texts) else f"no warning: {texts[0][:90]}"


def refuses(call: Callable[[], Any], *words: str, kinds: tuple[type[BaseException], ...] = (ValueError, TypeError)) -> str:
    """Return "" if ``call`` raises one of ``kinds`` with one of the ``words``; else the fault."""
    try:
        call()
    except Declined:
        raise
    except kinds as error:
        return "" if not words or any(word in str(error) for word in words) else f"{type(error).__name__}: {str(error)[:90]}"
    return "accepted"


def same(one: hb.Solution, other: hb.Solution) -> str:
    """Return "" if two solutions are bitwise equal; else the fault."""
    equal = all(getattr(one, x).tobytes() == getattr(other, x).tobytes() for x in ("t", "q", "v", "lam", "mu"))
    return "" if equal else f"other bits, off by {apart(one, other):.1e}"


def apart(one: hb.Solution, other: hb.Solution) -> float:
    """Return the largest difference of q and v at the last rows; infinite if one did not arrive."""
    if not (one.success and other.success):
        return np.inf
    return float(max(np.abs(one.q[-1] - other.q[-1]).max(), np.abs(one.v[-1] - other.v[-1]).max()))
