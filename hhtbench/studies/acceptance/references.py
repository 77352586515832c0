"""The adapters of other solvers, and what is believed of a result (rows A1 to A3)."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, Verdict, every, row, tested
from hhtbench.studies.acceptance.scenes import PENDULUM, ends

MAIN = "from hhtbench.cli import main; main()"
PATIENCE = 1_800.0  # s for some 220 cases, of which each may take 20 s: few do


@row(
    "A1",
    "the random systems of R8 and the faults of R9, in a process of its own for every solver",
    "no hang, no crash reaches the caller; silent errors are caught",
    long=True,
    gap="the 150 cases of the matrix' table, each in a process of its own",
)
def apart_from_the_caller(asked: Asked) -> Finding:
    """It ends by itself with its outcomes, of which none fails: R8 tells hangs and what is wrong in silence."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "outcomes.json"
        command = [sys.executable, "-c", MAIN, "study", "acceptance", "R8", "R9"]
        command += ["--solver", asked.name, "--json", str(file)]
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return Finding(measured=f"hangs: no end after {PATIENCE:g} s", holds=False)
        if not file.exists():
            last = " ".join(ended.stderr.splitlines()[-1:])
            return Finding(measured=f"crashes: the process ends with {ended.returncode}: {last}", holds=False)
        found = {x["id"]: x for x in json.loads(file.read_text())["outcomes"]}
    told = "; ".join(f"{name} {x['verdict']}: {x['measured']}" for name, x in found.items())
    holds = set(found) == {"R8", "R9"} and all(x["verdict"] == Verdict.holds.name for x in found.values())
    return Finding(measured=told, holds=holds, failing=tuple(case for x in found.values() for case in x["failing"]))


@dataclass
class Lying:
    """A solver whose results are changed before anybody sees them."""

    of: Any
    change: Callable[[hb.Solution], hb.Solution]
    name: str = "lying"

    def accepts(self, problem: hb.Problem, request: hb.Request) -> str | None:
        """What the other says."""
        return self.of.accepts(problem, request)

    def solve(self, problem: hb.Problem, request: hb.Request) -> hb.Solution:
        """What the other finds, changed."""
        return self.change(self.of.solve(problem, request))


def _nan(x: hb.Solution) -> hb.Solution:
    q = x.q.copy()
    q[2, 0] = np.nan
    return replace(x, q=q)


def _constant(x: hb.Solution) -> hb.Solution:
    q, v, lam, mu = (np.repeat(rows[:1], x.t.size, axis=0) for rows in (x.q, x.v, x.lam, x.mu))
    return replace(x, q=q, v=v, lam=lam, mu=mu)


LIES: dict[str, Callable[[hb.Solution], hb.Solution]] = {
    "a value that is not finite": _nan,
    "the last time": lambda x: replace(x, t=x.t * 0.99),
    "off the constraints": lambda x: replace(x, q=x.q + np.linspace(0, 0.1, x.t.size)[:, None] * x.q),
    "off the tangent": lambda x: replace(x, v=x.v + np.linspace(0, 3, x.t.size)[:, None] * x.q),
    "frozen at the start": _constant,
    "one ulp short": lambda x: replace(x, t=np.append(x.t[:-1], np.nextafter(x.t[-1], x.t[0]))),
    "a row is missing": lambda x: replace(x, **{name: getattr(x, name)[:-1] for name in ("t", "q", "v", "lam", "mu")}),
    "rows of another length": lambda x: replace(x, v=x.v[:-1]),
}


@row(
    "A2",
    "results that are not finite, short also by one ulp, off the constraints, off their tangent, frozen, with rows missing",
    "status unreliable",
)
def lies(asked: Asked) -> Finding:
    """Each injected into what the solver returns; as it is it is believed."""
    faults = {}
    for rows, times in {"9 rows": np.linspace(*PENDULUM.problem.t_span, 9), "every step": None}.items():
        for case, change in {"as it is": lambda x: x, **LIES}.items():
            if times is not None or case != "a row is missing":  # of its steps nobody knows how many there must be
                found = hb.solve(PENDULUM.problem, Lying(asked.solver(), change), rtol=1e-6, t_eval=times)
                faults[f"{case}, {rows}"] = ends(found, hb.Status.success if case == "as it is" else hb.Status.unreliable)
    return every(faults)


A3 = tested(
    "A3",
    "agreement of at least three references on each benchmark scene",
    "within 10 tolerances before it counts as reference (`hhtbench validate --all` solves them anew)",
    "tests/problems/test_references.py",
    "tests/reference/test_certify.py",
)
