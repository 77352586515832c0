"""What solvers know of a system: every term of its equations of motion as a function, however it is come by.

    M vdot = F + Q + Q_k,    0 = g,    0 = k

Implemented by ``JaxDynamics`` (automatic differentiation), ``NumpyDynamics`` (callbacks and differences) and, around one of
these, ``ReducedDynamics`` (redundant rows left out), ``AugmentedDynamics`` (a regular mass) and ``MatrixFree`` (products
instead of matrices).  Symbols, shapes and units are those of the table in :mod:`hhtbench.protocol`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Mapping
from typing import Any, Protocol

from hhtbench.lowering.dynamics.structure import Structure

Array = Any  # of the namespace ``xp``: NumPy's, JAX's, or a tracer that stands for one


class Dynamics(Protocol):
    """The terms of one system's equations of motion; pure functions, but for the counting of callbacks.

    Terms of constraints that are not declared have zero rows and are not called.
    """

    @property
    def system(self) -> Any:
        """The ``System`` or ``NumpySystem``, with what its user declared."""

    @property
    def structure(self) -> Structure:
        """Sizes n, m, p and what depends on what."""

    @property
    def xp(self) -> Any:
        """The array namespace: ``numpy`` or ``jax.numpy``."""

    @property
    def constant_mass(self) -> Any:
        """M (n, n) [kg, kg m^2] where it is constant, a large diagonal as ``Diagonal``; None: identity or variable."""

    @property
    def inverse_mass(self) -> Any:
        """M^-1 (n, n) [1/kg, 1/(kg m^2)], likewise; None also where a constant M is singular."""

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """F (n,) [N, N m]."""

    def force_jacobians(self, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """F_q (n, n) [N/m] and F_v (n, n) [N s/m]; None for one that is zero."""

    def mass(self, t: Array, q: Array) -> Array:
        """M (n, n) [kg, kg m^2]."""

    def mass_product(self, t: Array, q: Array, x: Array) -> Array:
        """M x (n,), x itself where M is the identity."""

    def mass_product_jacobian(self, t: Array, q: Array, x: Array) -> Array:
        """(M x)_q (n, n)."""

    def constraint(self, t: Array, q: Array) -> Array:
        """The position constraints g (m,) [m, rad]."""

    def constraint_jacobian(self, t: Array, q: Array) -> Array:
        """g_q (m, n)."""

    def constraint_time_derivative(self, t: Array, q: Array) -> Array:
        """g_t (m,) [m/s, rad/s]."""

    def constraint_velocity(self, t: Array, q: Array, v: Array) -> Array:
        """g_t + g_q v (m,) [m/s, rad/s]: dg/dt along the motion."""

    def constraint_velocity_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """(g_t + g_q v)_q (m, n)."""

    def constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        """g_tt + 2 g_tq v + g_qq(v, v) (m,) [m/s^2, rad/s^2]: d2g/dt2 is g_q vdot + this."""

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """The velocity constraints k (p,) [m/s, rad/s]."""

    def velocity_constraint_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """k_v (p, n)."""

    def velocity_constraint_position_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """k_q (p, n)."""

    def velocity_constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        """k_t + k_q v (p,) [m/s^2, rad/s^2]: dk/dt is k_v vdot + this."""

    def reaction(self, t: Array, q: Array, lam: Array) -> Array:
        """Q (n,) [N, N m] of the position constraints."""

    def reaction_jacobians(self, t: Array, q: Array, lam: Array) -> tuple[Array, Array]:
        """Q_q (n, n) and Q_lam (n, m)."""

    def velocity_reaction(self, t: Array, q: Array, v: Array, mu: Array) -> Array:
        """Q_k (n,) [N, N m] of the velocity constraints."""

    def velocity_reaction_jacobians(self, t: Array, q: Array, v: Array, mu: Array) -> tuple[Array, Array]:
        """Q_k by v (n, n), None where it is zero, and by mu (n, p)."""

    def residual(self, t: Array, q: Array, v: Array, inertia: Array, lam: Array, mu: Array) -> Array:
        """Imbalance of forces, M vdot - F - Q - Q_k (n,) [N, N m].

        ``inertia`` is M vdot (n,), from whoever has the matrix or the product at hand; 0.0 leaves minus the forces.
        """

    def acceleration_level(self, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """C = [g_q; k_v] (m + p, n) and c (m + p,) [m/s^2, rad/s^2]: C vdot + c is the constraints' last derivative."""


class EquationsOfMotion:
    """Members of :class:`Dynamics` that follow from the others, in every implementation by the same lines."""

    def mass_product(self: Dynamics, t: Array, q: Array, x: Array) -> Array:
        """M x (n,)."""
        return x if self.structure.mass == "identity" else self.mass(t, q) @ x

    def residual(self: Dynamics, t: Array, q: Array, v: Array, inertia: Array, lam: Array, mu: Array) -> Array:
        """M vdot - F - Q - Q_k (n,)."""
        balance = inertia - self.force(t, q, v)
        if self.structure.m:
            balance = balance - self.reaction(t, q, lam)
        if self.structure.p:
            balance = balance - self.velocity_reaction(t, q, v, mu)
        return balance

    def acceleration_level(self: Dynamics, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """C and c of C vdot + c."""
        rows, rest = [self.xp.zeros((0, self.structure.n))], [self.xp.zeros(0)]
        if self.structure.m:
            rows.append(self.constraint_jacobian(t, q))
            rest.append(self.constraint_acceleration(t, q, v))
        if self.structure.p:
            rows.append(self.velocity_constraint_jacobian(t, q, v))
            rest.append(self.velocity_constraint_acceleration(t, q, v))
        return self.xp.concatenate(rows), self.xp.concatenate(rest)


@functools.cache
def arguments_of(member: str) -> tuple[str, ...]:
    """Names of what a function of :class:`Dynamics` takes, such as ("t", "q", "lam")."""
    return tuple(inspect.signature(getattr(Dynamics, member)).parameters)[1:]


def evaluate(dynamics: Dynamics, member: str, at: Mapping[str, Any]) -> Any:
    """The function ``member`` of ``dynamics`` at the place whose quantities ``at`` holds by name."""
    return getattr(dynamics, member)(*(at[name] for name in arguments_of(member)))
