"""Position and velocity level of the constraints at a point, with Jacobians: for starts, drift and rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering.compiling import compile_function


@dataclass(frozen=True)
class Levels:
    """Constraint values and Jacobians at one point."""

    position: Vector  #: (m,) g
    time_derivative: Vector  #: (m,) g_t
    position_jacobian: Matrix  #: (m, n) g_q
    velocity: Vector  #: (p,) k
    velocity_jacobian: Matrix  #: (p, n) k_v
    velocity_drift: Vector  #: (m + p,) g_t + g_q v, then k

    def scaled_position(self, s_q: Any) -> Vector:
        """|g_i| / sum_j |g_q,ij| s_q,j, (m,): the distance from the constraint in units of the typical size."""
        return _relative(
            self.position, np.abs(self.position_jacobian) @ np.broadcast_to(s_q, self.position_jacobian.shape[1])
        )

    def scaled_velocity(self, s_v: Any) -> Vector:
        """The velocity level, |g_t + g_q v| and |k|, each over its row's size; (m + p,)."""
        rows = np.concatenate([self.position_jacobian, self.velocity_jacobian], axis=0)
        size = np.abs(rows) @ np.broadcast_to(s_v, rows.shape[1])
        size[: self.time_derivative.size] += np.abs(self.time_derivative)
        return _relative(self.velocity_drift, size)


class ConstraintLevels:
    """Evaluates :class:`Levels` of one system; calls nothing of a level that is not declared."""

    def __init__(self, dynamics: Any) -> None:
        self.structure = dynamics.structure
        self._terms = compile_function(level_terms, dynamics) if self.structure.constrained else None

    def at(self, t: float, q: Vector, v: Vector) -> Levels:
        """The levels at (t, q, v)."""
        n, m, p = self.structure.n, self.structure.m, self.structure.p
        if self._terms is None:
            nothing = np.zeros(0)
            return Levels(nothing, nothing, np.zeros((0, n)), nothing, np.zeros((0, n)), nothing)
        parts = np.split(np.asarray(self._terms(t, q, v)), np.cumsum([m, m, m * n, p, p * n]))
        return Levels(parts[0], parts[1], parts[2].reshape(m, n), parts[3], parts[4].reshape(p, n), parts[5])


def level_terms(dynamics: Any, t: Any, q: Any, v: Any) -> Any:
    """g, g_t, g_q, k, k_v and the velocity level, packed into one vector."""
    s, xp = dynamics.structure, dynamics.xp
    empty = xp.zeros(0)
    first, second, drift = [empty, empty, empty], [empty, empty], [empty]
    if s.m:
        jacobian = dynamics.constraint_jacobian(t, q)
        g_t = dynamics.constraint_time_derivative(t, q) if s.rheonomic else xp.zeros(s.m)
        first = [dynamics.constraint(t, q), g_t, jacobian.ravel()]
        drift.append(jacobian @ v + g_t)
    if s.p:
        k = dynamics.velocity_constraint(t, q, v)
        second = [k, dynamics.velocity_constraint_jacobian(t, q, v).ravel()]
        drift.append(k)
    return xp.concatenate([*first, *second, *drift])


def _relative(value: Vector, size: Vector) -> Vector:
    """|value| / size; a row without size counts as itself."""
    return np.abs(value) / np.where(size > 0, size, 1.0)
