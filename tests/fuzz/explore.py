"""Cases of one family, drawn by seed and judged."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from tests.fuzz.cases import Case, drawn
from tests.fuzz.oracles import judged
from tests.fuzz.runs import Setting, hht
from tests.fuzz.second import second_opinion
from tests.fuzz.twins import compared


class Verdict(NamedTuple):
    """What became of a case."""

    seed: int
    status: str
    must_succeed: bool
    fault: str  #: of the case's own run, or else of what it is compared with; "" without


def verdict(seed: int, case: Case, solver=hht) -> Verdict:
    """Of one case."""
    setting, fault = Setting(case, solver), ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            judged(setting)
            compared(setting)
            if case.family == "hostile" and setting.base.solution is not None and setting.base.solution.success:
                second_opinion(setting, setting.base.solution)
        except AssertionError as found:
            fault = str(found)
        return Verdict(seed, setting.base.status, setting.must_succeed, fault)


def explore(family: str, first: int, count: int, solver=hht, **changes: str) -> Iterator[Verdict]:
    """``count`` cases from the seed ``first`` on, with other fields by ``changes``."""
    for seed in range(first, first + count):
        yield verdict(seed, replace(drawn(family, seed), **changes), solver)
