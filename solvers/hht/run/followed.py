"""Vibrations far faster than a motion that steps under error control follow, as its last steps show them."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from solvers._projection import Projection
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.formulas import TINY, allowed
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.tension import BENT, LIMIT, fastest, remedies
from solvers.hht.step.state import State

FASTER = 30.0  # than the motion crosses what it covers
ROWS, APART = 64, (1, 4, 16, 64)  # rows that are looked at, so many steps apart: the fewest in which the vibration turns
TURNS = 6  # times: no accident
LEADS = 0.7  # of what v errs by, as its changes change: so much goes along one direction
ALONG = 0.3  # of what forces answer to it: so much goes another way at most
SAME = 0.6, 1.7  # of the frequency that they give along it, by turns: steps near h omega = 2 go 1.57 times as fast
CARRIED = 0.7  # of that frequency: constraint forces alone give as much


def followed(engine: Engine, history: History, state: State, covered: float, tolerances: Tolerances) -> str:
    """Which vibration the last steps to ``state`` follow, in words with a remedy; or none.

    ``covered``: by how much coordinates have changed on the way there, at most.
    """
    found, h = None, 0.0
    for apart in APART:
        t, v = history.last((ROWS - 1) * apart + 1, (0, 3))
        if found or len(t) <= (ROWS - 1) * apart:
            break
        found, h = _leading(t[::apart, 0], v[::apart], tolerances), abs(float(t[-1, 0] - t[0, 0])) / (len(t) - 1)
    if not found:
        return ""
    along, turning = found
    with suppress(BudgetSpent, NonFiniteValue):
        omega = _frequency(engine, state, along)
        if not (SAME[0] * omega < turning < SAME[1] * omega and omega * covered > FASTER * state.size_v):
            return ""
        if fastest(engine, state) > CARRIED * omega:
            return _carried(engine, omega, h)
        return (
            f"Forces carry a vibration of {omega:.3g} rad/s, far faster than the motion, and steps of {h:.2g} s follow it, "
            "since it is larger than the tolerance; begin with the spring in balance, damp it, or loosen the tolerance."
        )
    return ""


def _leading(t: Vector, v: Matrix, tolerances: Tolerances) -> tuple[Vector, float] | None:
    """The direction (n,) along which v (k, n) bends most beside the tolerances, and how fast it turns there [1/s].

    What bends v, its second differences, is what a step errs by.  None where no one direction leads, or it hardly turns.
    """
    n, h = v.shape[1], np.diff(t)
    weights = allowed(tolerances.rtol[n:], tolerances.atol[n:], v[0], np.abs(v).max(axis=0))
    bent = np.diff(np.diff(v, axis=0) / h[:, None], axis=0) / weights
    size = float(np.abs(bent).max(initial=0.0))
    if not 0.0 < size < math.inf:
        return None
    turned, share, way = np.linalg.svd(bent / size, full_matrices=False)
    if not share[0] ** 2 > LEADS * float(share @ share):
        return None
    turns = np.count_nonzero(turned[1:, 0] * turned[:-1, 0] < 0.0)
    return (way[0] * weights, math.pi * turns / abs(float(t[-2] - t[1]))) if turns >= TURNS else None


def _frequency(engine: Engine, at: State, along: Vector) -> float:
    """omega [1/s] that forces and reactions give a vibration ``along`` (n,) a direction about ``at``, by a difference.

    omega^2 is Rayleigh's quotient of ``-dv'/dq`` and of the mass; 0 where the direction is none of a vibration.
    """
    step = BENT * (float(np.abs(at.q).max()) or 1.0) / max(float(np.abs(along).max()), TINY)
    ahead, behind = (engine.acceleration.solve(at.t, at.q + s * along, at.v).vdot for s in (step, -step))
    mass, answer = Projection(engine.dynamics).mass(at.t, at.q), (behind - ahead) / (2.0 * step)
    squared = float(answer @ (mass @ along)) / float(along @ (mass @ along))
    aside = answer - squared * along
    is_mode = squared > 0.0 and float(aside @ (mass @ aside)) < ALONG**2 * squared * float(answer @ (mass @ along))
    return math.sqrt(squared) if is_mode else 0.0


def _carried(engine: Engine, omega: float, h: float) -> str:
    """That steps of ``h`` [s] follow a vibration that constraint forces carry, in words with a remedy; or none."""
    told = f"Constraint forces carry a vibration of {omega:.3g} rad/s, far faster than the motion, and steps of"
    told += f" {h:.2g} s follow it"
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
