"""Terms of a system that declares some of them: what is declared is called, the rest are derivatives of that."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from hhtbench.lowering.dynamics.diagonal import full
from hhtbench.lowering.dynamics.differences import NESTED
from hhtbench.lowering.dynamics.dynamics import Array, EquationsOfMotion
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.protocol import SIGNATURES, declared


def unless_declared(derive: Callable[..., Any]) -> Callable[..., Any]:
    """The user's function of that name where it is declared, and not to be ignored, else ``derive``."""

    @functools.wraps(derive)
    def term(self: DerivedDynamics, *arguments: Array) -> Any:
        declares = self.gives(derive.__name__)
        return self.call(derive.__name__, *arguments) if declares else derive(self, *arguments)

    return term


class DerivedDynamics(EquationsOfMotion):
    """The members of :class:`~.dynamics.Dynamics`, by ``call``, ``jacobian`` and ``rate`` of a subclass.

    Terms of undeclared constraints have zero rows and are never called by a solver.  Differences are of order 4 where a
    derivative enters the equations, less where it serves Newton's matrix.
    """

    system: Any
    structure: Structure
    ignored: tuple[str, ...]  #: declared derivatives that are not to be trusted
    constant_mass: Any
    inverse_mass: Any
    xp: Any
    call: Callable[..., Any]  #: (name, t, *arguments): the value of a declared function
    jacobian: Callable[..., Array]  #: (function, x, pattern, order): derivative (rows, k) of a function (rows,) at x (k,)
    rate: Callable[..., Array]  #: (function, t, q, v): d/de of function(t + e, q + e v) at e = 0

    def gives(self, name: str) -> bool:
        """Whether the user declares the function ``name``, and it is not to be ignored."""
        return name in SIGNATURES and name not in self.ignored and declared(self.system, name) is not None

    def _order(self, *names: str) -> int:
        """Order of differences of a function that comes from the first of ``names`` declared, else from differences."""
        return 1 if any(self.gives(name) for name in names) else NESTED

    def force(self, t: Array, q: Array, v: Array) -> Array:
        return self.call("force", t, q, v)

    @unless_declared
    def force_jacobians(self, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """(F_q, F_v), each (n, n), None for one that is zero."""
        s = self.structure
        by_q = self.jacobian(lambda x: self.force(t, x, v), q, "force_q", 1) if s.force_uses_q else None
        return by_q, self.jacobian(lambda x: self.force(t, q, x), v, "force_v", 1) if s.force_uses_v else None

    def mass(self, t: Array, q: Array) -> Array:
        if self.structure.mass == "variable":
            return self.call("mass_matrix", t, q)
        return self.xp.eye(self.structure.n) if self.constant_mass is None else full(self.constant_mass, self.xp)

    @unless_declared
    def mass_product_jacobian(self, t: Array, q: Array, x: Array) -> Array:
        return self.jacobian(lambda y: self.mass(t, y) @ x, q, "mass_product_jacobian", 1)

    def constraint(self, t: Array, q: Array) -> Array:
        return self.call("constraint", t, q)

    @unless_declared
    def constraint_jacobian(self, t: Array, q: Array) -> Array:
        return self.jacobian(lambda x: self.constraint(t, x), q, "constraint_jacobian")

    @unless_declared
    def constraint_time_derivative(self, t: Array, q: Array) -> Array:
        return self.rate(lambda s, _: self.constraint(s, q), t, q, 0.0 * q)

    def constraint_velocity(self, t: Array, q: Array, v: Array) -> Array:
        along = self.constraint_jacobian(t, q) @ v
        return along + self.constraint_time_derivative(t, q) if self.structure.rheonomic else along

    @unless_declared
    def constraint_velocity_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        order = self._order("constraint_jacobian")
        return self.jacobian(lambda x: self.constraint_velocity(t, x, v), q, "constraint_jacobian", order)

    @unless_declared
    def constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        return self.rate(lambda s, x: self.constraint_velocity(s, x, v), t, q, v)

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        return self.call("velocity_constraint", t, q, v)

    @unless_declared
    def velocity_constraint_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        return self.jacobian(lambda x: self.velocity_constraint(t, q, x), v, "velocity_constraint_jacobian")

    @unless_declared
    def velocity_constraint_position_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        return self.jacobian(lambda x: self.velocity_constraint(t, x, v), q, "velocity_constraint_q", 1)

    @unless_declared
    def velocity_constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        return self.rate(lambda s, x: self.velocity_constraint(s, x, v), t, q, v)

    @unless_declared
    def reaction(self, t: Array, q: Array, lam: Array) -> Array:
        """Q (n,), -g_q^T lam unless declared."""
        return -(lam @ self.constraint_jacobian(t, q))

    @unless_declared
    def reaction_jacobians(self, t: Array, q: Array, lam: Array) -> tuple[Array, Array]:
        order = self._order("reaction", "constraint_jacobian")
        by_q = self.jacobian(lambda x: self.reaction(t, x, lam), q, "reaction_q", order)
        if not self.gives("reaction"):
            return by_q, -self.constraint_jacobian(t, q).T
        return by_q, self.jacobian(lambda x: self.reaction(t, q, x), lam, order=1)

    @unless_declared
    def velocity_reaction(self, t: Array, q: Array, v: Array, mu: Array) -> Array:
        """Q_k (n,), -k_v^T mu unless declared."""
        return -(mu @ self.velocity_constraint_jacobian(t, q, v))

    @unless_declared
    def velocity_reaction_jacobians(self, t: Array, q: Array, v: Array, mu: Array) -> tuple[Array, Array]:
        """(Q_k by v (n, n), None where it is zero, and by mu (n, p))."""
        by_v = None
        if self.structure.velocity_reaction_uses_v:
            order = self._order("velocity_reaction", "velocity_constraint_jacobian")
            by_v = self.jacobian(lambda x: self.velocity_reaction(t, q, x, mu), v, order=order)
        if not self.gives("velocity_reaction"):
            return by_v, -self.velocity_constraint_jacobian(t, q, v).T
        return by_v, self.jacobian(lambda x: self.velocity_reaction(t, q, v, x), mu, order=1)
