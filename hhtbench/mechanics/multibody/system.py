"""Equations of motion of rigid bodies with joints and forces, as a System that every solver takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from hhtbench.mechanics import forces, plane, space
from hhtbench.mechanics.multibody import drives
from hhtbench.mechanics.multibody.drives import Swivels, couple
from hhtbench.mechanics.multibody.elements import MEASURES, Loads, Measure
from hhtbench.mechanics.multibody.frames import Plane, Space
from hhtbench.mechanics.multibody.rows import FAMILIES, Rows, slip, turning
from hhtbench.mechanics.multibody.signals import Names, Rates
from hhtbench.protocol.system import System, parameter

ALL_FAMILIES: dict[str, Callable[..., Array]] = FAMILIES | {"couple": couple}
MEASURED: dict[str, Callable[..., Array]] = MEASURES | {"drive": lambda at, one: one.measure(at)}


class Multibody(System):
    """k rigid bodies in space or in the plane with joints and forces; what a mechanism has not is not declared."""

    m: Any = parameter(doc="masses (k,) [kg]")
    J: Any = parameter(doc="moments (k, 3) or tensors (k, 3, 3) in space, moments (k,) in the plane [kg m^2]")
    j0: Any = parameter(doc="inertia along each quaternion (k,); motion and reactions do not depend on it [kg m^2]")
    gravity: Any = parameter(doc="(d,) [m/s^2]")
    flat: bool = eqx.field(static=True, default=False)
    joints: dict[str, Any] = eqx.field(default_factory=dict)  #: rows of position constraints, by family
    elements: dict[str, Any] = eqx.field(default_factory=dict)  #: springs and contacts, by kind
    loads: Loads | None = None
    swivels: Swivels | None = None  #: rotors, dampers and motors of ball joints
    speeds: Rows | None = None  #: prescribed rates
    names: Names = Names()  #: of states and inputs
    states: Rates | None = None
    turns: Any = parameter((), doc="whole turns of the joints at the start, for readings")
    moves: bool = eqx.field(static=True, default=False)  #: whether motors prescribe positions
    kept: tuple[tuple[str, Callable[..., Any]], ...] = eqx.field(static=True, default=())  #: invariants: names, functions

    @property
    def frame(self) -> Any:
        """Plane or Space."""
        return Plane if self.flat else Space

    @property
    def mass_matrix(self) -> Any:
        """Diagonal (3 k,) in the plane; in space a function of (t, q), a block for each body."""
        rotors = bool(self._rotors)
        return plane.mass_of_bodies(self.m, self.J) if self.flat and not rotors else self._mass

    @property
    def constraint(self) -> Any:
        """Function of (t, q): norms of quaternions, then one family of rows after the other (m,); None without any."""
        return self._rows if self.joints or not self.flat else None

    @property
    def velocity_constraint(self) -> Any:
        """Function of (t, q, v): rolling without slip, then prescribed rates (p,); None without any."""
        return self._velocity_rows if "rolling" in self.joints or self.speeds is not None else None

    @property
    def power(self) -> Any:
        """Function of (t, q, v, lam, mu): power [W] of dampers, friction, loads and motors; None if there are none."""
        conserved = not (self.elements or self.moves or self._drives) and self.loads is None and self.speeds is None
        return None if conserved else self._power

    @property
    def invariants(self) -> Any:
        """Function of (t, q, v): what is constant along the motion, by name; None without any."""
        return self._invariants if self.kept else None

    @property
    def state_rate(self) -> Any:
        """Function of (t, q, v, x, u): rates of the states (k,); None without any."""
        return self._state_rate if self.states is not None else None

    def force(self, t: Array, q: Array, v: Array, x: Any = (), u: Any = ()) -> Array:
        """Weight, terms quadratic in velocities, springs, contacts and loads, (n,)."""
        if self.flat:
            total = plane.weight_of_bodies(self.m, self.gravity)
        else:
            total = space.force_on_bodies(q, v, self.m, self.J, self.gravity)
        for kind, element in self.elements.items():
            total = total + forces.force_of(self._measure(kind), element.law, q, v)
        for one in self._rotors:
            total = total + drives.inertial_force(one, self.frame, q, v)
        return total + self._applied(self.names.given(t, q, v, x, u))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and energy of weight, springs and contacts [J]."""
        total = (plane if self.flat else space).energy_of_bodies(q, v, self.m, self.J, self.gravity)
        total = total + sum(drives.kinetic_energy(one, self.frame, q, v) for one in self._rotors)
        return total + sum(element.energy(self._measure(kind)(q)) for kind, element in self.elements.items())

    def measured(self, kind: str, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Measures, rates and tensions (j,) of all elements of a kind: spring, torsion, bushing, contact, ball or tyre."""
        value, rate = forces.rates(self._measure(kind), q, v)
        return value, rate, self.elements[kind].law(value, rate)

    def _mass(self, t: Any, q: Any) -> Array:
        if self.flat:
            total = jnp.diag(plane.mass_of_bodies(self.m, self.J))
        else:
            total = space.mass_of_bodies(q, self.m, self.J, self.j0)
        return total + sum(drives.mass(one, self.frame, q) for one in self._rotors)

    @property
    def _drives(self) -> list[Any]:
        both = self.elements.get("drive"), self.swivels
        return [one for one in both if one is not None]

    @property
    def _rotors(self) -> list[Any]:
        return [one for one in self._drives if one.rotors]

    def _rows(self, t: Any, q: Any) -> Array:
        at = self.frame.placed(q)
        parts = [
            family(at, self.joints[name], t) for name, family in ALL_FAMILIES.items() if name in self.joints
        ]  # JAX sorts dicts
        return jnp.concatenate([self.frame.own_rows(q), *parts])

    def _velocity_rows(self, t: Any, q: Any, v: Any) -> Array:
        parts = [slip(self.frame, self.joints["rolling"], q, v)] if "rolling" in self.joints else []
        if self.speeds is not None:
            parts.append(self.speeds.driven(t, turning(self.frame, self.speeds, q, v)))
        return jnp.concatenate(parts)

    def _invariants(self, t: Any, q: Any, v: Any) -> dict[str, Array]:
        return {name: value(self, q, v) for name, value in self.kept}

    def _state_rate(self, t: Any, q: Any, v: Any, x: Any, u: Any) -> Array:
        return self.states(self.names.given(t, q, v, x, u))  # type: ignore[misc]

    def _applied(self, given: dict[str, Any]) -> Array:
        """Loads and friction (n,)."""
        q, v = given["q"], given["v"]
        total = jnp.zeros_like(q) if self.loads is None else self.loads.generalised(self.frame, given)
        for one in self._drives:
            total = total + drives.applied(one, self.frame, given)
        for element in self.elements.values():
            if getattr(element, "rubs", False):
                total = total + element.friction(self.frame, q, v)
        return total

    def _power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any, x: Any = (), u: Any = ()) -> Array:
        total = self._applied(self.names.given(t, q, v, x, u)) @ v
        for kind, element in self.elements.items():
            total = total + forces.power_lost(self._measure(kind), element.law, q, v)
        if self.moves:
            total = total + lam @ jax.jvp(lambda s: self._rows(s, q), (t,), (jnp.ones_like(t),))[1]
        if self.speeds is not None:
            rate = turning(self.frame, self.speeds, q, v)
            total = total - mu[mu.size - rate.size :] @ rate
        return total

    def _measure(self, kind: str) -> Measure:
        return lambda q: MEASURED[kind](self.frame.placed(q), self.elements[kind])
