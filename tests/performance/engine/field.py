"""Section 4: the contest over all constrained problems, each in a process of its own, two at a time."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from hhtbench import load_problem
from hhtbench.protocol import Problem, declared
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.registry import list_problems
from hhtbench.specs import canonical
from tests.performance.engine.contest import ENTRANTS, MINIMAL, NOT_RUN

QUICK = ("jay_negrut_pendulum", "andrews", "knife_edge")
SECONDS = 480.0  # of the whole section with everything compiled
JOBS = 2
GENEROUS = 3.0  # times its part of the time that one problem may take
LEAST = 5.0  # for one problem, so that the last ones are not left out altogether [s]
GRACE = 300.0  # beyond its own limit a process may take for its imports, compilation and the last solve [s]


def measure_field(names: tuple[str, ...] = (), seconds: float = SECONDS) -> list[dict[str, Any]]:
    """The rows of every constrained problem, on the spans that ``hhtbench validate --all`` solves."""
    plan = registered_plans()
    specs = [validated_spec(name, plan) for name in names or list_problems()]
    specs = [spec for spec in specs if _constrained(load_problem(spec))]
    share = Share(seconds, len(specs))
    with ThreadPoolExecutor(JOBS) as pool:
        found = pool.map(lambda spec: _run(spec, share), specs)
        return [row for rows in found for row in rows]


class Share:
    """What is left of the time for solving, for the problems that are left; compilation comes on top of it."""

    def __init__(self, seconds: float, problems: int) -> None:
        self.left, self.problems = JOBS * seconds, problems

    def take(self) -> float:
        """The time of the next problem [s]: several times its part, since most need less."""
        part = GENEROUS * self.left / max(self.problems, 1)
        self.problems -= 1
        return min(max(part, LEAST), self.left)

    def spend(self, seconds: float, rows: list[dict[str, Any]]) -> None:
        """A problem took ``seconds`` with compilation, which every first row of a solver holds."""
        warm = {row["solver"]: (row.get("timing") or {}).get("compile_s") or 0.0 for row in rows}
        self.left -= max(seconds - sum(warm.values()), 0.0)


def _constrained(problem: Problem) -> bool:
    return any(declared(problem.system, name) is not None for name in ("constraint", "velocity_constraint"))


def _run(spec: str, share: Share) -> list[dict[str, Any]]:
    """The rows of one problem; what its process did not tell is told here."""
    seconds = share.take()
    if seconds <= 0:
        return _nothing(spec, NOT_RUN, "the time of the section was up")
    command = [sys.executable, "-m", "tests.performance.engine.contest", spec, f"{seconds:.1f}"]
    started = time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=seconds + GRACE)
    except subprocess.TimeoutExpired:
        return _nothing(spec, "deadline", f"its process was ended after {seconds + GRACE:.0f} s")
    if done.returncode:
        return _nothing(
            spec,
            "crashed",
            f"its process ended with {done.returncode}: {(done.stderr.strip() or 'no message').splitlines()[-1][:300]}",
        )
    rows: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
    share.spend(time.monotonic() - started, rows)
    return rows


def _nothing(spec: str, status: str, message: str) -> list[dict[str, Any]]:
    """A row for every solver that says why there is nothing."""
    request = {"rtol": 1e-2, "atol": None, "step": None, "steps": None}
    names = [name if name.startswith(MINIMAL) else canonical(name) for name in ENTRANTS]
    return [
        {
            "key": f"{spec} {name}",
            "problem": canonical(spec),
            "solver": name.replace("'", ""),
            "request": request,
            "status": status,
            "message": message,
        }
        for name in names
    ]
