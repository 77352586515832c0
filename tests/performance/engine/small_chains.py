"""Section 3: time per step beside Exudyn on small planar chains, at Exudyn's fastest settings for them.

The chain is that of :mod:`tests.performance.chain`.  There whole solves are compared; here a short run is subtracted from a
long one: what begins and ends a run counts on neither side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from problems import planar_chain
from tests.performance import chain
from tests.performance.engine.clock import BROKEN, Compared, compare, unmeasured
from tests.performance.engine.ours import constant_steps

LIMITS = {1: 0.25, 10: 0.5}  # of the ratio, by links
H = 1e-4  # [s]
STEPS = {1: 20_000, 10: 4000}  # by links: so many that the start is a small part
SHORT = 10  # the part of the steps in the run that is subtracted is one in so many
SOLVERS = ("EXUdense", "EigenDense", "EigenSparse")
FINER = 16  # steps of the reference in one
SAME_ERROR = 1.5  # ratio of errors up to which ours counts as not larger
ALPHA = (chain.RHO - 1.0) / (chain.RHO + 1.0)


def measure_chains() -> list[dict[str, Any]]:
    """One line a chain."""
    return [_line(links, limit) for links, limit in LIMITS.items()]


def _line(links: int, limit: float) -> dict[str, Any]:
    problem, steps = planar_chain.problem(n_links=links), STEPS[links]
    line: dict[str, Any] = {"links": links, "h": H, "steps": steps, "note": ""}
    own = lambda count: constant_steps(problem, H, count, alpha=ALPHA, b=0.0)  # noqa: E731
    reached = own(steps).q[-1]
    ours = _runs("ours", steps, own)
    if chain.exudyn is None:
        found = compare(ours, lambda seconds: _spent(seconds, "ours"), float("inf"))
        missing = dict.fromkeys(("theirs_s", "error", "their_error", "solver"))
        alone = found.figure.value / (steps - steps // SHORT)
        return {**line, **unmeasured(limit, "exudyn is not installed"), **missing, "ours_s": alone}
    reference = constant_steps(problem, H / FINER, steps * FINER, alpha=ALPHA, b=0.0).q[-1]
    beside = {
        name: compare(ours | _runs(name, steps, partial(_theirs, links, name)), partial(_ratio, name), limit)
        for name in SOLVERS
    }
    best = max(beside, key=lambda name: beside[name].figure.value)
    errors = [float(np.abs(q - reference).max()) for q in (reached, _theirs(links, best, steps).q)]
    line |= {
        **beside[best].line(),
        "ours_s": _step(beside[best], "ours", steps),
        "theirs_s": _step(beside[best], best, steps),
        "error": errors[0],
        "their_error": errors[1],
        "solver": best,
        "others": {name: _step(found, name, steps) for name, found in beside.items() if name != best},
    }
    return line if errors[0] <= SAME_ERROR * errors[1] else {**line, "verdict": BROKEN, "note": "HHT's error is larger"}


def _runs(name: str, steps: int, run: Callable[[int], object]) -> dict[str, Callable[[], object]]:
    """A long run and a short one."""
    return {name: partial(run, steps), f"{name} short": partial(run, steps // SHORT)}


def _spent(seconds: Mapping[str, float], name: str) -> float:
    """A long run less a short one [s]."""
    return seconds[name] - seconds[f"{name} short"]


def _ratio(solver: str, seconds: Mapping[str, float]) -> float:
    """HHT's time over that of Exudyn's ``solver``; the steps are the same."""
    return _spent(seconds, "ours") / _spent(seconds, solver)


def _step(found: Compared, name: str, steps: int) -> float:
    """Median time of a step [s]."""
    return _spent({key: found.cpu(key) for key in found.rounds[0]}, name) / (steps - steps // SHORT)


def _theirs(links: int, solver: str, steps: int) -> chain.Theirs:
    """The chain after ``steps`` steps of Exudyn; nothing is written, nobody is called in between."""
    theirs = chain.Theirs(links, H, steps)
    theirs.solve(solver)
    return theirs
