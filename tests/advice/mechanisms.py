"""Two mechanisms that the library does not have, put together from `hhtbench.mechanics`: a stiff one, one on wheels."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import forces, plane

GROUND = -1


class Bars(hb.System):
    """Uniform bars in the plane, of ``length`` and ``m``."""

    @property
    def J(self):
        return self.m * self.length**2 / 12

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(self.m, self.J))


class Press(Bars):
    """A lever pinned to the ground carries a ram on a rubber buffer: stiff and strongly damped, and driven slowly."""

    length: object = hb.parameter([1.0, 0.4], doc="[m]")
    m: object = hb.parameter([5.0, 1.0], doc="[kg]")
    k: object = hb.parameter(2e6, doc="stiffness of the buffer [N/m]")
    c: object = hb.parameter(2e4, doc="its damping [N s/m]")
    gravity: object = hb.parameter([0.0, -9.81], doc="[m/s^2]")

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


class Lorry(Bars):
    """A tractor pulls its trailer through a bend: the rear wheels of neither slip sideways."""

    length: object = hb.parameter([3.0, 5.0], doc="[m]")
    m: object = hb.parameter([4000.0, 6000.0], doc="[kg]")
    pull: object = hb.parameter(6e3, doc="of the engine, along the tractor [N]")
    steering: object = hb.parameter(4e3, doc="largest moment on the tractor [N m]")
    period: object = hb.parameter(2.0, doc="of the steering [s]")

    def constraint(self, t, q):
        x, half = jnp.array([[1.0, 0.0]]), self.length / 2
        return plane.revolute_rows(plane.placed_with_ground(q), [0], [1], -half[0] * x, half[1] * x)

    def velocity_constraint(self, t, q, v):
        angle = q.reshape(-1, 3)[:, 2]
        behind = plane.turned(angle, -self.length[:, None] / 2 * jnp.array([1.0, 0.0]))
        across = plane.turned(angle, jnp.array([[0.0, 1.0], [0.0, 1.0]]))
        return jnp.sum(plane.velocity_at(v, [0, 1], behind) * across, axis=1)

    def force(self, t, q, v):
        along = plane.turned(q[2], jnp.array([1.0, 0.0]))
        turn = self.steering * jnp.sin(2 * jnp.pi * t / self.period)
        return jnp.concatenate([self.pull * along, turn[None], jnp.zeros(3)])


def lorry(speed=4.0, t_end=6.0):
    """Straight, both at one speed [m/s]."""
    v0 = [speed, 0.0, 0.0, speed, 0.0, 0.0]
    return hb.Problem(name="lorry", system=Lorry(), t_span=(0, t_end), q0=[0, 0, 0, -4.0, 0, 0], v0=v0)
