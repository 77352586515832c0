"""Did the runs step over a force?  Runs that step over the same place agree, and tell nothing of what acts there.

The accelerations are evaluated at ``PLACES`` places, one somewhere in each of as many equal parts of the interval, on the
cubic Hermite polynomials of the rows.  Where they are farthest off the second derivatives of these the motion is integrated
from the row before to the place, and on to the row after.  A push shorter than such a part may lie between the places.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.checks.result.flow import Equations, Flow, NotJudged
from hhtbench.protocol import Problem
from hhtbench.result import Solution, ends_of

PLACES = 200
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0  # its multiples' fractional parts hit no grid
WORST = 3  # ways between rows that are integrated
FINER = 1e-2  # times what is allowed: tolerance of the integration
MOST_EVALUATIONS = 2000
BLIND = "the equations of motion cannot be looked at between the rows"


class Look(NamedTuple):
    """What was seen between the rows."""

    text: str = ""  #: where the equations of motion lead to another row, in words; "" where to none
    off: float = 0.0  #: the scaled distance of that from the row
    evaluations: int = 0  #: of accelerations


class _Ways(NamedTuple):
    """From a row to the next, in the order of time."""

    t: Vector  #: (k + 1,) of the rows [s]
    y: Matrix  #: (k + 1, 2n) [q, v]
    without_event: Vector  #: (k,)


def stepped_over(problem: Problem, solution: Solution, allowed: float) -> Look:
    """Where the equations of motion lead to other rows than those of ``solution``.

    Parameters
    ----------
    allowed
        Scaled distance of q and v from the next row.
    """
    ways = _ways(problem, solution)
    if ways.t.size < 2:
        return Look()
    known = not solution.unknown[:1].any()
    try:
        equations = Equations(problem)
    except NotJudged as reason:
        return Look(f"{BLIND}: {reason}")
    equations.begin(MOST_EVALUATIONS, (solution.lam[0], solution.mu[0]) if known else None)
    try:
        text, off = _disagreement(problem, equations, ways, allowed)
    except NotJudged as reason:
        text, off = f"{BLIND}: {reason}", 0.0
    return Look(text, off, equations.used)


def _disagreement(problem: Problem, equations: Equations, ways: _Ways, allowed: float) -> tuple[str, float]:
    """In words, and the distance from the row."""
    n, scales = problem.q0.size, problem.scales
    size = np.concatenate([np.broadcast_to(np.asarray(x, dtype=np.float64), (n,)) for x in (scales.q, scales.v)])
    index = np.arange(PLACES)
    t = ways.t[0] + (ways.t[-1] - ways.t[0]) * (index + index * GOLDEN % 1.0) / PLACES
    sign = np.sign(ways.t[-1] - ways.t[0])
    way = np.searchsorted(sign * ways.t, sign * t, "right") - 1
    t, way = t[ways.without_event[way]], way[ways.without_event[way]]
    y, there = _hermite(ways, way, t)
    vdot = np.array([equations(*at)[n:] for at in zip(t.tolist(), y, strict=True)]).reshape(-1, n)
    off = np.nan_to_num(np.max(np.abs(vdot - there) / size[n:], axis=1), nan=np.inf)
    for k in np.argsort(-off, kind="stable")[:WORST]:
        before, after = way[k], way[k] + 1
        state = ways.y[before]
        for start, end in ((ways.t[before], t[k]), (t[k], ways.t[after])):
            if start != end:
                state = Flow(equations, float(start), state, float(end), FINER * allowed, size).at(float(end))
        beside = float(np.max(np.abs(state - ways.y[after]) / size))
        if not beside <= allowed:
            i = int(np.argmax(np.abs(vdot[k] - there[k]) / size[n:]))
            text = (
                f"the equations of motion disagree: at t = {t[k]:.6g} the acceleration of q[{i}] is {vdot[k, i]:.3g} and "
                f"the answer's {there[k, i]:.3g}; they lead {beside:.2g} of the scales beside the row at {ways.t[after]:.6g}"
            )
            return text, beside
    return "", 0.0


def _ways(problem: Problem, solution: Solution) -> _Ways:
    """Those of the start, the rows, and the ends of steps where they are told."""
    ends = ends_of(solution)
    t, q, v = [solution.t], [solution.q], [solution.v]
    if ends is not None:
        t, q, v = [ends.t, *t], [ends.q, *q], [ends.v, *v]
    elif solution.t[0] != problem.t_span[0]:
        t, q, v = [np.array(problem.t_span[:1]), *t], [problem.q0[None], *q], [problem.v0[None], *v]
    times, y = np.concatenate(t), np.hstack([np.concatenate(q), np.concatenate(v)])
    sign = np.sign(problem.t_span[1] - problem.t_span[0])
    _, first = np.unique(sign * times, return_index=True)
    times, y = times[first], y[first]
    reached = sign * times <= sign * solution.t[-1]
    times, y = times[reached], y[reached]
    without = np.ones(max(times.size - 1, 0), dtype=bool)
    events = np.concatenate([np.empty(0), *solution.t_events])
    for side in ("left", "right"):
        at = np.searchsorted(sign * times, sign * events, side) - 1
        without[at[(at >= 0) & (at < without.size)]] = False
    return _Ways(times, y, without)


def _hermite(ways: _Ways, way: Vector, t: Vector) -> tuple[Matrix, Matrix]:
    """[q, v] (k, 2n) of the cubic polynomials of ways ``way`` (k,) at ``t`` (k,), and their second derivatives (k, n)."""
    n = ways.y.shape[1] // 2
    (q0, v0), (q1, v1) = (np.hsplit(ways.y[i], [n]) for i in (way, way + 1))
    h = (ways.t[way + 1] - ways.t[way])[:, None]
    s = (t - ways.t[way])[:, None] / h
    first, last = v0 - (q1 - q0) / h, v1 - (q1 - q0) / h
    q = q0 + s * (q1 - q0) + s * (1 - s) * h * ((1 - s) * first - s * last)
    v = (q1 - q0) / h + (1 - s) * (1 - 3 * s) * first + s * (3 * s - 2) * last
    return np.hstack([q, v]), ((6 * s - 4) * first + (6 * s - 2) * last) / h
