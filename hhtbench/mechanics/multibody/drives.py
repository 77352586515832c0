"""Springs, dampers, rotor inertias and motors on the coordinates of joints, and rows that couple coordinates.

A rotor of inertia ``a`` geared to a coordinate of rate ``s = W(q) v`` has the energy ``a s^2 / 2``: the mass matrix gains
``W^T a W`` and the force ``-W^T a W' v``, as joint armature of MuJoCo does.
Source: E. Todorov and others, MuJoCo documentation, chapter Computation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import forces
from hhtbench.mechanics.multibody.frames import Placed
from hhtbench.mechanics.multibody.rows import Rows, angles, travels
from hhtbench.protocol.system import parameter

Rate = Callable[[Array, Array], Array]  # of (q, v), linear in v


def tilts(at: Placed, rows: Rows) -> Array:
    """Angles (j,) [rad] between directions ``u`` and ``w``, less ``value``; smooth between 0 and half a turn."""
    cosine = jnp.sum(at.along(rows.first, rows.u) * at.along(rows.second, rows.w), axis=1)
    return jnp.arctan2(jnp.sqrt(1 - cosine**2), cosine) - rows.value


HALF_A_TURN = np.pi - 0.25  # angle from the free one up to which a spring in space is known: no step must jump the rest
MEASURED = {"travel": travels, "angle": angles, "tilt": tilts}


def coordinates(at: Placed, rows: Rows, kinds: tuple[str, ...]) -> Array:
    """Coordinates (j,) [m, rad] of joints from the drawn pose; angles in space within half a turn of it."""
    found = jnp.zeros(len(kinds))
    for kind, measure in MEASURED.items():
        chosen = np.array([i for i, one in enumerate(kinds) if one == kind], dtype=int)
        if chosen.size:
            found = found.at[chosen].set(measure(at, rows.part(chosen)))
    return found


class Drives(eqx.Module):
    """j springs, dampers, rotors and motors, each on the coordinate of a joint."""

    rows: Rows  #: ``laws`` of the efforts
    kinds: tuple[str, ...] = eqx.field(static=True)
    stiffness: Any = parameter(doc="(j,) [N/m, N m/rad]")
    damping: Any = parameter(doc="(j,) [N s/m, N m s/rad]")
    free: Any = parameter(doc="coordinates without force (j,) [m, rad]")
    inertia: Any = parameter(doc="of rotors (j,) [kg, kg m^2]")
    rotors: bool = eqx.field(static=True, default=True)  #: whether any inertia is above 0

    @property
    def law(self) -> Callable[[Array, Array], Array]:
        """Tensions of the springs and dampers over coordinates and their rates."""
        return forces.spring_damper(self.stiffness, self.damping, self.free)

    def energy(self, measured: Array) -> Array:
        """Energy [J] of the springs."""
        return jnp.sum(self.stiffness * (measured - self.free) ** 2) / 2

    def measure(self, at: Placed) -> Array:
        """Coordinates (j,); in space angles within half a turn of the free ones, not a number where a spring would jump."""
        found = coordinates(at, self.rows, self.kinds)
        if at.angle is not None:
            return found
        turning = np.array([kind == "angle" for kind in self.kinds])
        apart = found - self.free
        near = jnp.arctan2(jnp.sin(apart), jnp.cos(apart))
        near = near + jnp.where((self.stiffness != 0.0) & (abs(near) > HALF_A_TURN), jnp.nan, 0.0)
        return self.free + jnp.where(turning, near, apart)

    def rate(self, frame: Any) -> Rate:
        """Rates (j,) of the coordinates."""
        return lambda q, v: jax.jvp(lambda y: coordinates(frame.placed(y), self.rows, self.kinds), (q,), (v,))[1]

    def effort(self, rates: Array, given: dict[str, Any]) -> Array:
        """Forces or torques (j,) of the motors."""
        return _efforts(self.rows, given)


class Swivels(eqx.Module):
    """j dampers, rotors and motors on ball joints: on the angular velocities of the second bodies about the first."""

    rows: Rows  #: ``w`` direction of the motor's torque in the second bodies, ``laws`` of its size
    damping: Any = parameter(doc="(j,) [N m s/rad]")
    inertia: Any = parameter(doc="(j,) [kg m^2]")
    rotors: bool = eqx.field(static=True, default=True)  #: whether any inertia is above 0

    def rate(self, frame: Any) -> Rate:
        """Angular velocities (j, 3) in the frames of the second bodies."""
        first, second = np.array(self.rows.first), np.array(self.rows.second)

        def rates(q: Array, v: Array) -> Array:
            w = frame.rates(q, v)
            return jnp.einsum("jba,jb->ja", frame.placed(q).R[second], w[second] - w[first])

        return rates

    def effort(self, rates: Array, given: dict[str, Any]) -> Array:
        """Torques (j, 3) of the dampers and the motors."""
        return self.rows.w * _efforts(self.rows, given)[:, None] - self.damping[:, None] * rates


def _efforts(rows: Rows, given: dict[str, Any]) -> Array:
    found = jnp.zeros(len(rows))
    for i, law in enumerate(rows.laws):
        found = found if law is None else found.at[i].set(law(given))
    return found


def mass(drives: Any, frame: Any, q: Array) -> Array:
    """Mass matrix (n, n) of the rotors, ``W^T a W``."""
    W = jax.jacfwd(lambda v: drives.rate(frame)(q, v))(jnp.zeros_like(q))
    return jnp.tensordot(W, _spread(drives.inertia, W.ndim) * W, axes=(tuple(range(W.ndim - 1)),) * 2)


def inertial_force(drives: Any, frame: Any, q: Array, v: Array) -> Array:
    """Generalised force (n,) of the rotors that is quadratic in velocities, ``-W^T a W' v``."""
    rate = drives.rate(frame)
    ahead = jax.jvp(lambda y: rate(y, v), (q,), (v,))[1]
    return -jax.vjp(lambda u: rate(q, u), v)[1](_spread(drives.inertia, ahead.ndim) * ahead)[0]


