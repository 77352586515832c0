"""Steps at equal achieved error: what a method takes with constant steps and under error control."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from hhtbench import load_problem
from hhtbench.protocol import Problem
from hhtbench.request import Request
from solvers.hht.adapter import solver
from solvers.hht.verify.control import known_motion, weighted_error
from solvers.hht.verify.drawn import drawn
from solvers.hht.verify.study import Method

Scene = str | tuple[int, int, int, float]  # a spec of the library, or arguments of ``drawn``

LEAST, MOST = 8, 2**16  # constant steps of a run
LOOSEST, TIGHTEST, PER_DECADE = 1e-2, 1e-8, 2  # tolerances
MAX_SECONDS = 120.0  # of one solve [s]; none comes near
CONSTANT, CONTROLLED = "constant steps", "error control"
KINDS = (CONSTANT, CONTROLLED)


@dataclass(frozen=True)
class Run:
    """One run that reached the end."""

    steps: int  #: rejected ones included
    error: float  #: largest weighted error of q and v over the known times
    over: float  #: error over tolerance; NaN with constant steps


Runs = Sequence[Run]


def steps_at(runs: Runs, error: float) -> float:
    """Where ever finer ``runs`` come below ``error`` for good, straight lines between logarithms.

    NaN if they do not; the first run's steps, an upper bound, if all are below.
    """
    for coarse, fine in reversed(list(pairwise(runs))):
        if coarse.error > error >= fine.error:
            share = math.log(coarse.error / error) / math.log(coarse.error / fine.error)
            return float(coarse.steps * (fine.steps / coarse.steps) ** share)
    return float(runs[0].steps) if runs and runs[0].error <= error else math.nan


def refined(scene: Scene, kind: str, method: Method, error: float) -> list[Run]:
    """Ever finer runs of ``kind`` until one has half of ``error``; those that fail are too coarse to be solved."""
    found = list[Run]()
    for request in _requests(kind):
        made = run(scene, method, request)
        found += [made] if made else []
        if made and made.error < error / 2:
            break
    return found


def run(scene: Scene, method: Method, request: Request) -> Run | None:
    """One run, None where it fails."""
    problem = load(scene)
    times, motion = known_motion(problem)
    solution = solver(**method).solve(problem, replace(request, t_eval=times, max_seconds=MAX_SECONDS))
    if not solution.success:
        return None
    steps = (solution.counters.steps_accepted or 0) + (solution.counters.steps_rejected_error or 0)
    error = weighted_error(problem, np.hstack([solution.q, solution.v]), motion)
    return Run(steps=steps, error=error, over=error / request.rtol if request.rtol else math.nan)


@cache
def load(scene: Scene) -> Problem:
    """The problem of the library, or the drawn one."""
    return load_problem(scene) if isinstance(scene, str) else drawn(*scene)


def _requests(kind: str) -> Iterator[Request]:
    """Ever finer ones."""
    if kind == CONSTANT:
        yield from (Request(steps=LEAST * 2**k) for k in range(int(math.log2(MOST // LEAST)) + 1))
        return
    count = round(PER_DECADE * math.log10(LOOSEST / TIGHTEST)) + 1
    yield from (Request(rtol=tolerance) for tolerance in np.geomspace(LOOSEST, TIGHTEST, count).tolist())
