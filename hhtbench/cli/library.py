"""Check every registered problem in worker processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import replace

from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.checks.problem import check
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.runtime.processes import worker_processes


def check_all(
    jobs: int, tell: Callable[[str], None] = lambda text: None, progress: Callable[[str, int, int], None] = lambda *_: None
) -> Evidence:
    """Check every registered problem in worker processes; row ids are preceded by the problem's name.

    ``tell`` receives one line per problem, ``progress`` the number checked and the number in all.
    A problem that cannot be loaded gives one failing row.
    """
    began, found = time.perf_counter(), {}
    with worker_processes(jobs) as pool:
        waiting = {pool.submit(_check_one, name): name for name in list_problems()}
        progress("problems", 0, len(waiting))
        for done in as_completed(waiting):
            name = waiting[done]
            found[name] = done.result()
            wrong = [row.id for row in found[name].rows if row.passed is False]
            tell(f"{found[name].summary} ({found[name].seconds:.1f} s)" + (f": {', '.join(wrong)}" if wrong else ""))
            progress("problems", len(found), len(waiting))
    rows = [
        replace(row, id=f"{name}/{row.id}", claim=f"{name}: {row.claim}")
        for name, evidence in sorted(found.items())
        for row in evidence.rows
    ]
    return Evidence(title="check of all problems", rows=tuple(rows), seconds=time.perf_counter() - began)


def _check_one(name: str) -> Evidence:
    try:
        return check(load_problem(name))
    except Exception as error:  # noqa: BLE001 - whatever one problem's file raises, the others are checked
        text = f"{type(error).__name__}: {error}"
        row = Row(id="made", claim="the problem can be made", measured=text, bound="made", passed=False)
        return Evidence(title=f"check of {name}", rows=(row,), seconds=0.0)
