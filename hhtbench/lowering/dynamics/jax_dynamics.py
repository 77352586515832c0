"""Derived functions of a JAX system by automatic differentiation.  Pure: they can be traced and compiled."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hhtbench.lowering.dynamics.diagonal import full
from hhtbench.lowering.dynamics.dynamics import EquationsOfMotion
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.protocol import System, declared


class JaxDynamics(eqx.Module, EquationsOfMotion):
    """Every term of the equations of motion as a pure function; a pytree, so parameters are traced, not baked in.

    Shapes as in the table of symbols.  A function exists for every level, but those of undeclared
    constraints have zero rows and are never called by a solver.
    """

    system: System
    structure: Structure = eqx.field(static=True)
    ignored: tuple[str, ...] = eqx.field(static=True, default=())  #: declared derivatives that are not to be trusted
    constant_mass: Any = None  #: (n, n) when the mass is a constant, a large diagonal as such
    inverse_mass: Any = None  #: (n, n) its inverse, likewise

    @property
    def xp(self) -> Any:
        """The array namespace of this dynamics."""
        return jnp

    def _given(self, name: str) -> Any:
        return None if name in self.ignored else declared(self.system, name)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """F (n,)."""
        return self.system.force(t, q, v)  # type: ignore[attr-defined]

    def mass(self, t: Any, q: Any) -> Any:
        """M (n, n)."""
        if self.structure.mass == "variable":
            return self.system.mass_matrix(t, q)  # type: ignore[attr-defined]
        return jnp.eye(self.structure.n) if self.constant_mass is None else full(self.constant_mass, jnp)

    def mass_product_jacobian(self, t: Any, q: Any, x: Any) -> Any:
        """Derivative of ``M(t, q) x`` by q, (n, n)."""
        return jax.jacfwd(lambda y: self.mass(t, y) @ x)(q)

    def force_jacobians(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """(F_q, F_v), each (n, n), None for one that is zero."""
        given = self._given("force_jacobians")
        if given is not None:
            return given(t, q, v)
        by_q = jax.jacfwd(self.force, 1)(t, q, v) if self.structure.force_uses_q else None
        by_v = jax.jacfwd(self.force, 2)(t, q, v) if self.structure.force_uses_v else None
        return by_q, by_v

    def constraint(self, t: Any, q: Any) -> Any:
        """The position constraints g (m,)."""
        return self.system.constraint(t, q)  # type: ignore[attr-defined]

    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """g_q (m, n)."""
        given = self._given("constraint_jacobian")
        return given(t, q) if given is not None else jax.jacfwd(self.constraint, 1)(t, q)

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        """g_t (m,)."""
        given = self._given("constraint_time_derivative")
        if given is not None:
            return given(t, q)
        return jax.jacfwd(self.constraint, 0)(jnp.asarray(t, dtype=float), q)

    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        """g_t + g_q v (m,), the constraint at the velocity level."""
        along = self.constraint_jacobian(t, q) @ v
        return along + self.constraint_time_derivative(t, q) if self.structure.rheonomic else along

    def constraint_velocity_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Derivative of ``g_t + g_q v`` by q, (m, n)."""
        return jax.jacfwd(self.constraint_velocity, 1)(t, q, v)

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """(m,): g_tt + 2 g_tq v + g_qq(v, v), so that g'' = g_q vdot + this."""
        given = self._given("constraint_acceleration")
        if given is not None:
            return given(t, q, v)
        t = jnp.asarray(t, dtype=float)
        return jax.jvp(lambda s, x: self.constraint_velocity(s, x, v), (t, q), (jnp.ones_like(t), v))[1]

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """The velocity constraints k (p,)."""
        return self.system.velocity_constraint(t, q, v)  # type: ignore[attr-defined]

    def velocity_constraint_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """k_v (p, n)."""
        given = self._given("velocity_constraint_jacobian")
        return given(t, q, v) if given is not None else jax.jacfwd(self.velocity_constraint, 2)(t, q, v)

    def velocity_constraint_position_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """k_q (p, n)."""
        return jax.jacfwd(self.velocity_constraint, 1)(t, q, v)

    def velocity_constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """(p,): k_t + k_q v, so that k' = k_v vdot + this."""
        t = jnp.asarray(t, dtype=float)
        return jax.jvp(lambda s, x: self.velocity_constraint(s, x, v), (t, q), (jnp.ones_like(t), v))[1]

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """Q (n,) of the position constraints, -g_q^T lam unless declared."""
        given = declared(self.system, "reaction")
        return given(t, q, lam) if given is not None else -(lam @ self.constraint_jacobian(t, q))

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> tuple[Any, Any]:
        """(Q_q (n, n), Q_lam (n, m))."""
        given = self._given("reaction_jacobians")
        if given is not None:
            return given(t, q, lam)
        return jax.jacfwd(self.reaction, 1)(t, q, lam), jax.jacfwd(self.reaction, 2)(t, q, lam)

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        """Q (n,) of the velocity constraints, -k_v^T mu unless declared."""
        given = declared(self.system, "velocity_reaction")
        return given(t, q, v, mu) if given is not None else -(mu @ self.velocity_constraint_jacobian(t, q, v))

    def velocity_reaction_jacobians(self, t: Any, q: Any, v: Any, mu: Any) -> tuple[Any, Any]:
        """(derivative by v (n, n) or None if zero, derivative by mu (n, p)) of the velocity reaction."""
        by_v = jax.jacfwd(self.velocity_reaction, 2)(t, q, v, mu) if self.structure.velocity_reaction_uses_v else None
        return by_v, jax.jacfwd(self.velocity_reaction, 3)(t, q, v, mu)
