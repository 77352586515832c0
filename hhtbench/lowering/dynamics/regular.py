"""Singular systems made regular: redundant constraints left out, and a mass matrix that is singular augmented.

Where rows of ``[g_q; k_v]`` depend on others and the start satisfies all of them, the motion is determined but the
multipliers are not: adding to them a vector of the null space of ``C^T`` changes nothing.  Independent rows give the same
motion; of all multipliers with the same reaction ``C^T [lam; mu]`` the one of smallest norm is reported, (H22).

Where the mass is singular but the KKT matrix is regular: on the solution ``C vdot + c = 0`` with ``C = [g_q; k_v]``, so
adding ``C^T R (C vdot + c)`` to the equations changes nothing there: ``(M + C^T R C) vdot = F - C^T R c + Q``.  The
new mass is positive definite exactly where M is positive definite on the null space of C.  Solving with the KKT matrix
inside every f instead would put the reaction into f and leave nothing for the two stage multipliers of the extended HHT
method.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.lowering.dynamics.mass import mass_at
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import declared

LINEAR = 1e-8  # change of k_v with v, relative: the error of fourth-order differences is far below
_changed = Cache(64)


class ReducedDynamics(Wrapper):
    """The functions of ``inner`` with the rows ``position`` of g and ``velocity`` of k only."""

    position: tuple[int, ...] = eqx.field(static=True)  #: kept rows of g
    velocity: tuple[int, ...] = eqx.field(static=True)  #: kept rows of k

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        return replace(self.inner.structure, m=len(self.position), p=len(self.velocity))

    def call(self, name: str, *arguments: Any) -> Any:
        """Functions of k and Q_k are called velocity_...; to Q and Q_k multipliers of the rows left out are zero."""
        whole = self.inner.structure
        rows, size = (self.velocity, whole.p) if name.startswith("velocity") else (self.position, whole.m)
        kept = np.array(rows, dtype=int)
        if "reaction" in name:
            *place, multipliers = arguments
            arguments = *place, self.xp.asarray(np.eye(size)[:, kept]) @ multipliers
        value = super().call(name, *arguments)
        if name.endswith("reaction_jacobians"):
            *others, by_multipliers = value
            return *others, by_multipliers[:, kept]
        if name == "reaction_columns":
            return value[:, kept]
        return value[kept] if "constraint" in name else value


class FullMatrices(Wrapper):
    """The functions of ``inner``, of which none is to be replaced by products without full matrices."""


def with_full_matrices(dynamics: Dynamics) -> FullMatrices:
    """``dynamics``, remembered."""
    found: FullMatrices = _remembered(dynamics, "full", lambda: FullMatrices(inner=dynamics))
    return found


def reduce_redundant(dynamics: Dynamics, redundant: tuple[int, ...]) -> ReducedDynamics | None:
    """``dynamics`` without the rows ``redundant`` of [g; k]; None where a declared reaction may need their multipliers."""
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")):
        return None
    s = dynamics.structure
    position = tuple(i for i in range(s.m) if i not in redundant)
    velocity = tuple(i for i in range(s.p) if s.m + i not in redundant)
    return _remembered(dynamics, redundant, lambda: ReducedDynamics(inner=dynamics, position=position, velocity=velocity))


def _remembered(dynamics: Dynamics, how: Hashable, change: Callable[[], Wrapper]) -> Any:
    """``dynamics`` as it was changed before in the same way: what was prepared for that serves again."""
    return _changed.find((by_id(dynamics), how), change)


def unreduced(dynamics: Dynamics) -> Dynamics:
    """The dynamics with all rows of the constraints."""
    kept = _reduction(dynamics)
    return dynamics if kept is None else kept.inner


def redundant_rows(dynamics: Dynamics) -> tuple[int, ...]:
    """Rows of [g; k] that ``dynamics`` leaves out."""
    kept = _reduction(dynamics)
    if kept is None:
        return ()
    s = kept.inner.structure
    left = (*kept.position, *(s.m + i for i in kept.velocity))
    return tuple(i for i in range(s.m + s.p) if i not in set(left))


def padded(dynamics: Dynamics, lam: Matrix, mu: Matrix) -> tuple[Matrix, Matrix]:
    """Multipliers (k, kept) with a zero for every redundant row: (k, m) and (k, p), the same reaction."""
    whole, kept = unreduced(dynamics), _reduction(dynamics)
    if kept is None:
        return lam, mu
    full = np.zeros((len(lam), whole.structure.m)), np.zeros((len(mu), whole.structure.p))
    full[0][:, list(kept.position)] = lam
    full[1][:, list(kept.velocity)] = mu
    return full


def _reduction(dynamics: Dynamics) -> ReducedDynamics | None:
    inner: Any = dynamics
    while type(inner).wraps and type(inner) is not ReducedDynamics:
        inner = inner.inner
    return inner if type(inner) is ReducedDynamics else None


class AugmentedDynamics(Wrapper):
    """The functions of ``inner`` with mass ``M + C^T R C`` and force ``F - C^T R c``, (H19).

    Velocity constraints take part only where ``k_v`` does not depend on v, since the mass may not.
    """

    weights: Any  #: (rows,) diagonal of R

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        return replace(self.inner.structure, mass="variable", force_uses_q=True, force_uses_v=True)

    def _stacked(self, of_position: Callable[[], Any], of_velocity: Callable[[], Any]) -> Any:
        """What the rows of g and of k have, those that take part."""
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
        """(F_q, F_v), each (n, n); of order 4 where they are differences, since c holds 1e-9 of difference error."""
        return self.jacobian(lambda x: self.force(t, x, v), q), self.jacobian(lambda x: self.force(t, q, x), v)


def augment(dynamics: Dynamics, t: float, q: Vector) -> AugmentedDynamics:
    """``dynamics`` with a regular mass; the weights make what every row adds as large as the mass at (t, q).

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
    found: AugmentedDynamics = _remembered(dynamics, tuple(weights.tolist()), augmented)
    return found


def rows_of_mass(dynamics: Dynamics, t: Any, q: Any) -> Any:
    """C (rows, n) of the constraints that take part in an augmented mass."""
    return AugmentedDynamics(inner=dynamics, weights=None).rows(t, q)


def _with_known_velocity_rows(dynamics: Any, t: float, q: Vector) -> Dynamics:
    """A NumPy system cannot be read: whether its k is linear in v is measured, at rest and at two velocities."""
    if type(dynamics) is ReducedDynamics and dynamics.xp is np:
        return replace(dynamics, inner=_with_known_velocity_rows(dynamics.inner, t, q))
    if dynamics.xp is not np or dynamics.wraps or not dynamics.structure.p:
        return dynamics
    at_rest = dynamics.velocity_constraint_jacobian(t, q, np.zeros(q.size))
    places = np.arange(1.0, q.size + 1)
    moving = [dynamics.velocity_constraint_jacobian(t, q, v) for v in (np.cos(places), 10.0 * np.sin(places))]
    uses_v = any(np.abs(rows - at_rest).max() > LINEAR * np.abs(at_rest).max() for rows in moving)
    return replace(dynamics, structure=replace(dynamics.structure, velocity_jacobian_uses_v=bool(uses_v)))
