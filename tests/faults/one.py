"""``python -m tests.faults.one CHECKED FIRST`` in a copy of the tree: the checks up to the first that fails, as JSON."""

from __future__ import annotations

import json
import resource
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import hhtbench
from hhtbench.conformance import Check, check_problem, check_solver
from hhtbench.conformance.scenes import SCENES
from hhtbench.runtime.processes import one_blas_thread
from tests.conformance.claims import claims_of
from tests.faults.loops import STALE, follow_the_sources

SECONDS = 75  # of processor time: a fault may make a loop endless; without one all checks take a third of it


class Failures:
    """A plugin of pytest's: how many tests ran, and the first that failed."""

    def __init__(self) -> None:
        self.count, self.first = 0, {"flagged": "", "message": ""}

    def pytest_runtest_logreport(self, report: Any) -> None:
        """One phase of a test."""
        self.count += report.when == "call"
        if report.failed and not self.first["flagged"]:
            self.first = {"flagged": report.nodeid, "message": report.longreprtext.strip().splitlines()[-1]}

    def pytest_collectreport(self, report: Any) -> None:
        """A file that cannot be read."""
        if report.failed and not self.first["flagged"]:
            self.first = {"flagged": report.nodeid, "message": report.longreprtext.strip().splitlines()[-1]}


def checks_of(checked: str) -> Iterator[Check]:
    """Those that a fault names."""
    kind, _, name = checked.partition(":")
    if kind == "problem":
        return check_problem(name)
    if kind == "scene":
        return check_problem(SCENES[name]().problem)
    return check_solver(checked, **claims_of(checked))


def first_failed_check(checked: str, first: str) -> dict[str, Any]:
    """What ``main`` prints of checks; those whose names begin with ``first`` come first."""
    count, found = 0, {"flagged": "", "message": ""}
    try:
        for check in sorted(checks_of(checked), key=lambda check: not check.name.startswith(first)):
            outcome, count = check.run(), count + 1
            if not outcome.kind.good:
                found = {"flagged": outcome.id, "message": outcome.message}
                break
    except Exception as error:  # noqa: BLE001 - a fault may break what comes before the checks: that is found too
        found = {"flagged": "before the checks", "message": f"{type(error).__name__}: {error}"}
    return {**found, "checks": count}


def first_failed_test(files: str, chosen: str) -> dict[str, Any]:
    """The same of the tests in ``files`` whose names hold one of the words ``chosen``, as pytest's ``-k``."""
    failures = Failures()
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", *(["-k", chosen] if chosen else [])]
    pytest.main([*files.split(), *options], plugins=[failures])
    return {**failures.first, "checks": failures.count}


def main(checked: str, first: str) -> None:
    """Print {"flagged": name, "message": text, "checks": how many ran, "unsound": why that says nothing}."""
    one_blas_thread()
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    warnings.simplefilter("ignore")
    follow_the_sources()
    root = Path(hhtbench.__file__).parent.parent
    if root != Path.cwd():
        raise SystemExit(f"hhtbench was imported from {root}, not from {Path.cwd()}")
    kind, _, files = checked.partition(":")
    found = first_failed_test(files, first) if kind == "tests" else first_failed_check(checked, first)
    nothing = "" if found["checks"] or found["flagged"] else "nothing was checked"
    stale = f"a loop that is not of its sources is no find: {found['message']}" if STALE in found["message"] else ""
    print(json.dumps({**found, "unsound": nothing or stale}))  # noqa: T201


if __name__ == "__main__":
    main(*sys.argv[1:])
