"""Check the motion between the rows: find suspicious intervals between rows, and forces that the steps have missed.

A suspicious interval is no proof, but a place at which to start an integration: for the windows of a judgement
(:func:`stand_out`, :func:`bends`), or from one row to the next (:func:`stepped_over`, for ``hb.solve(accuracy=...)``, since
runs that step over the same force agree with one another).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hhtbench.checks.phases import phases_of
from hhtbench.checks.result.flow import Equations, Flow, NotJudged
from hhtbench.checks.result.levels import declared_sizes
from hhtbench.checks.result.success import SAME_TIME
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution, ends_of

STILL = 1e-3  # share of the median speed of change below which rows may be frozen
LEAP = 30.0  # times the median mismatch of positions and velocities: larger ones may be a jump
APART = 1e-9  # share of the interval below which the change between two rows is roundoff
PLACES = 200  # at which accelerations are compared, one in each of as many equal parts of the interval
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0  # its multiples' fractional parts hit no grid
WORST = 3  # ways between rows that are integrated, beside those across jumps of the velocities
FINER = 1e-2  # tolerance of the integration, relative to the allowed distance
MAX_EVALUATIONS = 2000  # evaluations of accelerations
BLIND = "the equations of motion cannot be checked between the rows"

Between = Callable[[Vector, Matrix, Matrix], Matrix]  # vdot (k, n) at t (k,), q and v (k, n)


def stand_out(rows: Any, size: Vector) -> list[int]:
    """Return up to three ``rows`` i (with t, q, v) whose change to row i + 1 is an outlier; ``size`` (2n,) of [q, v].

    They are the first that hardly moves, the slowest of these, and the one whose change of q fits its velocities least.
    """
    t = rows.t
    dt = np.diff(t)
    if dt.size < 3:
        return []
    usable = np.abs(dt) > APART * abs(t[-1] - t[0])
    way = np.max(np.abs(np.diff(np.concatenate([rows.q, rows.v], axis=1), axis=0)) / size, axis=1)
    left = np.diff(rows.q, axis=0) - dt[:, None] * (rows.v[1:] + rows.v[:-1]) / 2
    speed = way / np.where(usable, np.abs(dt), np.inf)
    found = set()
    slow = np.flatnonzero(usable & (speed < STILL * np.median(speed[usable]))) if usable.any() else np.empty(0, int)
    if slow.size:
        found |= {int(slow[0]), int(slow[np.argmin(speed[slow])])}
    return sorted(found | set(_largest(np.max(np.abs(left) / size[: rows.q.shape[1]], axis=1))))


def bends(t: Vector, y: Matrix, vdot: Matrix, between: Between, parts: Matrix, size: Vector) -> list[int]:
    """Return rows i between which and row i + 1 the accelerations fit the states least; y = [q, v] (k, 2n) at ``t`` (k,).

    Three residuals are used: for v the trapezoidal rule, for q that with end corrections, and the accelerations
    ``between``, evaluated at ``parts`` (p, k - 1) of each interval on cubic Hermite polynomials.  A force that acts only
    between two rows shows in the last one only.
    """
    kept = np.flatnonzero(np.append(True, np.diff(t) != 0.0))
    if kept.size < 4:
        return []
    t, vdot, n = t[kept], vdot[kept], size.size // 2
    q, v = np.hsplit(y[kept], 2)
    dt, inside = np.diff(t)[:, None], []
    left_of_q = np.diff(q, axis=0) - dt * (v[1:] + v[:-1]) / 2 + dt**2 * np.diff(vdot, axis=0) / 12
    left_of_v = np.diff(v, axis=0) / dt - (vdot[1:] + vdot[:-1]) / 2
    of_q, of_v = _hermite(t, q, v), _hermite(t, v, vdot)
    for s in parts[:, : kept.size - 1]:
        at = t[:-1] + s * dt[:, 0]
        found, there = between(at, of_q(at), of_v(at)), of_v(at, 1)
        inside.append(np.abs(found - there))
    left = left_of_q / size[:n], left_of_v / size[n:], np.max(inside, axis=0) / size[n:]
    worst = [np.nan_to_num(np.max(np.abs(one), axis=1), posinf=0.0) for one in left]
    return sorted({int(kept[i]) for one in worst for i in _largest(one)})


def _hermite(t: Vector, x: Matrix, rate: Matrix) -> CubicHermiteSpline:
    order = slice(None, None, 1 if t[-1] > t[0] else -1)
    return CubicHermiteSpline(t[order], x[order], rate[order])


def _largest(left: Vector) -> list[int]:
    worst = int(np.argmax(left))
    return [worst] if left[worst] > LEAP * np.median(left) else []


class SteppedOver(NamedTuple):
    """Result of the check between the rows."""

    text: str = ""  #: where they lead to another row; "" where to none
    off: float = 0.0  #: the scaled distance of that from the row
    evaluations: int = 0  #: number of evaluations of accelerations


def stepped_over(problem: Problem, solution: Solution, allowed: float) -> SteppedOver:
    """Check whether the equations of motion lead from row to row of ``solution``, or elsewhere.

    The accelerations are evaluated at ``PLACES`` places on the cubic Hermite polynomials of the rows.  Where they differ
    most from the second derivatives, the motion is integrated from the row before to the row after.  A force pulse shorter
    than the distance of two places may lie between them.

    Parameters
    ----------
    allowed
        Scaled distance of q and v from the next row.
    """
    if solution.phases:
        found = [stepped_over(*one, allowed) for one in phases_of(problem, solution)]
        worst = next((one for one in found if one.text), SteppedOver())
        return worst._replace(evaluations=sum(one.evaluations for one in found))
    known = not solution.unknown[:1].any()
    try:
        equations = Equations(problem)
    except NotJudged as reason:
        return SteppedOver(f"{BLIND}: {reason}")
    t, y, without_event = _ways(problem, solution, equations)
    if t.size < 2:
        return SteppedOver()
    equations.begin(MAX_EVALUATIONS, (solution.lam[0], solution.mu[0]) if known else None)
    try:
        text, off = _disagreement(problem, equations, (t, y, without_event), allowed)
    except NotJudged as reason:
        text, off = f"{BLIND}: {reason}", 0.0
    return SteppedOver(text, off, equations.used)


def _disagreement(
    problem: Problem, equations: Equations, ways: tuple[Vector, Matrix, Vector], allowed: float
) -> tuple[str, float]:
    """Return the disagreement as a sentence and its distance from the row; "" and 0 if there is none."""
    n, size = problem.q0.size, np.concatenate(declared_sizes(problem))
    rows, states, without_event = ways
    index, sign = np.arange(PLACES), np.sign(rows[-1] - rows[0])
    t = rows[0] + (rows[-1] - rows[0]) * (index + index * GOLDEN % 1.0) / PLACES
    way = np.searchsorted(sign * rows, sign * t, "right") - 1
    t, way = t[without_event[way]], way[without_event[way]]
    curve = _hermite(rows, states[:, :n], states[:, n:])
    there = curve(t, 2)
    vdot = np.array([equations(*at)[n:] for at in zip(t.tolist(), np.hstack([curve(t), curve(t, 1)]), strict=True)])
    vdot = vdot.reshape(-1, n)
    off = np.nan_to_num(np.max(np.abs(vdot - there) / size[n:], axis=1), nan=np.inf)
    across = np.array([bool(equations.jumps.between(*rows[[i, i + 1]])) for i in way], dtype=bool)
    order = np.argsort(-off, kind="stable")
    for k in [*order[across[order]], *order[~across[order]][:WORST]]:
        before, after = way[k], way[k] + 1
        state = states[before]
        for start, end in ((rows[before], t[k]), (t[k], rows[after])):
            if start != end:
                state = Flow(equations, float(start), state, float(end), FINER * allowed, size).at(float(end))
        beside = float(np.max(np.abs(state - states[after]) / size))
        if not beside <= allowed:
            i = int(np.argmax(np.abs(vdot[k] - there[k]) / size[n:]))
            text = (
                f"the equations of motion disagree: at t = {t[k]:.6g} the acceleration of q[{i}] is {vdot[k, i]:.3g} and "
                f"the answer's {there[k, i]:.3g}; they lead {beside:.2g} of the scales beside the row at {rows[after]:.6g}"
            )
            return text, beside
    return "", 0.0


def _ways(problem: Problem, solution: Solution, equations: Equations) -> tuple[Vector, Matrix, Vector]:
    """Return times (k + 1,) and states (k + 1, 2n) of start, rows and step ends, and which of the k intervals hold no
    event.

    Those that lie on a jump of the velocities are left out.
    """
    ends = ends_of(solution)
    t, q, v = [solution.t], [solution.q], [solution.v]
    if ends is not None:
        t, q, v = [ends.t, *t], [ends.q, *q], [ends.v, *v]
    elif solution.t[0] != problem.t_span[0]:
        t, q, v = [np.array(problem.t_span[:1]), *t], [problem.q0[None], *q], [problem.v0[None], *v]
    times, y = np.concatenate(t), np.hstack([np.concatenate(q), np.concatenate(v)])
    ahead = problem.t_span[1] - problem.t_span[0]
    sign, span = np.sign(ahead), abs(ahead)
    _, first = np.unique(sign * times, return_index=True)
    times, y = times[first], y[first]
    kept = sign * times <= sign * solution.t[-1]
    kept &= ~equations.jumps.near(times, SAME_TIME * span)
    times, y = times[kept], y[kept]
    without = np.ones(max(times.size - 1, 0), dtype=bool)
    events = np.concatenate([np.empty(0), *solution.t_events])
    for side in ("left", "right"):
        at = np.searchsorted(sign * times, sign * events, side) - 1
        without[at[(at >= 0) & (at < without.size)]] = False
    return times, y, without
