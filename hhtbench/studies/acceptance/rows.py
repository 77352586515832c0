"""A row of the matrix: what goes in, what is expected, how it is measured, and what came of it."""

from __future__ import annotations

import enum
import importlib.util
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import SkipTest

from hhtbench.studies.acceptance.asked import Asked

CORE = {
    *("M1", "M2", "M3", "M6", "M7", "M8", "M9", "M11", "M12", "M14"),
    *("I1", "I3", "I4", "I5", "I6", "I8"),
    *("C1", "C2", "C3", "C6", "C8", "C9", "C10", "C11"),
    *("O1", "O5", "O6", "S1", "S2", "S3", "S4", "S6", "S8", "S9"),
    *("P1", "P2", "P3", "P4", "P5", "P8", "P11", "P12", "P13"),
    *("J1", "J2", "J3", "E1", "R1", "R3", "R5", "R6", "R7", "R8", "R9"),
    *("A1", "A2", "K1", "K2", "K3", "K4", "K6", "K8"),
}


class Verdict(enum.Enum):
    """What became of one row with one solver."""

    holds = "holds"
    fails = "FAILS"
    undecided = "-"  #: the solver cannot be asked this; the measured text says why
    elsewhere = "tests"  #: by the tests that the measured text names, which were not run
    in_part = "in part"  #: what was looked at holds, but is not all of the row: the measured text says what is not shown


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a measurement found."""

    measured: str
    holds: bool
    in_time: bool = True  #: where a row allows so many seconds, which a loaded machine may exceed
    failing: tuple[str, ...] = ()  #: cases that do not behave as expected, where a row has cases


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A row with one solver."""

    id: str
    solver: str  #: the column
    measured: str
    verdict: Verdict
    seconds: float
    failing: tuple[str, ...] = ()  #: cases of the row, where it has cases


PATIENCE = 1800.0  # [s] for the tests of a row

Measure = Callable[[Asked], Finding]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row; it is measured by :meth:`outcome`."""

    id: str
    goes_in: str
    expected: str
    measure: Measure | None  #: None: by ``tests`` alone
    tests: tuple[str, ...] = ()  #: that hold the row, as pytest names them
    gap: str = ""  #: what of the matrix' row neither measurement nor tests show
    long: bool = False  #: takes longer than tests may

    def outcome(self, asked: Asked, *, timed: bool = True, run_tests: bool = False) -> Outcome:
        """Measure the row with a solver; what a measurement raises fails it, and being late where it is ``timed``.

        ``run_tests``: run the tests of a row that they alone hold; some take minutes.
        """
        began = time.perf_counter()
        if self.measure is None:
            measured, verdict, failing = _by_tests(self.tests, run_tests)
        else:
            measured, verdict, failing = _measured(self.measure, asked, timed)
        if self.gap and verdict in (Verdict.holds, Verdict.elsewhere):
            measured, verdict = f"{measured}; not shown: {self.gap}", Verdict.in_part
        seconds = time.perf_counter() - began
        return Outcome(id=self.id, solver=asked.name, measured=measured, verdict=verdict, seconds=seconds, failing=failing)


def _by_tests(tests: tuple[str, ...], run: bool) -> tuple[str, Verdict, tuple[str, ...]]:
    """What pytest says of them; they come with a clone, not with an installed package.  Skipped ones show nothing."""
    root, named = Path(__file__).parents[3], ", ".join(tests)
    there = all((root / test.partition("::")[0]).is_file() for test in tests) and importlib.util.find_spec("pytest")
    if not (run and there):
        return named, Verdict.elsewhere, ()
    asked = [sys.executable, "-m", "pytest", "-q", "-ra", "-m", "", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(asked, cwd=root, capture_output=True, text=True, check=False, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f"not over after {PATIENCE:g} s: {named}", Verdict.fails, tests
    told = (done.stdout.strip() or done.stderr.strip() or "pytest said nothing").splitlines()
    verdict = Verdict.fails if done.returncode else Verdict.in_part if "skipped" in told[-1] else Verdict.holds
    skipped = "".join(f"; not shown: {line}" for line in told if line.startswith("SKIPPED "))
    failing = tuple(line.split()[1] for line in told if line.startswith(("FAILED ", "ERROR ")))
    return f"{told[-1].strip('= ')}: {named}{skipped}", verdict, failing


def _measured(measure: Measure, asked: Asked, timed: bool) -> tuple[str, Verdict, tuple[str, ...]]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = measure(asked)
    except SkipTest as declined:
        return str(declined), Verdict.undecided, ()
    except Exception as error:  # noqa: BLE001  any exception is a finding
        return f"{type(error).__name__}: {error}", Verdict.fails, ()
    holds = found.holds and (found.in_time or not timed)
    return found.measured, Verdict.holds if holds else Verdict.fails, found.failing


def row(id: str, goes_in: str, expected: str, *, long: bool = False, gap: str = "") -> Callable[[Measure], Measure]:
    """Make a measurement the row ``id`` of its module."""

    def register(measure: Measure) -> Any:
        found = Row(id=id, goes_in=goes_in, expected=expected, measure=measure, long=long, gap=gap)
        measure.row = found  # type: ignore[attr-defined]
        return measure

    return register


def tested(id: str, goes_in: str, expected: str, *tests: str, gap: str = "") -> Row:
    """A row that tests of their own hold, but for the ``gap``."""
    return Row(id=id, goes_in=goes_in, expected=expected, measure=None, tests=tests, gap=gap)


def rows_of(module: ModuleType) -> list[Row]:
    """Of a section, in the order in which they are written."""
    found = (getattr(value, "row", value) for value in vars(module).values())
    return [x for x in found if isinstance(x, Row)]


def bounded(value: float, bound: float, what: str = "") -> Finding:
    """A number that must not be larger than ``bound``; NaN is."""
    return Finding(measured=f"{what} {value:.2g} of {bound:g} allowed".strip(), holds=bool(value <= bound))


def every(faults: Mapping[str, str], also: str = "", *, in_time: bool = True) -> Finding:
    """Cases with the fault of each, "" where it behaves as expected: how many do, and the first two that do not."""
    wrong = {case: fault for case, fault in faults.items() if fault}
    told = "; ".join(f"{case}: {fault}" for case, fault in list(wrong.items())[:2])
    parts = [f"{len(faults) - len(wrong)} of {len(faults)} cases", also, told]
    holds = not wrong and bool(faults)
    return Finding(measured="; ".join(filter(None, parts)), holds=holds, in_time=in_time, failing=tuple(wrong))
