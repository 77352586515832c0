"""Terms of a JAX system by automatic differentiation; pure, so that they can be traced and compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, plain_attributes
from hhtbench.lowering.flattening import traced_once
from hhtbench.mechanics.forces import tensions_in_use
from hhtbench.protocol.system import SIGNATURES, System, declared


class JaxDynamics(eqx.Module, Dynamics):
    """Every term of the equations of motion of a JAX system; a pytree, so that parameters are traced."""

    __getattribute__ = plain_attributes
    system: System
    structure: Structure = eqx.field(static=True)
    ignored: tuple[str, ...] = eqx.field(static=True, default=())
    constant_mass: Any = None
    inverse_mass: Any = None

    @property
    def xp(self) -> Any:
        return jnp

    def gives(self, name: str) -> bool:
        """True if the user declares the function ``name`` and it is not ignored."""
        return name in SIGNATURES and name not in self.ignored and declared(self.system, name) is not None

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        if name == "force" and tensions_in_use():  # a trace that is shared has no tensions of its own
            return getattr(self.system, name)(t, *arguments)
        return traced_once(self.system, name)(t, *arguments)

    def jacobian(self, function: Callable[[Any], Any], x: Any, pattern: str = "", order: int = 4) -> Any:
        return jax.jacfwd(function)(x)

    def force_jacobians(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        s = self.structure
        if self.gives("force_jacobians") or not (s.force_uses_q and s.force_uses_v):
            return super().force_jacobians(t, q, v)
        by_q, by_v = jax.jacfwd(self.force, (1, 2))(t, q, v)
        return by_q, by_v

    def rate(self, function: Callable[[Any, Any], Any], t: Any, q: Any, v: Any) -> Any:
        t = jnp.asarray(t, dtype=float)
        return jax.jvp(function, (t, q), (jnp.ones_like(t), v))[1]
