"""Detection of a branch switch: a step that ended at another solution of the constraints, (H58)."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from hhtbench.lowering import Dynamics, Structure
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.solution.counting import Work, uncounted
from solvers._projection import Projection

FREE = 0.1  # largest share of a displacement tangent to the constraints: more may be unresolved motion
ALONG, TOWARDS = 6, 8  # projections along v from the start of a step, and from there towards its end
PART = 0.25  # share of the remaining distance in each of the latter
THERE = 0.5  # largest remaining distance relative to the displacement for which the end counts as reached


class Stepped(Protocol):
    """The attributes of an engine that its loops use."""

    dynamics: Dynamics
    structure: Structure
    acceleration: Any
    bare_force: Any
    functions: Any
    work: Work
    points: int
    method: Any
    control: Any
    plain: bool


def branch_switch(engine: Stepped, state: Vector, x: Vector, q1: Vector, step: Vector) -> Vector:
    """Displacements (n,) of a step that lead to another branch of the constraints; zero for all others.

    All are zero where most of the displacement is tangent to the constraints, or these have lost rank.

    Parameters
    ----------
    state
        Six numbers, of which t [s] is the first, then q and v (n,) at the start of the step.
    x
        q1 - q0 - h (v0 + v1)/2, (n,).
    q1
        (n,) at the end of the step.
    step
        Its signed length [s], the time of its end [s].
    """
    n, t1, t = q1.size, float(step[1]), float(state[0])
    q, v, nothing = state[6 : 6 + n], state[6 + n : 6 + 2 * n], np.zeros(n)
    free = engine.acceleration.left_free(t, q, v, x, engine.structure.m)
    if free is None:
        return nothing
    along, mass = free
    held = x - along
    far = np.abs(along) < FREE * np.abs(x)
    if not held @ (mass @ held) > along @ (mass @ along) or not far.any():
        return nothing
    return np.where(far & (np.abs(_missing(engine, t, q, v, t1, q1)) > THERE * np.abs(x)), held, 0.0)


def _missing(engine: Stepped, t: float, q: Vector, v: Vector, t1: float, q1: Vector) -> Vector:
    """Distance left to q1 (n,) after following the constraints with v from t to t1, then towards q1, in small pieces.

    Only the part normal to the constraints: along them the path need not be that of the motion.
    """
    projection, place = Projection(engine.dynamics), q.copy()
    ignoring = np.errstate(all="ignore")
    with uncounted(), ignoring, suppress(BudgetSpent, NonFiniteValue, np.linalg.LinAlgError):
        for k in range(1, ALONG + 1):
            time = t + k / ALONG * (t1 - t)
            place, v = projection.nearest(time, place + (t1 - t) / ALONG * v, v)
        for _ in range(TOWARDS):
            place = projection.position(t1, place + PART * (q1 - place), v)
        free = engine.acceleration.left_free(t1, place, v, q1 - place, engine.structure.m)
        if free is not None and np.isfinite(free[0]).all():
            return q1 - place - free[0]
    return np.full(q.size, np.inf)
