"""Two mechanisms that the library does not have, put together from `hhtbench.mechanics`: one smooth, one stiff."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import forces, plane

GROUND = -1


class Excavator(hb.System):
    """Boom and stick of an excavator, pinned; their cylinders are springs with dampers between ground, boom and stick."""

    length: object = hb.parameter([3.0, 2.0], doc="[m]")
    m: object = hb.parameter([400.0, 200.0], doc="[kg]")
    k: object = hb.parameter([4e4, 2e4], doc="stiffness of the cylinders [N/m]")
    c: object = hb.parameter([4e3, 1e3], doc="their damping [N s/m]")

    @property
    def J(self):
        return self.m * self.length**2 / 12

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(self.m, self.J))

    def constraint(self, t, q):
        x, half = jnp.array([1.0, 0.0]), self.length / 2
        a = jnp.stack([-half[0] * x, half[0] * x])
        b = jnp.stack([0.0 * x, -half[1] * x])
        return plane.revolute_rows(plane.placed_with_ground(q), [0, 0], [GROUND, 1], a, b)

    def cylinders(self, q):
        at = plane.placed_with_ground(q)
        low = plane.points_on(at, [GROUND, 0], jnp.array([[1.0, -1.0], [0.0, 0.5]]))
        high = plane.points_on(at, [0, 1], jnp.array([[0.5, -0.2], [-0.6, 0.3]]))
        return forces.distances(low, high)

    def force(self, t, q, v):
        weight = plane.weight_of_bodies(self.m, jnp.array([0.0, -9.81]))
        law = forces.spring_damper(self.k, self.c, free=jnp.array([1.8, 1.6]))
        return weight + forces.force_of(self.cylinders, law, q, v)


def excavator(angles=(0.6, -0.9), t_end=2.0):
    """At rest at the angles of boom and stick [rad]."""
    return _resting("excavator", Excavator(), (3.0, 2.0), angles, t_end)


class Press(hb.System):
    """A lever pinned to the ground carries a ram on a rubber buffer: stiff and strongly damped, and driven slowly."""

    length: object = hb.parameter([1.0, 0.4], doc="[m]")
    m: object = hb.parameter([5.0, 1.0], doc="[kg]")
    k: object = hb.parameter(2e6, doc="stiffness of the buffer [N/m]")
    c: object = hb.parameter(2e4, doc="its damping [N s/m]")
    gravity: object = hb.parameter([0.0, -9.81], doc="[m/s^2]")

    @property
    def J(self):
        return self.m * self.length**2 / 12

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(self.m, self.J))

    def constraint(self, t, q):
        x = jnp.array([[1.0, 0.0]])
        at = plane.placed_with_ground(q)
        pin = plane.revolute_rows(at, [0], [GROUND], -self.length[0] / 2 * x, 0 * x)
        return jnp.concatenate([pin, plane.slot_rows(at, [1], [0], 0 * x, 0 * x, x), plane.angle_rows(at, [1], [0])])

    def buffer(self, q):
        at = plane.placed_with_ground(q)
        return forces.distances(*(plane.points_on(at, [body], jnp.zeros((1, 2))) for body in (0, 1)))

    def force(self, t, q, v):
        law = forces.spring_damper(self.k, self.c, free=1.0)
        drive = jnp.zeros(6).at[2].set(20.0 * jnp.sin(3.0 * t))
        weight = plane.weight_of_bodies(self.m, self.gravity)
        return weight + drive + forces.force_of(self.buffer, law, q, v)


def press(angle=0.5, t_end=2.0):
    """At rest, the ram at the free length of its buffer."""
    along = np.array([np.cos(angle), np.sin(angle)])
    q0 = np.array([*(along / 2), angle, *(1.5 * along), angle])
    return hb.Problem(name="press", system=Press(), t_span=(0, t_end), q0=q0, v0=np.zeros(6))


def _resting(name, system, lengths, angles, t_end):
    q0, end = [], np.zeros(2)
    for length, angle in zip(lengths, angles, strict=True):
        along = length * np.array([np.cos(angle), np.sin(angle)])
        q0 += [*(end + along / 2), angle]
        end = end + along
    return hb.Problem(name=name, system=system, t_span=(0, t_end), q0=q0, v0=np.zeros(len(q0)))
