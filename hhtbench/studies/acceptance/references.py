"""The adapters of other solvers, and what is believed of a result (rows A1 to A3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, every, row, tested
from hhtbench.studies.acceptance.scenes import PENDULUM, ends

A1 = tested(
    "A1",
    "the same hostile cases through every adapter",
    "no hang, no crash reaches the caller; silent errors are caught",
    "the other rows' columns, and tests/testing/test_solvers.py (hhtbench.testing.check_solver on every solver)",
    gap="the 150 cases as such, each in a process of its own; only the fast rows of hht and ida are asked by the tests",
)


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
    "within 10 tolerances before it counts as reference",
    "tests/problems/test_references.py, tests/reference/test_certify.py, `hhtbench validate --all`",
)
