"""Redundant constraints left out: the equations with independent rows only, and minimum-norm multipliers of all rows.

Where rows of ``[g_q; k_v]`` depend on others and the start satisfies all of them, the motion is determined but the
multipliers are not: adding to them a vector of the null space of ``C^T`` changes nothing.  Independent rows give the same
motion; of all multipliers with the same reaction ``C^T [lam; mu]`` the one of smallest norm is reported, (H22).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering.dynamics.dynamics import Dynamics, EquationsOfMotion
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.protocol import declared


class ReducedDynamics(eqx.Module, EquationsOfMotion):
    """The functions of ``inner`` with the rows ``position`` of g and ``velocity`` of k only; the rest is passed through."""

    inner: Dynamics
    position: tuple[int, ...] = eqx.field(static=True)  #: kept rows of g
    velocity: tuple[int, ...] = eqx.field(static=True)  #: kept rows of k

    @property
    def structure(self) -> Structure:
        """Sizes without the redundant rows."""
        return replace(self.inner.structure, m=len(self.position), p=len(self.velocity))

    def __getattr__(self, name: str) -> Any:
        if name in ("inner", "position", "velocity") or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.inner, name)

    def _of_g(self, rows: Any) -> Any:
        return rows[np.array(self.position, dtype=int)]

    def _of_k(self, rows: Any) -> Any:
        return rows[np.array(self.velocity, dtype=int)]

    def constraint(self, t: Any, q: Any) -> Any:
        """Kept rows of g."""
        return self._of_g(self.inner.constraint(t, q))

    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """Of g_q."""
        return self._of_g(self.inner.constraint_jacobian(t, q))

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        """Of g_t."""
        return self._of_g(self.inner.constraint_time_derivative(t, q))

    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        """Of g_t + g_q v."""
        return self._of_g(self.inner.constraint_velocity(t, q, v))

    def constraint_velocity_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Of its derivative by q."""
        return self._of_g(self.inner.constraint_velocity_jacobian(t, q, v))

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """Of g'' without g_q vdot."""
        return self._of_g(self.inner.constraint_acceleration(t, q, v))

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """Kept rows of k."""
        return self._of_k(self.inner.velocity_constraint(t, q, v))

    def velocity_constraint_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Of k_v."""
        return self._of_k(self.inner.velocity_constraint_jacobian(t, q, v))

    def velocity_constraint_position_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Of k_q."""
        return self._of_k(self.inner.velocity_constraint_position_jacobian(t, q, v))

    def velocity_constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """Of k' without k_v vdot."""
        return self._of_k(self.inner.velocity_constraint_acceleration(t, q, v))

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """-g_q^T lam (n,): that of all rows, the multipliers of the redundant ones zero."""
        return self.inner.reaction(t, q, _spread(self, lam, self.position, self.inner.structure.m))

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> tuple[Any, Any]:
        """(Q_q (n, n), Q_lam (n, kept))."""
        by_q, by_lam = self.inner.reaction_jacobians(t, q, _spread(self, lam, self.position, self.inner.structure.m))
        return by_q, by_lam[:, np.array(self.position, dtype=int)]

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        """-k_v^T mu (n,)."""
        return self.inner.velocity_reaction(t, q, v, _spread(self, mu, self.velocity, self.inner.structure.p))

    def velocity_reaction_jacobians(self, t: Any, q: Any, v: Any, mu: Any) -> tuple[Any, Any]:
        """(by v (n, n) or None, by mu (n, kept))."""
        spread = _spread(self, mu, self.velocity, self.inner.structure.p)
        by_v, by_mu = self.inner.velocity_reaction_jacobians(t, q, v, spread)
        return by_v, by_mu[:, np.array(self.velocity, dtype=int)]


def reduce_redundant(dynamics: Dynamics, redundant: tuple[int, ...]) -> ReducedDynamics | None:
    """``dynamics`` without the rows ``redundant`` of [g; k]; None where a declared reaction may need their multipliers."""
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")):
        return None
    s = dynamics.structure
    position = tuple(i for i in range(s.m) if i not in redundant)
    velocity = tuple(i for i in range(s.p) if s.m + i not in redundant)
    return ReducedDynamics(inner=dynamics, position=position, velocity=velocity)


def unreduced(dynamics: Dynamics) -> Dynamics:
    """The dynamics with all rows of the constraints."""
    kept = _reduction(dynamics)
    return dynamics if kept is None else kept.inner


def padded(dynamics: Dynamics, lam: Matrix, mu: Matrix) -> tuple[Matrix, Matrix]:
    """Multipliers (k, kept) with a zero for every redundant row: (k, m) and (k, p), the same reaction."""
    whole, kept = unreduced(dynamics), _reduction(dynamics)
    if kept is None:
        return lam, mu
    full = np.zeros((len(lam), whole.structure.m)), np.zeros((len(mu), whole.structure.p))
    full[0][:, list(kept.position)] = lam
    full[1][:, list(kept.velocity)] = mu
    return full


def smallest(rows: Matrix, multipliers: Vector, rank: int) -> Vector:
    """The multipliers of least norm with the same reaction ``rows^T multipliers``; ``rows`` (m + p, n) is [g_q; k_v].

    ``rank`` is that of the consistent configuration: off the constraints by an error, the rows are independent by as little,
    and a rank found by a tolerance would jump there.
    """
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(left[:, :rank] @ ((right[:rank] @ (rows.T @ multipliers)) / size[:rank]), dtype=np.float64)


def _reduction(dynamics: Dynamics) -> ReducedDynamics | None:
    inner: Any = dynamics
    while not isinstance(inner, ReducedDynamics):
        if not hasattr(inner, "rho"):
            return None
        inner = inner.inner
    return inner


def _spread(dynamics: ReducedDynamics, values: Any, kept: tuple[int, ...], size: int) -> Any:
    """``values`` at the kept places of a vector (size,) of zeros."""
    selection = np.zeros((size, len(kept)))
    selection[list(kept), np.arange(len(kept))] = 1.0
    return dynamics.inner.xp.asarray(selection) @ values
