"""Entry: the common form of all checks of a solver, with its lane and the outcomes it can have.

An entry has an id, a sentence, what it needs of a solver, and known failures with their reasons.  It is made by one of
three decorators: ``claim`` (here), an assertion that raises ``AssertionError`` if it does not hold;
``row`` (in :mod:`.rows.judging`), a measured value and its bound, or ``tested`` (here) for rows covered by tests;
``family`` (in :mod:`.cell`), cells along a parameter.

All are measured by :meth:`Entry.run`, which returns an :class:`Outcome` and raises nothing.  Known failures are
applied by :func:`as_known`, which is strict: a case that is known to fail and passes is a failure.
"""

from __future__ import annotations

import enum
import inspect
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import ModuleType
from typing import Any
from unittest import SkipTest

from hhtbench.conformance.subject import Subject
from hhtbench.conformance.tests import run_tests_named


class Lane(enum.Enum):
    """The command or test run that measures an entry."""

    fast = "fast"  #: `make test`, and `check_solver`
    slow = "slow"  #: takes longer than tests may: `hhtbench study acceptance` alone
    extremes = "extremes"  #: `hhtbench study stability`; `check_solver(suite="extremes")` takes some cells of each


class Kind(enum.Enum):
    """Outcome class of an entry with a solver; ``letter`` is its short form."""

    right = ("right", "r", "as expected: it arrived, the error as small as is expected")
    named = ("named", "n", "ended early, with a status that says so")
    budget = ("budget", "b", "out of its budget of time or steps")
    warned = ("warned", "m", "arrived with a larger error, whose cause its message names")
    wrong = ("wrong", "W", "not as expected, and it did not say so")
    crashed = ("crashed", "C", "raised an exception, or ended its process")
    hung = ("hung", "H", "ran on beyond its budget and was ended")
    declined = ("declined", "-", "cannot be asked this; it says why")
    in_part = ("in part", "p", "what was measured is as expected, but it is not all of the row")
    elsewhere = ("tests", "e", "held by the tests that are named, which were not run")
    expected = ("fails as expected", "x", "a known failure")
    unexpected = ("passes unexpectedly", "X", "a known failure that no longer fails")

    def __init__(self, label: str, letter: str, text: str) -> None:
        self.label = label
        self.letter = letter
        self.text = text

    @property
    def misleading(self) -> bool:
        """True if a caller could not rely on how it ended: silently wrong, crashed or hung."""
        return self in (Kind.wrong, Kind.crashed, Kind.hung)

    @property
    def good(self) -> bool:
        """True if nothing needs to be mended."""
        return not self.misleading and self is not Kind.unexpected


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a solver in one case of an entry."""

    kind: Kind
    message: str = ""  #: what was measured, how the solve ended, or why it was declined
    id: str = ""  #: id of the entry
    case: str = ""  #: scene of a claim, "line/x" of a family
    solver: str = ""
    failing: tuple[str, ...] = ()  #: cases of a row that are not as expected
    seconds: float = 0.0  #: on the clock, compilation included
    x: float | None = None  #: value of a family's parameter
    line: str = ""  #: what else differs within a family
    status: str = ""  #: how the one solve of a cell ended
    errors: Mapping[str, float] = field(default_factory=dict)  #: errors of a run that arrived, by expectation
    share: float | None = None  #: largest error over what is allowed
    steps: int | None = None
    evaluations: int | None = None


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A measured value and whether it is within its bound."""

    measured: str
    holds: bool
    in_time: bool = True  #: where a row allows so many seconds, which a loaded machine may exceed
    failing: tuple[str, ...] = ()  #: cases that are not as expected, where a row has cases


