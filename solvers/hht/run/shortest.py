"""What the loops ask Python for, seldom: the acceleration level, and steps shorter than roundoff."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import ConstraintLevels
from hhtbench.lowering.dynamics.foreign import Callbacks
from solvers.hht.equations.formulas import EPS


class Shortest:
    """Callbacks of one engine."""

    def __init__(self, engine: Any) -> None:
        self.engine = engine

    def codes(self, callbacks: Callbacks) -> dict[str, tuple[int, int]]:
        """Addresses by name, as :class:`~solvers.hht.run.functions.Functions` has them."""
        s = self.engine.structure
        n, m, p = s.n, s.m, s.p
        inverse = n * n if s.mass == "variable" else 0
        level = callbacks.entry(self.acceleration_level, 1 + n + m + p, ((), (n,), (n,), (m,), (p,)))
        shortest = callbacks.entry(self.shortest, 1 + 5 * n + m + p + inverse, ((6 + 5 * n + m + p,), (2,)))
        return {"acceleration": (level, 0), "shortest": (shortest, 0)}

    def acceleration_level(self, t: float, q: Vector, v: Vector, lam: Vector, mu: Vector) -> Vector:
        """[1 where it is determined, else 0; lam (m,), mu (p,), v' (n,)], (H16)."""
        found = self.engine.acceleration.solve(t, q, v, lam, mu)
        return np.concatenate([[found.converged], found.lam, found.mu, found.vdot])

    def shortest(self, state: Vector, step: Vector) -> Vector:
        """(H21): [1; q, v, a, f, lam, mu, v', M^-1] at the end of a ``step`` [h, t1] from ``state``; [0; ...] without one.

        q and v move along v and the acceleration, if both levels hold as before: a drive may start from rest.
        """
        s, h, t1 = self.engine.structure, *step
        t, _, size_q, size_v = state[:4]
        cuts = 6 + np.cumsum([s.n, s.n, s.n, s.n, s.m, s.p])
        _, q, v, _, _, lam, mu, _ = np.split(state, [6, *cuts])
        found = self.engine.acceleration.solve(t, q, v, lam, mu)
        q1, v1 = q + h * v, v + h * found.vdot
        if not found.converged or not self._levels_kept((t, q, v), (t1, q1, v1), size_q, size_v):
            return np.zeros(1 + 5 * s.n + s.m + s.p + (s.n * s.n if s.mass == "variable" else 0))
        f1, inverse = self.engine.force(t1, q1, v1)
        end = [[1.0], q1, v1, f1, f1, found.lam, found.mu, found.vdot]
        return np.concatenate([*end, np.zeros(0) if inverse is None else inverse.ravel()])

    def _levels_kept(self, start: tuple[Any, ...], end: tuple[Any, ...], size_q: float, size_v: float) -> bool:
        """Whether neither constraint level is further from zero at the ``end`` (t, q, v) than at the ``start``."""
        levels = ConstraintLevels(self.engine.dynamics)
        before, after = levels.at(*start), levels.at(*end)
        room = 8 * EPS * np.abs(after.position_jacobian).sum(axis=1) * size_q
        velocity_room = 8 * EPS * np.abs(after.rows).sum(axis=1) * max(size_v, float(np.abs(end[2]).max()))
        return bool(
            np.all(np.abs(after.position) <= np.abs(before.position) + room)
            and np.all(np.abs(after.velocity_drift) <= np.abs(before.velocity_drift) + velocity_room)
        )
