"""Many cases of one family, drawn by seed, each judged; and the simplest that shows a fault."""

from __future__ import annotations

import warnings
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.cases import Case, Way, World, cases
from tests.fuzz.mechanism import Mechanism, Shape
from tests.fuzz.oracles import judged
from tests.fuzz.runs import Setting, hht
from tests.fuzz.systems import Spoil
from tests.fuzz.twins import compared

NAMES = {kind.__name__: kind for kind in (Case, Mechanism, Shape, Spoil, Way)}
QUIET = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}


class Fault(AssertionError):
    """What a case shows."""


@dataclass
class Explored:
    """What became of the cases."""

    cases: int = 0
    sound: int = 0  #: of which those that must succeed
    ends: Counter = field(default_factory=Counter)  #: statuses
    faults: list[tuple[str, str]] = field(default_factory=list)  #: what is wrong, and the case as text


def faults_of(case: Case, solver=hht, tally: Explored | None = None) -> list[str]:
    """What is wrong with the case's own run, or else with its twin."""
    setting = Setting(case, solver)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = list(judged(setting)) or list(compared(setting))
    if tally is not None:
        tally.cases += 1
        tally.sound += setting.must_succeed
        tally.ends[setting.base.status] += 1
    return found


def explore(
    family: str,
    first: int,
    count: int,
    solver=hht,
    journal: Path | None = None,
    *,
    world: World | None = None,
    stop: bool = False,
    **changes,
) -> Explored:
    """``count`` cases by the seed ``first``, with other fields by ``changes``; every fault is kept, or the first is the end.

    ``journal``: a file that holds the case that runs, for whoever watches the process.
    """
    result = Explored()

    @seed(first)
    @settings(max_examples=count, phases=[Phase.generate], report_multiple_bugs=False, **QUIET)
    @given(cases(family, world or World.drawn(first)))
    def look(case):
        drawn = replace(case, **changes)
        if journal is not None:
            journal.write_text(repr(drawn), encoding="utf-8")
        found = faults_of(drawn, solver, result)
        result.faults += [(fault, repr(drawn)) for fault in found[:1]]
        if stop and found:
            raise Fault(found[0])

    with suppress(Fault):
        look()
    return result


def simplest(family: str, first: int, count: int, solver=hht, journal: Path | None = None) -> tuple[str, str]:
    """What :func:`explore` has met first, in the simplest case that shows a fault; two empty texts: none came again."""
    last = "", ""

    @seed(first)
    @settings(max_examples=count, phases=[Phase.generate, Phase.shrink], report_multiple_bugs=False, **QUIET)
    @given(cases(family, World.drawn(first)))
    def look(case):
        nonlocal last
        if journal is not None:
            journal.write_text(repr(case), encoding="utf-8")
        if found := faults_of(case, solver):
            last = found[0], repr(case)
            raise Fault(found[0])

    with suppress(Fault):
        look()
    return last


def read(text: str) -> Case:
    """A case from its ``repr``."""
    return eval(text, {"__builtins__": {}}, {**NAMES, "inf": float("inf"), "nan": float("nan")})  # one's own words
