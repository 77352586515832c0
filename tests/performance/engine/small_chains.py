"""Section 3: time per step beside Exudyn on small planar chains, at Exudyn's fastest settings for them.

The chain is that of :mod:`tests.performance.chain`.  There Exudyn's steps are marked by a user function before each of them;
here a step takes microseconds, so whole runs are timed, and a short one is subtracted: what begins and ends a run counts on
neither side.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from problems import planar_chain
from tests.performance import chain
from tests.performance.engine.clock import Time, in_turn
from tests.performance.engine.ours import constant_steps

LINKS = {1: 0.25, 10: 0.5}  # limits of the ratio
H = 1e-4  # [s]
STEPS = 4000
SHORT = 10  # of the steps, in the run that is subtracted
FINER = 16  # steps of the reference in one
SAME_ERROR = 1.5  # ratio of errors up to which ours counts as not larger
REPEATS = 5
ALPHA = (chain.RHO - 1.0) / (chain.RHO + 1.0)


def measure_chains() -> list[dict[str, Any]]:
    """One line a chain."""
    return [_line(links, limit) for links, limit in LINKS.items()]


def _line(links: int, limit: float) -> dict[str, Any]:
    problem = planar_chain.problem(n_links=links)
    line: dict[str, Any] = {"links": links, "h": H, "steps": STEPS, "limit": limit, "note": ""}
    own = lambda steps: constant_steps(problem, H, steps, alpha=ALPHA, b=0.0)  # noqa: E731
    reached = own(STEPS).q[-1]
    actions: dict[str, Any] = {"ours": lambda: own(STEPS), "ours short": lambda: own(STEPS // SHORT)}
    if chain.exudyn is None:
        found = _per_step(in_turn(actions, REPEATS))
        missing = dict.fromkeys(("theirs_s", "ratio", "clock_ratio", "error", "their_error", "solver", "holds"))
        return {**line, **missing, "ours_s": found["ours"].cpu, "note": "exudyn is not installed"}
    reference = constant_steps(problem, H / FINER, STEPS * FINER, alpha=ALPHA, b=0.0).q[-1]
    for name in ("EXUdense", "EigenDense", "EigenSparse"):
        actions |= {name: lambda name=name: _theirs(links, name, STEPS)}
        actions |= {f"{name} short": lambda name=name: _theirs(links, name, STEPS // SHORT)}
    found = _per_step(in_turn(actions, REPEATS))
    best = min((name for name in found if name != "ours"), key=lambda name: found[name].cpu)
    errors = [float(np.abs(q - reference).max()) for q in (reached, _theirs(links, best, STEPS).q)]
    ratio = found["ours"].cpu / found[best].cpu
    return {
        **line,
        "ours_s": found["ours"].cpu,
        "theirs_s": found[best].cpu,
        "ratio": ratio,
        "clock_ratio": found["ours"].wall / found[best].wall,
        "error": errors[0],
        "their_error": errors[1],
        "solver": best,
        "others": {name: time.cpu for name, time in found.items() if name not in ("ours", best)},
        "holds": bool(ratio <= limit and errors[0] <= SAME_ERROR * errors[1]),
    }


def _theirs(links: int, solver: str, steps: int) -> chain.Theirs:
    """The chain after ``steps`` steps of Exudyn; nothing is written, nobody is called in between."""
    theirs = chain.Theirs(links, H, steps)
    theirs.settings.linearSolver.solverType = getattr(chain.exudyn.LinearSolverType, solver)  # type: ignore[attr-defined]
    if not chain.exudyn.MainSolverImplicitSecondOrder().SolveSystem(theirs.mbs, theirs.settings):
        raise RuntimeError("Exudyn did not finish")
    return theirs


def _per_step(found: dict[str, Time]) -> dict[str, Time]:
    """Long runs less short ones."""
    steps = STEPS - STEPS // SHORT
    pairs = {name: (time, found[f"{name} short"]) for name, time in found.items() if not name.endswith(" short")}
    return {n: Time((long.cpu - short.cpu) / steps, (long.wall - short.wall) / steps) for n, (long, short) in pairs.items()}