Known = Mapping[str, tuple[tuple[str, ...], str]]  #: solver -> (cases that fail, or none: the whole entry; the reason)
Measure = Callable[..., Finding | Outcome | None]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One check of a solver; measured by :meth:`run`."""

    id: str  #: "nan/force", "M1", "stiffness"
    sentence: str  #: the claim; for a row the expectation, for a family the source of the expectation
    measure: Measure | None  #: None: held by ``tests`` alone
    needs: tuple[str, ...] = ()  #: abilities that a solver needs, as :meth:`Subject.lacks` knows them
    scenes: tuple[str, ...] = ()  #: scenes of a claim that is made once on each
    parts: tuple[str, ...] = ()  #: parts of a claim that is made once for each
    cells: Callable[[int], Iterable[Any]] | None = None  #: cells of a family, by seed
    lane: Lane = Lane.fast
    known: Known = field(default_factory=dict)  #: failures, strict
    goes_in: str = ""  #: input of a row
    tests: tuple[str, ...] = ()  #: tests that cover a row, as pytest names them
    gap: str = ""  #: part of a row that neither measurement nor tests cover
    parameter: str = ""  #: parameter of a family, with its unit

    def cases(self, seed: int = 0) -> Iterator[tuple[Any, ...]]:
        """Yield the cases of the entry, as arguments of :meth:`run`: none, a scene or part of a claim, or a cell of a
        family.
        """
        if self.cells is not None:
            yield from ((cell,) for cell in self.cells(seed))
        else:
            cases: list[tuple[str, ...]] = [(case,) for case in self.scenes + self.parts]
            yield from cases or [()]

    def name(self, *case: Any) -> str:
        """Return the name of a case's check: "position/order", "nan/force", "stiffness/h = 0.01 s/1e+12", "M1"."""
        return self.id if not case else f"{case[0]}/{self.id}" if self.scenes else f"{self.id}/{case[0]}"

    def run(self, subject: Subject, *case: Any, timed: bool = True, run_tests: bool = False) -> Outcome:
        """Measure one case; an exception becomes its outcome.

        Parameters
        ----------
        subject
            The solver.
        case
            As :meth:`cases` yields it.
        timed
            Whether exceeding a time limit fails a row.
        run_tests
            Run the tests of a row that only tests cover; some take minutes.
        """
        began = time.perf_counter()
        found = self._measured(subject, case, timed, run_tests)
        if self.gap and found.kind in (Kind.right, Kind.elsewhere):
            found = replace(found, kind=Kind.in_part, message=f"{found.message}; not shown: {self.gap}")
        name = str(case[0]) if case else ""
        return replace(found, id=self.id, case=name, solver=subject.name, seconds=time.perf_counter() - began)

    def _measured(self, subject: Subject, case: tuple[Any, ...], timed: bool, run_tests: bool) -> Outcome:
        if self.measure is None:
            kind, message, failing = run_tests_named(self.tests, run_tests)
            return Outcome(kind=Kind[kind], message=message, failing=failing)
        lacking = next(filter(None, map(subject.lacks, self.needs)), "")
        if lacking:
            return Outcome(kind=Kind.declined, message=lacking)
        with warnings.catch_warnings():
            if self.goes_in:
                warnings.simplefilter("ignore")
            return outcome_of(partial(self.measure, subject, *case), timed)

    def known_of(self, subject: Subject) -> tuple[tuple[str, ...], str]:
        """Return the cases that are known to fail with a solver (empty: all) and the reason; "" if none is known."""
        return self.known.get(subject.name) or self.known.get(subject.target) or ((), "")

    def reason(self, subject: Subject, *case: Any) -> str:
        """Return why a case of a claim or family is known to fail; "" if it is not."""
        cases, reason = self.known_of(subject)
        return reason if not cases or (case and str(case[0]) in cases) else ""


def outcome_of(measure: Measure, timed: bool = True) -> Outcome:
    """Turn what a measurement returns or raises into an outcome; ``timed``: a finding that exceeds its time is wrong."""
    try:
        found = measure()
    except SkipTest as declined:
        return Outcome(kind=Kind.declined, message=str(declined))
    except AssertionError as fault:
        return Outcome(kind=Kind.wrong, message=str(fault))
    except Exception as error:  # noqa: BLE001 - whatever is raised, the entry does not hold
        return Outcome(kind=Kind.crashed, message=f"{type(error).__name__}: {error}")
    if isinstance(found, Finding):
        holds = found.holds and (found.in_time or not timed)
        return Outcome(kind=Kind.right if holds else Kind.wrong, message=found.measured, failing=found.failing)
    return found or Outcome(kind=Kind.right)


def as_known(found: Outcome, reason: str, cases: tuple[str, ...] = ()) -> Outcome:
    """Apply a known failure to ``found``: expected if it fails (in just these ``cases``), unexpected if it passes."""
    if not reason or found.kind in (Kind.declined, Kind.elsewhere):
        return found
    passing = set(cases) - set(found.failing)
    if found.kind.good or passing:
        which = f"in {', '.join(sorted(passing))} " if cases else ""
        text = f"it passes, but was expected to fail {which}({reason}); take it out of what is known to fail"
        return replace(found, kind=Kind.unexpected, message=text)
    others = set(found.failing) - set(cases) if cases else ()
    return found if others else replace(found, kind=Kind.expected, message=f"{reason} ({found.message})")


def claim(
    id: str, *scenes: str, parts: Iterable[str] = (), needs: tuple[str, ...] = (), known: Known | None = None
) -> Callable[[Measure], Measure]:
    """Decorator that makes an assertion the claim ``id``; with ``scenes`` or ``parts`` it is run once for each."""

    def register(measure: Measure) -> Any:
        sentence = (inspect.getdoc(measure) or "").partition("\n")[0]
        made = Entry(id=id, sentence=sentence, measure=measure, scenes=scenes, parts=tuple(parts), needs=needs)
        measure.entry = replace(made, known=known or {})  # type: ignore[attr-defined]
        return measure

    return register


def tested(id: str, goes_in: str, expected: str, *tests: str, gap: str = "") -> Entry:
    """Return a row that is covered by tests, except for the ``gap``."""
    return Entry(id=id, sentence=expected, goes_in=goes_in, measure=None, tests=tests, gap=gap)


def entries_of(module: ModuleType) -> list[Entry]:
    """Return the entries of a module in the order in which they are written."""
    found = (getattr(value, "entry", value) for value in vars(module).values())
    return [x for x in found if isinstance(x, Entry)]
