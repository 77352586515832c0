"""Section 4: the contest over all constrained problems, each in a process of its own, two at a time."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from hhtbench import load_problem
from hhtbench.analysis.missing import NOT_RUN
from hhtbench.protocol import Problem, declared
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.registry import list_problems
from hhtbench.specs import canonical
from tests.performance.engine.contest import ENTRANTS

QUICK = ("jay_negrut_pendulum", "andrews", "knife_edge")
JOBS = 2
GENEROUS = 3.0  # times its part of the time that one problem may take: most need less
GRACE = 45.0  # beyond its own limit a process may take for its imports, the last compilation and the last solve [s]

Found = dict[str, list[dict[str, Any]]]  # "runs" and "duels"


def measure_field(names: tuple[str, ...], seconds: float) -> Found:
    """The runs of every constrained problem, on the spans that ``hhtbench validate --all`` solves, and the comparisons.

    ``seconds`` are those of the whole on the clock, imports and compilation included.  Small problems come first: what
    they leave goes to the large ones, and where a loaded machine leaves too little, most problems are there all the same.
    """
    plan = registered_plans()
    specs = [validated_spec(name, plan) for name in names or list_problems()]
    loaded = {spec: load_problem(spec) for spec in specs}
    chosen = [spec for spec in specs if _constrained(loaded[spec])]
    share = Share(seconds, len(chosen))
    with ThreadPoolExecutor(JOBS) as pool:
        running = {spec: pool.submit(_run, spec, share) for spec in sorted(chosen, key=lambda spec: loaded[spec].q0.size)}
        found = [running[spec].result() for spec in chosen]
    return {kind: [line for one in found for line in one[kind]] for kind in ("runs", "duels")}


class Share:
    """What is left of the time, for the problems that are left."""

    def __init__(self, seconds: float, problems: int) -> None:
        self.end, self.problems = time.monotonic() + seconds, problems

    def take(self) -> float:
        """The time of the next problem [s]."""
        left = self.end - time.monotonic()
        part = GENEROUS * JOBS * left / max(self.problems, 1)
        self.problems -= 1
        return min(part, left)


def _constrained(problem: Problem) -> bool:
    return any(declared(problem.system, name) is not None for name in ("constraint", "velocity_constraint"))


def _run(spec: str, share: Share) -> Found:
    """The runs of one problem; what its process did not tell is told here."""
    seconds = share.take()
    if seconds <= 0:
        return _nothing(spec, NOT_RUN, "the time of the section was up")
    command = [sys.executable, "-m", "tests.performance.engine.contest", spec, f"{seconds:.1f}"]
    started = time.monotonic()
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=seconds + GRACE)
    except subprocess.TimeoutExpired:
        return _nothing(spec, NOT_RUN, f"its process was ended after {seconds + GRACE:.0f} s")
    sys.stderr.write(f"  {spec}: {time.monotonic() - started:.0f} s\n")
    if done.returncode:
        reason = (done.stderr.strip() or "no message").splitlines()[-1][:300]
        return _nothing(spec, "crashed", f"its process ended with {done.returncode}: {reason}")
    found: Found = json.loads(done.stdout.splitlines()[-1])
    return found


def _nothing(spec: str, status: str, message: str) -> Found:
    """A run for every solver that says why there is nothing."""
    names = [canonical(name).replace("'", "") for name in ENTRANTS]
    why = {"problem": canonical(spec), "request": {"rtol": 1e-2}, "status": status, "message": message}
    return {"runs": [{**why, "solver": name} for name in names], "duels": []}
