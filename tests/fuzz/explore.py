"""Many cases of one family, drawn by seed, each judged; and the simplest that shows a fault."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, field, replace

from tests.fuzz.cases import Case, Way, World, cases, drawn
from tests.fuzz.mechanism import Mechanism, Shape
from tests.fuzz.oracles import judged
from tests.fuzz.runs import Setting, hht
from tests.fuzz.second import second_opinion
from tests.fuzz.systems import Spoil
from tests.fuzz.twins import compared

NAMES = {kind.__name__: kind for kind in (Case, Mechanism, Shape, Spoil, Way)}


@dataclass
class Explored:
    """What became of the cases."""

    cases: int = 0
    sound: int = 0  #: of which those that must succeed
    ends: Counter = field(default_factory=Counter)  #: statuses
    motion: Counter = field(default_factory=Counter)  #: by what the motions of hostile cases that arrive were judged
    faults: list[tuple[str, str]] = field(default_factory=list)  #: what is wrong, and the case as text


def fault_of(case: Case, solver=hht, tally: Explored | None = None) -> str:
    """What is wrong with the case's own run, or else with its twin; "" for nothing."""
    setting, fault, judge = Setting(case, solver), "", ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            judged(setting)
            compared(setting)
            if case.family == "hostile" and setting.base.solution is not None and setting.base.solution.success:
                judge = second_opinion(setting, setting.base.solution)
        except AssertionError as found:
            fault = str(found)
    if tally is not None:
        tally.cases += 1
        tally.sound += setting.must_succeed
        tally.ends[setting.base.status] += 1
        if judge:
            tally.motion[judge] += 1
        tally.faults += [(fault, repr(case))] if fault else []
    return fault


def explore(family: str, first: int, count: int, solver=hht, *, world=None, begun=None, stop=False, **changes) -> Explored:
    """``count`` cases by the seed ``first``, with other fields by ``changes``; every fault is kept, or the first is the end.

    ``begun(text)`` is told of every case before it is solved, and the first fault then has its simplest case after it.
    """
    result, strategy = Explored(), cases(family, world or World.drawn(first))

    def look(case, tally=None):
        if begun is not None:
            begun(repr(case))
        return fault_of(case, solver, tally)

    for number in range(first, first + count):
        fault = look(replace(drawn(strategy, number), **changes), result)
        if fault and stop:
            break
        if fault and begun is not None and len(result.faults) == 1 and (least := drawn(strategy, number, look)):
            result.faults.append((look(least), repr(least)))
    return result


def read(text: str) -> Case:
    """A case from its ``repr``."""
    return eval(text, {"__builtins__": {}}, {**NAMES, "inf": float("inf"), "nan": float("nan")})  # one's own words
