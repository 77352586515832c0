"""Error per step to be expected of a solver, from its tolerance or from the length of its steps."""

from __future__ import annotations

import numpy as np

from hhtbench.checks.result.flow import Crossing, Equations, Flow, NotJudged
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request, plan_steps

FINEST = 1e-10  # relative: no motion is known better after many steps
RESOLVED = 1e-8  # relative: accuracy of the motion in the first steps
MAX_EVALUATIONS = 2000  # evaluations of the equations, for the first steps
STEPS_SEEN = 8  # fewest steps that show how well they resolve the motion
PLACES = 4  # in every step of the integration here, its end included, at which is seen what prescribed steps miss


def allowed_errors(problem: Problem, request: Request, equations: Equations, size: Vector) -> Vector:
    """Return the largest errors of y (2n,) in one step: by the tolerances, or of the first of the prescribed steps."""
    if request.fixed:
        return _of_first_steps(problem, request, equations, size)
    if request.rtol is None and request.atol is None:
        raise NotJudged("neither tolerances nor steps were asked for")
    rtol = np.maximum(np.resize(0.0 if request.rtol is None else request.rtol, size.size), FINEST)
    return rtol * size + (rtol * size if request.atol is None else np.resize(request.atol, size.size))


def _of_first_steps(problem: Problem, request: Request, equations: Equations, size: Vector) -> Vector:
    t, start = problem.t_span[0], np.concatenate([problem.q0, problem.v0])
    equations.begin(MAX_EVALUATIONS, (problem.lam_guess, problem.mu_guess))
    flow = Flow(equations, t, start, problem.t_span[1], RESOLVED, size)
    return Missed(flow, (t, problem.t_span[1]), problem, request, size).so_far


class Missed:
    """Error of prescribed steps of length h: the largest second difference y(t - h/2) - 2 y(t) + y(t + h/2) up to a time.

    That is half the error of a first-order step, also where the accelerations jump by dv' (h |dv'| / 2, since
    the steps of ``flow`` end there); for a motion faster than the steps it is the whole motion.
    """

    def __init__(self, flow: Flow, interval: tuple[float, float], problem: Problem, request: Request, size: Vector) -> None:
        """Measure the first ``STEPS_SEEN`` steps of ``flow`` along the ``interval`` [s]; ``size`` (2n,) scales y."""
        plan, (t, end) = plan_steps(request, *problem.t_span), interval
        if plan.count < STEPS_SEEN:
            raise NotJudged(f"{plan.count} steps are too few to tell how well they follow the motion")
        h = abs(plan.length(0)) if plan.lengths is None else float(np.max(np.abs(plan.lengths)))
        self._flow, self._seen = flow, 0
        self._half = float(np.sign(end - t)) * min(h, abs(end - t)) / 2
        self._longer = (h / min(h, abs(end - t))) ** 2  # where less than a step is left, the error of a whole one
        self._between = sorted((t + self._half, end - self._half))
        self._crossed = 0
        self.so_far = FINEST * size  #: (2n,)
        if not self._crosses(t, t + self._half):
            sudden = np.abs(flow.at(t + self._half) - flow.at(t) - self._half * flow.rate)  # a force that begins at once
            self.so_far = np.maximum(self.so_far, self._longer * sudden)
        for k in range(1, 2 * STEPS_SEEN):
            self._measure(t + k * self._half)

    def until(self, t: float) -> Vector:
        """Return the largest error (2n,) up to ``t`` [s]."""
        self._flow.at(t)
        while self._seen < len(self._flow.pieces):
            piece = self._flow.pieces[self._seen]
            if (piece.t_old - t) / self._half >= 2.0:  # a step later
                break
            self._seen += 1
            for part in range(1, PLACES + 1):
                self._measure(piece.t_old + part / PLACES * (piece.t - piece.t_old))
        for crossing in self._flow.crossed[self._crossed :]:
            self._crossed += 1
            self.so_far = np.maximum(self.so_far, self._misplaced(crossing))
        return self.so_far

    def _misplaced(self, crossing: Crossing) -> Vector:
        """Error (2n,) of an impulse that acts half a step too early, since prescribed steps do not end at jumps."""
        early = max(crossing.t - self._half, self._flow.t, key=lambda t: np.sign(self._half) * t)
        change = self._flow.change_at(crossing.i, self._flow.at(early))
        return np.abs(np.concatenate([self._half * crossing.change, change - crossing.change]))

    def _crosses(self, start: float, end: float) -> bool:
        return bool(self._flow.jumps.between(start, end))

    def _measure(self, t: float) -> None:
        middle = min(max(t, self._between[0]), self._between[1])
        if self._crosses(middle - self._half, middle + self._half):
            return
        before, at, after = (self._flow.at(middle + part * self._half) for part in (-1, 0, 1))
        self.so_far = np.maximum(self.so_far, self._longer * np.abs(before - 2 * at + after))
