"""What the loops ask Python for where no machine code serves: forces, acceleration level, steps shorter than roundoff."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import Dynamics
from hhtbench.lowering.dynamics.foreign import Callbacks
from solvers._start import of_dynamics
from solvers.hht.equations.formulas import EPS
from solvers.hht.run.leaps import leaping

if TYPE_CHECKING:
    from solvers.hht.run.engine import Engine

Codes = dict[str, tuple[int, int]]  # addresses of functions and of their parameters, by name


def python_codes(engine: Engine, callbacks: Callbacks) -> Codes:
    """Addresses of functions in Python for ``engine``, where others may take their place."""
    s = engine.structure
    n, m, p = s.n, s.m, s.p
    inverse = n * n if s.mass == "variable" else 0
    level = callbacks.entry(partial(acceleration_level, engine), 1 + n + m + p, ((), (n,), (n,), (m,), (p,)))
    shapes = (6 + 5 * n + m + p,), (2,)
    shortest = callbacks.entry(partial(shortest_step, engine), 1 + 5 * n + m + p + inverse, shapes)
    force = callbacks.entry(engine.bare_force, n + inverse, ((), (n,), (n,)))
    leap = callbacks.entry(partial(leaping, engine), n + 1, ((6 + 2 * n,), (n,), (n,), (2,)))
    return {"acceleration": (level, 0), "shortest": (shortest, 0), "force": (force, 0), "leap": (leap, 0)}


def acceleration_level(engine: Engine, t: float, q: Vector, v: Vector, lam: Vector, mu: Vector) -> Vector:
    """[1 where it is determined, else 0; lam (m,), mu (p,), v' (n,)], (H16)."""
    found = engine.acceleration.solve(t, q, v, lam, mu)
    return np.concatenate([[found.converged], found.lam, found.mu, found.vdot])


def shortest_step(engine: Engine, state: Vector, step: Vector) -> Any:
    """(H21): [1; q, v, a, f, lam, mu, v', M^-1] at the end of a ``step`` [h, t1] from ``state``; zero without one.

    q and v move along v and the acceleration, if both levels hold as before: a drive may start from rest.
    """
    s, h, t1 = engine.structure, *step
    t, _, size_q, size_v = state[:4]
    _, q, v, _, _, lam, mu, _ = np.split(state, [6, *(6 + np.cumsum([s.n, s.n, s.n, s.n, s.m, s.p]))])
    found = engine.acceleration.solve(t, q, v, lam, mu)
    q1, v1 = q + h * v, v + h * found.vdot
    if not found.converged or not _levels_hold(engine.dynamics, (t, q, v), (t1, q1, v1), size_q, size_v):
        return 0.0
    f1, inverse = engine.force(t1, q1, v1)
    near = found.vdot if engine.method.total else f1
    end = [[1.0], q1, v1, near, near, found.lam, found.mu, found.vdot]
    return np.concatenate([*end, np.zeros(0) if inverse is None else inverse.ravel()])


def _levels_hold(dynamics: Dynamics, start: tuple[Any, ...], end: tuple[Any, ...], size_q: float, size_v: float) -> bool:
    """Whether neither constraint level is further from zero at the ``end`` (t, q, v) than at the ``start``."""
    levels = of_dynamics(dynamics).levels
    before, after = levels.at(*start), levels.at(*end)
    room = 8 * EPS * np.abs(after.position_jacobian).sum(axis=1) * size_q
    velocity_room = 8 * EPS * np.abs(after.rows).sum(axis=1) * max(size_v, float(np.abs(end[2]).max()))
    return bool(
        np.all(np.abs(after.position) <= np.abs(before.position) + room)
        and np.all(np.abs(after.velocity_drift) <= np.abs(before.velocity_drift) + velocity_room)
    )
