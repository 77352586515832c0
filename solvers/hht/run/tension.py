"""Vibrations that constraint forces carry, as of a light body on a taut rod: what they ask of a step, (H33)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from scipy import linalg

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.protocol import declared
from solvers._projection import Projection
from solvers._start import Place
from solvers.hht.equations.formulas import EPS
from solvers.hht.options import make_options
from solvers.hht.run.engine import Engine, not_extrapolated
from solvers.hht.run.singular import LONGEST, dense, seconds_of_look
from solvers.hht.step.state import State

ROUNDS = 20  # of a power iteration: the frequency is then right to some per cent, from below
SECONDS = 1.0  # after which it is not iterated further: rows may be differences of the user's functions
BENT = EPS ** (1 / 3)  # of the rows' size: their change over a difference, by truncation against roundoff
SHORTENED = 3  # times: rows as large as their change may be anything
LIMIT = 2.0  # h omega up to which steps with b = 0 are stable, (H33)
GROWN = 3.0  # times its first way back and forth: so much more has a vibration that steps have made grow
DEPARTED = 0.1  # of the multipliers: vibrations that are damped leave 0.01, those that have grown up to 1
APART, LOOKS = 5, 12  # steps one after the other, half of which tell: multipliers may be zero in one; how often along a run
MOST_DAMPED = -0.3  # alpha, from which one nearer -1/3 damps hardly more
VISIBLE = 1e-7  # of the largest coordinate: the way of one that is told of


def unstable(engine: Engine, places: Sequence[State | Place], h: float) -> str:
    """For which vibration at one of ``places`` steps of ``h`` [s] are too long by (H33), in words with a remedy; or none.

    With extrapolated multipliers, for which they may be by (H55).
    """
    b, damped = engine.method.coefficients.b, engine.method.extrapolated
    if not (damped or may_be_unstable(engine)):
        return ""
    whatever_b = damped or not engine.structure.m  # f, or mu of (H10), carries it: b does not matter
    limit, with_b = (LIMIT, "") if whatever_b else (LIMIT / math.sqrt(1.0 - 2.0 * b), f" with b = {b:g}")
    omega, until = 0.0, time.perf_counter() + SECONDS
    for at in places:
        omega = max(omega, fastest(engine, at))
        if time.perf_counter() > until:
            break
    if not abs(h) * omega > limit:
        return ""
    if damped:
        return f"constraint forces carry a vibration of {omega:.3g} rad/s, which {_errs(engine)}"
    return (
        f"constraint forces carry a vibration of {omega:.3g} rad/s, for which steps are stable below {limit / omega:.2g} s"
        f"{with_b}, h omega = {limit:.3g}; take {' or '.join(['shorter ones', *remedies(engine)])}"
    )


def remedies(engine: Engine) -> list[str]:
    """Options which the run could have and that let steps pass over a vibration carried by reactions, in words."""
    method, s = engine.method, engine.structure
    if not s.m:
        return []
    found = []
    with suppress(ProblemError):  # an alpha that damps too little, or a b
        if not (method.extrapolated or s.mass == "sparse" or not_extrapolated(engine.dynamics.system)):
            make_options(alpha=method.coefficients.alpha, b=method.coefficients.b, extrapolate_reaction=True)
            found.append("extrapolate_reaction=True, which damps it,")
    implicit = "" if method.reaction == "implicit" else ' with reaction="implicit"'  # others make it grow, or have b = 0
    if method.coefficients.b < 0.5:
        found.append(f"b = 1{implicit}{' where position constraints carry it' if s.p else ''}")
    return found


def may_be_unstable(engine: Engine) -> bool:
    """Whether steps of the method can be too long for a vibration that reactions carry, by (H33)."""
    method = engine.method
    bounded = method.equations == "hht" and method.coefficients.b < 0.5 and not method.extrapolated
    return engine.structure.constrained and bounded


def grown(engine: Engine, t: Matrix, q: Matrix, v: Matrix) -> str:
    """Which vibration steps to the rows ``t`` (k, 1), ``q``, ``v`` (k, n) have made grow by (H33), in words; or none.

    What grows so goes back and forth with the steps in what the trapezoidal rule leaves of a motion, wherever it is seen
    from: only where the rows show that is the tension asked, at the start, where that begins, before it has bent the rods,
    and at the end.
    """
    if len(t) < 5 or not may_be_unstable(engine):
        return ""
    way = np.diff(q, axis=0) - np.diff(t, axis=0) * (v[1:] + v[:-1]) / 2.0
    turned = way[1:] * way[:-1] < 0.0
    again = turned[2:] & turned[1:-1] & turned[:-2]  # three times, one after the other: no motion that steps resolve
    if not np.count_nonzero(again):
        return ""
    way, columns = np.abs(way), np.arange(q.shape[1])
    first = again.argmax(axis=0)
    largest = np.where(again, way[3:], 0.0).max(axis=0)
    if not (largest > np.maximum(GROWN * way[first, columns], VISIBLE * float(np.abs(q).max()))).any():
        return ""
    begins = int(first[again.any(axis=0)].min())
    places = [engine.place, *(Place(float(t[i, 0]), q[i], v[i]) for i in (begins, len(t) - 1))]
    with uncounted():
        text = unstable(engine, places, float(np.abs(np.diff(t[:, 0])).max()))
    return text and f"growth: a vibration that goes back and forth with the steps has grown: {text}"


def departed(engine: Engine, t: Matrix, h: Matrix, q: Matrix, v: Matrix, lam: Matrix) -> str:
    """Whether extrapolated multipliers have let a vibration grow in prescribed steps, in words; or none.

    Of steps ``h`` (k, 1), 0 for a state that none has led to, to t, q, v with their multipliers ``lam`` (k, m).  These are
    those of the states, (H16), up to O(h); a vibration that is faster than the steps, and large, is in one of the two alone.
    """
    led = np.flatnonzero(h[:, 0])
    if not (engine.method.extrapolated and engine.structure.m and led.size):
        return ""
    last = np.unique(np.linspace(min(APART, led.size), led.size, LOOKS).astype(int)).tolist()
    looks = [led[max(end - APART, 0) : end].tolist() for end in last]
    with uncounted(), suppress(BudgetSpent, NonFiniteValue):
        own = {i: engine.acceleration.solve(float(t[i, 0]), q[i], v[i]).lam for looked in looks for i in looked}
        size = float(np.median([np.abs(x).max() for x in own.values()]))  # they may vanish in some steps
        for looked in looks:
            first, off = looked[0], [np.abs(lam[i] - own[i]).max() for i in looked]
            if not np.median(off) > DEPARTED * max(size, *(np.abs(lam[i]).max() for i in looked)):
                continue
            here = Place(float(t[first, 0]), q[first], v[first])  # where it may have bent the rods, which stops it
            omega = max(fastest(engine, place, lam[first]) for place in (engine.place, here))
            if omega * float(np.abs(h[looked]).max()) > LIMIT:
                return (
                    f"growth: at t = {t[looked[-1], 0]:.6g} the multipliers of the steps are not those of the motion: a "
                    f"vibration that constraint forces carry {_errs(engine)}"
                )
    return ""


def _errs(engine: Engine) -> str:
    """That a vibration grows with extrapolated multipliers, in words with a remedy."""
    nearer = "alpha nearer -1/3, " if engine.method.coefficients.alpha > MOST_DAMPED else ""
    return f"has grown by what extrapolation errs by, (H55); take {nearer}shorter steps, or error control"


def fastest(engine: Engine, at: State | Place, lam: Vector | None = None) -> float:
    """omega [1/s] of the fastest small vibration about a place that reactions alone carry; 0 where there is none known.

    The reactions are those of ``lam`` (m,) where that is given, else of the acceleration level.
    omega^2 is the largest eigenvalue of ``M^-1 d(C^T lam)/dq`` between changes of q that the rows C = [g_q; k_v] allow.
    """
    dynamics, s = engine.dynamics, engine.structure
    reactions = any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction"))
    if not s.constrained or seconds_of_look(dynamics) > LONGEST or reactions:
        return 0.0
    with suppress(BudgetSpent, NonFiniteValue, ValueError, linalg.LinAlgError):
        pulled, start = _stiffness(engine, at, lam)
        value = _outermost(pulled, start)
        if value < 0.0:  # what falls over hides what vibrates
            value += _outermost(lambda y: pulled(y) - value * y, start)
        return math.sqrt(max(value, 0.0))
    return 0.0


def _stiffness(engine: Engine, at: State | Place, lam: Vector | None) -> tuple[Callable[[Vector], Vector], Vector]:
    """y -> L^-1 d(C^T lam)/dq L^-T y along the constraints, where L L^T is the mass, by differences; and a y (n,).

    No coordinate's size tells how far a difference may reach, as places may be told from anywhere: the rows tell it.
    """
    t, q, v, work = at.t, at.q, at.v, engine.work
    projection = Projection(engine.dynamics)
    if lam is None:
        found = engine.acceleration.solve(t, q, v)
    multipliers = np.concatenate([found.lam, found.mu]) if lam is None else lam
    root = linalg.cholesky(dense(projection.mass(t, q)), lower=True)
    reach = BENT * (float(np.abs(q).max()) or 1.0)

    def rows_at(x: Vector) -> Vector:
        work.check_time()
        return dense(projection.levels.at(t, x, v).rows)

    here = rows_at(q)
    normal, _ = linalg.qr(linalg.solve_triangular(root, here.T, lower=True), mode="economic")
    size = float(np.abs(here).max()) or 1.0

    def tangent(y: Vector) -> Vector:
        return np.asarray(y - normal @ (normal.T @ y))

    def pulled(y: Vector) -> Vector:
        nonlocal reach
        along = linalg.solve_triangular(root, y, lower=True, trans="T")
        for _ in range(SHORTENED):
            step = reach / float(np.abs(along).max())
            change = rows_at(q + step * along) - rows_at(q - step * along)
            bent = float(np.abs(change).max()) / size
            if bent <= 10.0 * BENT:
                break
            reach *= BENT / bent
        return tangent(linalg.solve_triangular(root, change.T @ multipliers / (2.0 * step), lower=True))

    return pulled, tangent(np.random.default_rng(0).standard_normal(q.size))


def _outermost(apply: Callable[[Vector], Vector], y: Vector) -> float:
    """The eigenvalue of largest magnitude, by power iteration from ``y`` (n,): not more, wherever it ends."""
    value, until = 0.0, time.perf_counter() + SECONDS
    for _ in range(ROUNDS):
        size = float(np.abs(y).max())  # squares of what is huge or tiny are not numbers
        if not 0.0 < size < math.inf:
            break
        y = y / size
        y = y / float(np.linalg.norm(y))
        image = apply(y)
        value, y = float(y @ image), image
        if time.perf_counter() > until:
            break
    return value
