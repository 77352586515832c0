"""``collocation(form=ggl|index2|index1, stages=7)``: Radau IIA of high order, for reference solutions.

Order 2 s - 1: with seven stages 13, so that roundoff is reached with few steps, also on stiff problems and with both levels
of the constraints as equations.  It is ours, and slow per step: it exists to certify others, not to compete with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from hhtbench.arguments import Matrix, Vector, positive_integer
from hhtbench.errors import ProblemError
from hhtbench.result import Status
from solvers._adapter import Adapter, choose
from solvers._collocation import Collocation, radau_nodes
from solvers._run import Halt, Run

KNOWN = {"form": ("ggl", "index2", "index1")}
STAGES = 7
MOST_STAGES = 12  # beyond, the differentiation matrix loses digits
SAFETY, MOST_GROWTH, LEAST_SHRINK = 0.9, 2.0, 0.1  # of a step's length from one step to the next
NEWTON_SHRINK = 0.5  # where Newton's iteration fails
PATIENCE = 20  # steps without growth after a refusal
KEEP = 1.3  # a step that could grow by less keeps its length, and with it the factorised matrix
FIRST = 1e-4  # of the interval: the first step that is tried
BETTER = 0.75  # the last Legendre coefficient may be rtol**BETTER: the end of a step is better by more than that


@dataclass(frozen=True)
class CollocationSolver(Adapter):
    """Radau IIA on a DAE form; every output time is the end of a step: rows are as accurate as steps, which they shorten."""

    stages: int = STAGES
    library: ClassVar[str] = "hhtbench"

    def drive(self, run: Run) -> None:
        """Steps with error control by the decay of the collocation polynomial's Legendre coefficients."""
        method = Collocation(run=run, nodes=radau_nodes(self.stages), scales=_scales(run), rate=run.start.yp)
        run.tells_no_steps()
        weights = np.where(run.form.multipliers, np.inf, run.weights)
        length, patience = FIRST * abs(run.t1 - run.t0), 0
        while run.unfinished():
            end = _end_of_step(run, length)
            h = end - run.t
            if h == 0:
                raise Halt(Status.step_too_small, f"{Status.step_too_small.text} t = {run.now:.17g} was reached.")
            z = method.step(run.t, run.y, h)
            factor = self._growth(z, method, weights + run.rtol * np.abs(run.y), run.rtol)
            if z is None or factor < SAFETY:
                run.work.add("steps_rejected_newton" if z is None else "steps_rejected_error")
                length, patience = abs(h) * factor, PATIENCE
                continue
            method.advance(z, h)
            dense = partial(method.interpolant, run.t, run.y, z, h)
            run.accept(end, run.y + z[-1], _no_interior, dense=dense)
            run.work.library = method.counters
            patience = max(patience - 1, 0)
            if factor > KEEP and not patience:
                length = max(length, abs(h) * factor)

    def _growth(self, z: Matrix | None, method: Collocation, sizes: Vector, rtol: float) -> float:
        """By which factor the next step may differ from this one; below SAFETY this one is refused."""
        if z is None:
            return NEWTON_SHRINK
        error = np.max(np.abs(method.nodes.leading @ z) / sizes) * rtol ** (1 - BETTER)
        return float(np.clip(SAFETY * max(error, 1e-99) ** (-1 / self.stages), LEAST_SHRINK, MOST_GROWTH))


def _scales(run: Run) -> Vector:
    """Typical sizes of y, (size,): the problem's for q and v, one elsewhere."""
    scales, n = np.ones(run.form.size), run.problem.q0.size
    scales[:n], scales[n : 2 * n] = run.problem.scales.q, run.problem.scales.v
    return scales


def _end_of_step(run: Run, length: float) -> float:
    """Where a step of about ``length`` from run.t ends: at the next output time, or halfway where that is near."""
    stops = np.array([run.t1]) if run.wanted is None else np.append(run.wanted, run.t1)
    stop = float(next(t for t in stops if run.direction * t > run.direction * run.t))
    rest = abs(stop - run.t)
    if rest <= length * (1 + 1e-9):
        return stop
    return run.t + run.direction * min(length, rest / 2)


def _no_interior(time: float) -> Any:
    raise AssertionError("every output time is the end of a step")


def solver(**options: Any) -> CollocationSolver:
    """Radau IIA; options ``form``: ggl (default), index2 or index1, ``stages``: 7, order 2 stages - 1."""
    stages = positive_integer("stages", options.pop("stages", STAGES))
    if not 2 <= stages <= MOST_STAGES:
        raise ProblemError(f"stages must be from 2 to {MOST_STAGES}; got {stages}.")
    chosen = choose("collocation", options, KNOWN)
    return CollocationSolver(f"collocation(form={chosen['form']}, stages={stages})", chosen["form"], "radau", stages)
