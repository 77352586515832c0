"""Derived functions of a :class:`~hhtbench.protocol.NumpySystem`; what it does not declare comes from differences.

Callbacks get read-only copies and a plain float t; results are copied, and checked for type, shape and finiteness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.counting import check_clock
from hhtbench.lowering.dynamics.diagonal import full
from hhtbench.lowering.dynamics.differences import NESTED, derivative, derivative_along, second_derivative_along
from hhtbench.lowering.dynamics.dynamics import EquationsOfMotion
from hhtbench.lowering.dynamics.shapes import checked_result, expect_pair
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.protocol import SIGNATURES, NumpySystem, declared


@dataclass(frozen=True)
class NumpyDynamics(EquationsOfMotion):
    """The functions of :class:`~hhtbench.lowering.dynamics.jax_dynamics.JaxDynamics` on NumPy arrays."""

    system: NumpySystem
    structure: Structure
    ignored: tuple[str, ...] = ()
    constant_mass: Any = None
    inverse_mass: Any = None
    on_call: Callable[[str], None] = check_clock  #: told the name of every callback before it is called

    @property
    def xp(self) -> Any:
        """The array namespace of this dynamics."""
        return np

    def _given(self, name: str) -> Any:
        return None if name in self.ignored else declared(self.system, name)

    @cached_property
    def _shapes(self) -> dict[str, tuple[tuple[int, ...], ...]]:
        s = self.structure
        return {name: signature.shapes(s.n, s.m, s.p) for name, signature in SIGNATURES.items()}

    def _call(self, name: str, t: Any, *arguments: Any) -> Any:
        """The checked result of the callback ``name``, an array or a pair."""
        self.on_call(name)
        copies = [np.array(argument, dtype=np.float64) for argument in arguments]
        for copy in copies:
            copy.setflags(write=False)
        value, shapes = getattr(self.system, name)(float(t), *copies), self._shapes[name]
        if len(shapes) == 1:
            return checked_result(name, value, shapes[0], float(t))
        return tuple(
            None if part is None else checked_result(f"{name}[{i}]", part, shape, float(t))
            for i, (part, shape) in enumerate(zip(expect_pair(name, value, shapes), shapes, strict=True))
        )

    def _difference(self, name: str, function: Callable[[Any], Any], x: Any, order: int = 4) -> Any:
        pattern = (declared(self.system, "sparsity") or {}).get(name)
        return derivative(function, x, order, pattern)

    def _order(self, *names: str) -> int:
        """Order of differences of a function that comes from the first of ``names`` declared, else from differences."""
        return 1 if any(self._given(name) is not None for name in names) else NESTED

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """F (n,)."""
        return self._call("force", t, q, v)

    def mass(self, t: Any, q: Any) -> Any:
        """M (n, n)."""
        n = self.structure.n
        if self.structure.mass == "variable":
            return self._call("mass_matrix", t, q)
        return np.eye(n) if self.constant_mass is None else full(self.constant_mass, np)

    def mass_product_jacobian(self, t: Any, q: Any, x: Any) -> Any:
        """Derivative of ``M(t, q) x`` by q, (n, n)."""
        return self._difference("mass_product_jacobian", lambda y: self.mass(t, y) @ x, q, order=1)

    def force_jacobians(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """(F_q, F_v), each (n, n), None for one that is zero; first-order differences serve Newton's matrix."""
        if self._given("force_jacobians") is not None:
            return self._call("force_jacobians", t, q, v)
        by_q = self._difference("force_q", lambda x: self.force(t, x, v), q, order=1)
        return by_q, self._difference("force_v", lambda x: self.force(t, q, x), v, order=1)

    def constraint(self, t: Any, q: Any) -> Any:
        """The position constraints g (m,)."""
        return self._call("constraint", t, q)

    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """g_q (m, n)."""
        if self._given("constraint_jacobian") is not None:
            return self._call("constraint_jacobian", t, q)
        return self._difference("constraint_jacobian", lambda x: self.constraint(t, x), q)

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        """g_t (m,)."""
        if self._given("constraint_time_derivative") is not None:
            return self._call("constraint_time_derivative", t, q)
        return derivative_along(lambda e: self.constraint(t + e, q), float(t), q, 0.0 * q)

    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        """g_t + g_q v (m,), the constraint at the velocity level."""
        return self.constraint_jacobian(t, q) @ v + self.constraint_time_derivative(t, q)

    def constraint_velocity_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Derivative of ``g_t + g_q v`` by q, (m, n)."""
        return self._difference(
            "constraint_jacobian", lambda x: self.constraint_velocity(t, x, v), q, self._order("constraint_jacobian")
        )

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """(m,): g_tt + 2 g_tq v + g_qq(v, v), so that g'' = g_q vdot + this."""
        if self._given("constraint_acceleration") is not None:
            return self._call("constraint_acceleration", t, q, v)
        if self._given("constraint_jacobian") is None:
            return second_derivative_along(lambda e: self.constraint(t + e, q + e * v), float(t), q, v)
        return derivative_along(lambda e: self.constraint_velocity(t + e, q + e * v, v), float(t), q, v)

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """The velocity constraints k (p,)."""
        return self._call("velocity_constraint", t, q, v)

    def velocity_constraint_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """k_v (p, n)."""
        if self._given("velocity_constraint_jacobian") is not None:
            return self._call("velocity_constraint_jacobian", t, q, v)
        return self._difference("velocity_constraint_jacobian", lambda x: self.velocity_constraint(t, q, x), v)

    def velocity_constraint_position_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """k_q (p, n)."""
        return self._difference("velocity_constraint_q", lambda x: self.velocity_constraint(t, x, v), q, order=1)

    def velocity_constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """(p,): k_t + k_q v, so that k' = k_v vdot + this."""
        return derivative_along(lambda e: self.velocity_constraint(t + e, q + e * v, v), float(t), q, v)

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """Q (n,) of the position constraints, -g_q^T lam unless declared."""
        if declared(self.system, "reaction") is not None:
            return self._call("reaction", t, q, lam)
        return -(lam @ self.constraint_jacobian(t, q))

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> tuple[Any, Any]:
        """(Q_q (n, n), Q_lam (n, m))."""
        if self._given("reaction_jacobians") is not None:
            return self._call("reaction_jacobians", t, q, lam)
        order = self._order("reaction", "constraint_jacobian")
        by_q = self._difference("reaction_q", lambda x: self.reaction(t, x, lam), q, order)
        if declared(self.system, "reaction") is None:
            return by_q, -self.constraint_jacobian(t, q).T
        return by_q, derivative(lambda x: self.reaction(t, q, x), lam, 1)

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        """Q (n,) of the velocity constraints, -k_v^T mu unless declared."""
        if declared(self.system, "velocity_reaction") is not None:
            return self._call("velocity_reaction", t, q, v, mu)
        return -(mu @ self.velocity_constraint_jacobian(t, q, v))

    def velocity_reaction_jacobians(self, t: Any, q: Any, v: Any, mu: Any) -> tuple[Any, Any]:
        """(derivative by v (n, n), derivative by mu (n, p)) of the velocity reaction."""
        order = self._order("velocity_reaction", "velocity_constraint_jacobian")
        by_v = derivative(lambda x: self.velocity_reaction(t, q, x, mu), v, order)
        if declared(self.system, "velocity_reaction") is None:
            return by_v, -self.velocity_constraint_jacobian(t, q, v).T
        return by_v, derivative(lambda x: self.velocity_reaction(t, q, v, x), mu, 1)
