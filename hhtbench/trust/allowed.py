"""How large the errors of a solver may be that does what it was asked: by its tolerance, or by the length of its steps."""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.protocol import Problem
from hhtbench.request import Request, plan_steps
from hhtbench.trust.flow import Equations, Flow, NotJudged

FINEST = 1e-10  # relative: no motion is known better after many steps
RESOLVED = 1e-8  # relative: accuracy of the motion in the first steps
MOST_EVALUATIONS = 2000  # of the equations, for the first steps
STEPS_SEEN = 8  # steps over which is seen how well they resolve the motion


def allowed_errors(problem: Problem, request: Request, equations: Equations, size: Vector) -> Vector:
    """The largest errors of y (2n,) that the tolerances allow of a step, or the first of the prescribed steps make."""
    if not request.fixed:
        return by_tolerance(request, size)
    t, start = problem.t_span[0], np.concatenate([problem.q0, problem.v0])
    equations.begin(MOST_EVALUATIONS, (problem.lam_guess, problem.mu_guess))
    return by_steps(Flow(equations, t, start, problem.t_span[1], RESOLVED, size), t, problem, request, size)


def by_tolerance(request: Request, size: Vector) -> Vector:
    """The largest errors of y (2n,) that the tolerances allow of a step, at states of the given ``size`` (2n,)."""
    if request.rtol is None and request.atol is None:
        raise NotJudged("neither tolerances nor steps were asked for")
    rtol = np.maximum(_spread(0.0 if request.rtol is None else request.rtol, size), FINEST)
    return rtol * size + (rtol * size if request.atol is None else _spread(request.atol, size))


def by_steps(flow: Flow, t: float, problem: Problem, request: Request, size: Vector) -> Vector:
    """What the prescribed steps miss of the motion from ``t`` on, (2n,): the largest y(t) - 2 y(t + h/2) + y(t + h).

    That is half the error of a step of a method of first order; of a motion faster than the steps it is all.
    """
    plan, direction = plan_steps(request, *problem.t_span), np.sign(problem.t_span[1] - problem.t_span[0])
    if plan.count < STEPS_SEEN:
        raise NotJudged(f"{plan.count} steps are too few to tell how well they follow the motion")
    h = direction * (abs(plan.length(0)) if plan.lengths is None else float(np.max(np.abs(plan.lengths))))
    times = np.minimum(direction * (t + h / 2 * np.arange(2 * STEPS_SEEN + 1)), direction * problem.t_span[1]) * direction
    y = np.array([flow.at(float(time)) for time in times])
    return np.max(np.abs(y[:-2] - 2 * y[1:-1] + y[2:]), axis=0) + FINEST * size


def _spread(tolerance: float | Vector, size: Vector) -> Vector:
    """One number, one per coordinate or one per component of y, as (2n,)."""
    return np.resize(np.asarray(tolerance, dtype=np.float64), size.size)