def applied(drives: Any, frame: Any, given: dict[str, Any]) -> Array:
    """Generalised force (n,) of the motors and of the dampers of ball joints, at what is given by name."""
    rates, pull = jax.vjp(lambda u: drives.rate(frame)(given["q"], u), given["v"])
    return pull(drives.effort(rates, given))[0]


def kinetic_energy(drives: Any, frame: Any, q: Array, v: Array) -> Array:
    """Energy [J] of the rotors."""
    rates = drives.rate(frame)(q, v)
    return jnp.sum(_spread(drives.inertia, rates.ndim) * rates**2) / 2


def _spread(values: Array, dimensions: int) -> Array:
    return jnp.reshape(values, (-1, *(1,) * (dimensions - 1)))


class Couples(eqx.Module):
    """j coordinates that are polynomials of others."""

    rows: Rows
    other: Rows
    kinds: tuple[tuple[str, str], ...] = eqx.field(static=True)
    polynomial: Any = parameter(doc="coefficients (j, 5), the constant first")
    teeth: Any = parameter(doc="(j,) turns of the other angle after which both angles are whole turns")


def couple(at: Placed, couples: Couples, t: Any) -> Array:
    """Coordinates less polynomials of others, (j,) [m, rad]; of angles in space ``sin(teeth phase) / teeth``."""
    one = coordinates(at, couples.rows, tuple(kinds[0] for kinds in couples.kinds))
    x = coordinates(at, couples.other, tuple(kinds[1] for kinds in couples.kinds))
    value = jnp.zeros_like(x)
    for power in range(4, -1, -1):
        value = value * x + couples.polynomial[:, power]
    phase = one - value
    if at.angle is not None:
        return phase
    turning = np.array([kinds[0] == "angle" for kinds in couples.kinds])
    return jnp.where(turning, jnp.sin(couples.teeth * phase) / couples.teeth, phase)
