"""A singular mass matrix made regular by a term from the constraints, (H19).

Used where the mass is singular but the KKT matrix is regular.  With ``C vdot + c = 0`` on the solution, ``C = [g_q; k_v]``,
adding ``C^T R (C vdot + c)`` changes nothing: ``(M + C^T R C) vdot = F - C^T R c + Q``.  The new mass is positive definite
exactly where M is positive definite on the null space of C.  Solving with the KKT matrix inside every f instead would
put the reaction into f and leave nothing for the two stage multipliers of the extended HHT method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.lowering.dynamics.mass import mass_at
from hhtbench.lowering.dynamics.regular import ReducedDynamics, remembered
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError

LINEAR = 1e-8  # change of k_v with v, relative: the error of fourth-order differences is far below


class AugmentedDynamics(Wrapper):
    """``inner`` with mass ``M + C^T R C`` and force ``F - C^T R c``, (H19).

    Velocity constraints take part only where ``k_v`` does not depend on v, since the mass must not.
    """

    weights: Any  #: (rows,) diagonal of R

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        return replace(self.inner.structure, mass="variable", force_uses_q=True, force_uses_v=True)

    def _stacked(self, of_position: Callable[[], Any], of_velocity: Callable[[], Any]) -> Any:
        """Stack values of the position rows g and, if they take part, the velocity rows k; called only where declared."""
        s = self.inner.structure
        parts = [of_position()] if s.m else []
        return self.xp.concatenate([*parts, of_velocity()] if s.p and not s.velocity_jacobian_uses_v else parts)

    def rows(self, t: Any, q: Any) -> Any:
        """C (rows, n) as a function of (t, q)."""
        at_rest = lambda: self.velocity_constraint_rows(t, q, 0.0 * q)  # noqa: E731
        return self._stacked(lambda: self.constraint_rows(t, q), at_rest)

    def mass(self, t: Any, q: Any) -> Any:
        rows = self.rows(t, q)
        return self.inner.mass(t, q) + rows.T @ (self.weights[:, None] * rows)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        rest = self._stacked(  # c (rows,)
            lambda: self.constraint_acceleration(t, q, v), lambda: self.velocity_constraint_acceleration(t, q, v)
        )
        return self.inner.force(t, q, v) - self.rows(t, q).T @ (self.weights * rest)

    def mass_product_jacobian(self, t: Any, q: Any, x: Any) -> Any:
        return self.jacobian(lambda y: self.mass(t, y) @ x, q)

    def force_jacobians(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """F_q and F_v, (n, n) each; differences are of order 4, since c has a difference error of 1e-9."""
        return self.jacobian(lambda x: self.force(t, x, v), q), self.jacobian(lambda x: self.force(t, q, x), v)


def augment(dynamics: Dynamics, t: float, q: Vector) -> AugmentedDynamics:
    """``dynamics`` with a regular mass; weights make the term of each row as large as the mass at (t, q).

    Raises
    ------
    ProblemError
        No constraint can take part: there are only velocity constraints, and they are nonlinear in v.
    """
    dynamics = _with_known_velocity_rows(dynamics, t, q)
    if not dynamics.structure.m and dynamics.structure.velocity_jacobian_uses_v:
        raise ProblemError(
            "the mass matrix is singular and the velocity constraints are nonlinear in v, so they cannot make it regular; "
            "give every coordinate a mass, or a position constraint, or a velocity constraint linear in v."
        )
    rows = np.asarray(compile_function(rows_of_mass, dynamics)(t, q))
    mass = np.asarray(compile_function(mass_at, dynamics)(t, q))
    largest = np.abs(rows).max(axis=1)
    weights = (np.abs(mass).max() or 1.0) / np.where(largest > 0.0, largest, 1.0) ** 2
    augmented = lambda: AugmentedDynamics(inner=dynamics, weights=dynamics.xp.asarray(weights))  # noqa: E731
    found: AugmentedDynamics = remembered(dynamics, tuple(weights.tolist()), augmented)
    return found


def rows_of_mass(dynamics: Dynamics, t: Any, q: Any) -> Any:
    """Rows C (rows, n) of the constraints that take part in an augmented mass."""
    return AugmentedDynamics(inner=dynamics, weights=None).rows(t, q)


def _with_known_velocity_rows(dynamics: Any, t: float, q: Vector) -> Dynamics:
    """For a NumPy system, determine numerically whether k is linear in v: at rest and at two velocities."""
    if type(dynamics) is ReducedDynamics and dynamics.xp is np:
        return replace(dynamics, inner=_with_known_velocity_rows(dynamics.inner, t, q))
    if dynamics.xp is not np or dynamics.wraps or not dynamics.structure.p:
        return dynamics
    at_rest = dynamics.velocity_constraint_jacobian(t, q, np.zeros(q.size))
    places = np.arange(1.0, q.size + 1)
    moving = [dynamics.velocity_constraint_jacobian(t, q, v) for v in (np.cos(places), 10.0 * np.sin(places))]
    uses_v = any(np.abs(rows - at_rest).max() > LINEAR * np.abs(at_rest).max() for rows in moving)
    return replace(dynamics, structure=replace(dynamics.structure, velocity_jacobian_uses_v=bool(uses_v)))
