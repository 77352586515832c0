"""Vibrations that steps under error control follow, as the last steps of a run show them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from solvers._projection import Projection
from solvers.hht.control.plan import ByError
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.formulas import EPS, allowed
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.tension import LIMIT, remedies
from solvers.hht.step.state import State

ROWS, APART = 64, (1, 4, 16, 64)  # rows that are looked at, so many steps apart: the fewest in which the vibration turns
TURNS = 6  # times: no accident
WAY = 10.0  # times as far as it goes has a run moved: else it is the motion
ALONG = 0.5  # of what forces answer to it: so much goes another way at most, where several vibrate together
SAME = 1.25  # times the frequency that they give along it, by turns
CARRIED = 0.5  # of its square, that forces alone give: else constraint forces carry it
LONGEST = 0.9  # of the longest step that is allowed: no tolerance has made it shorter
DIGITS = 1e3  # roundoffs of q, that a difference takes at least


class Vibration(NamedTuple):
    """What v does most along one direction, beside the tolerances."""

    along: Vector  #: (n,) its largest entry is 1
    turning: float  #: [1/s]
    amplitude: float  #: of that entry of q


def followed(engine: Engine, history: History, state: State, covered: float, by_error: ByError) -> str:
    """Which vibration the last steps to ``state`` follow, in words with a remedy; or none.

    ``covered``: by how much coordinates have changed on the way there, at most.
    """
    seen, h = None, 0.0
    for apart in APART:
        t, v = history.last((ROWS - 1) * apart + 1, (0, 3))
        if seen or len(t) <= (ROWS - 1) * apart:
            break
        seen, h = _leading(t[::apart, 0], v[::apart], by_error.tolerances), abs(float(t[-1, 0] - t[0, 0])) / (len(t) - 1)
    if not seen or h > LONGEST * by_error.options.max_step or not covered > WAY * seen.amplitude:
        return ""
    with suppress(BudgetSpent, NonFiniteValue), np.errstate(all="ignore"):
        omega, by_forces = _frequency(engine, state, seen)
        if not _fits(seen.turning, omega, h):
            return ""
        if by_forces < CARRIED * omega * omega:
            return _carried(engine, omega, h)
        return (
            f"Forces carry a vibration of {omega:.3g} rad/s, and steps of {h:.2g} s follow it, since it is larger than the "
            "tolerance; begin with the spring in balance, damp it, or loosen the tolerance."
        )
    return ""


def _leading(t: Vector, v: Matrix, tolerances: Tolerances) -> Vibration | None:
    """The direction along which v (k, n) bends most beside the tolerances; None where it hardly turns there.

    What bends v, its second differences, is what a step errs by.
    """
    n, h = v.shape[1], np.diff(t)
    weights = allowed(tolerances.rtol[n:], tolerances.atol[n:], v[0], np.abs(v).max(axis=0))
    with np.errstate(all="ignore"):
        bent = np.diff(np.diff(v, axis=0) / h[:, None], axis=0) / weights
    size = float(np.abs(bent).max(initial=0.0))
    if not 0.0 < size < math.inf:
        return None
    turned, share, way = np.linalg.svd(bent / size, full_matrices=False)
    turns, along = np.count_nonzero(turned[1:, 0] * turned[:-1, 0] < 0.0), way[0] * weights
    largest = float(np.abs(along).max())
    if turns < TURNS or not largest > 0.0:
        return None
    turning = math.pi * turns / abs(float(t[-2] - t[1]))
    most = float(np.abs(turned[:, 0]).max() * share[0]) * size * largest
    return Vibration(along / largest, turning, most / turning**3 / float(np.abs(h).mean()))


def _fits(turning: float, omega: float, h: float) -> bool:
    """Whether steps of ``h`` [s] turn as those of a vibration do: forces slow it down, constraint forces make it faster."""
    half = h * omega / 2.0
    if not half > 0.0:
        return False
    slow, fast = 2.0 * math.atan(half) / h, 2.0 * math.asin(min(half, 1.0)) / h
    return slow / SAME < turning < fast * SAME


def _frequency(engine: Engine, at: State, seen: Vibration) -> tuple[float, float]:
    """omega [1/s] of a vibration about ``at``, and the part of omega^2 that forces give; 0 where it is none, or is damped.

    omega^2 is Rayleigh's quotient of ``-dv'/dq`` and of the mass, by differences as wide as the vibration.
    """
    along, step = seen.along, max(seen.amplitude, DIGITS * EPS * float(np.abs(at.q).max()))
    mass = Projection(engine.dynamics).mass(at.t, at.q)
    mass = mass / float(np.abs(mass @ along).max())
    weighted = mass @ along

    def quotient(answer: Vector) -> float:
        return float(answer @ weighted / (along @ weighted))

    def answer(change: Callable[[float], Vector], size: float) -> Vector:
        return np.asarray((change(-size) - change(size)) / (2.0 * size))

    whole = answer(lambda s: engine.acceleration.solve(at.t, at.q + s * along, at.v).vdot, step)
    squared, fast = quotient(whole), step * seen.turning
    aside = whole - squared * along
    if not (squared > 0.0 and float(aside @ (mass @ aside)) < ALONG**2 * squared * float(whole @ weighted)):
        return 0.0, 0.0
    omega = math.sqrt(squared)
    damping = quotient(answer(lambda s: engine.acceleration.solve(at.t, at.q, at.v + s * along).vdot, fast))
    by_forces = quotient(answer(lambda s: engine.force(at.t, at.q + s * along, at.v)[0], step))
    return (omega, by_forces) if abs(damping) < omega else (0.0, 0.0)


def _carried(engine: Engine, omega: float, h: float) -> str:
    """That steps of ``h`` [s] follow a vibration that constraint forces carry, in words with a remedy; or none."""
    told = f"Constraint forces carry a vibration of {omega:.3g} rad/s, and steps of {h:.2g} s follow it"
    if engine.method.extrapolated and h * omega > LIMIT:
        return ""
    if engine.method.extrapolated:
        return f"{told}: it is part of the motion that the tolerance asks for; loosen the tolerance for longer ones."
    found = " or ".join(remedies(engine))
    if not found:
        return f"{told}; no option takes longer ones, a looser tolerance may."
    return (
        f"{told}; {found} takes longer ones where the vibration is smaller than the tolerance asks for; else loosen the "
        "tolerance."
    )
