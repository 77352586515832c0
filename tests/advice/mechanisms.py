"""Four mechanisms that the library does not have, put together from `hhtbench.mechanics`.

One smooth, one stiff, one on wheels that roll, one in space.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import forces, plane, space

GROUND = -1


class Bars(hb.System):
    """Uniform bars in the plane, of ``length`` and ``m``."""

    @property
    def J(self):
        return self.m * self.length**2 / 12

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(self.m, self.J))


class Excavator(Bars):
    """Boom and stick of an excavator, pinned; their cylinders are springs with dampers between ground, boom and stick."""

    length: object = hb.parameter([3.0, 2.0], doc="[m]")
    m: object = hb.parameter([400.0, 200.0], doc="[kg]")
    k: object = hb.parameter([4e4, 2e4], doc="stiffness of the cylinders [N/m]")
    c: object = hb.parameter([4e3, 1e3], doc="their damping [N s/m]")

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


class Arm(hb.System):
    """Two bars in space: the upper hangs on a ball joint, the lower on a hinge across the upper."""

    m: object = hb.parameter([2.0, 1.0], doc="[kg]")
    J: object = hb.parameter([[0.2, 0.2, 0.01], [0.1, 0.1, 0.005]], doc="[kg m^2]")
    gravity: object = hb.parameter([0.0, 0.0, -9.81], doc="[m/s^2]")

    def mass_matrix(self, t, q):
        return space.mass_of_bodies(q, self.m, self.J, 0.1 * jnp.ones(2))

    def force(self, t, q, v):
        return space.force_on_bodies(q, v, self.m, self.J, self.gravity)

    def constraint(self, t, q):
        at, (x, y, z) = space.placed_with_ground(q), jnp.eye(3)
        ball = space.spherical_rows(at, jnp.array([0]), jnp.array([-1]), 0.5 * z[None], 0.0 * z[None])
        ends = -0.5 * z[None], 0.4 * z[None]
        hinge = space.revolute_rows(at, jnp.array([0]), jnp.array([1]), *ends, jnp.stack([y, z])[None], x[None])
        return jnp.concatenate([ball.ravel(), hinge.ravel(), space.norm_rows(space.split(q)[1])])


def arm(tilt=0.8, spin=3.0, t_end=2.0):
    """Tilted about x [rad], turning about the vertical through the ball joint [rad/s]."""
    p = np.array([np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0])
    down = -np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    x = [0.5 * down, 1.4 * down]
    rate = np.array([0.0, 0.0, spin])
    pdot = np.asarray(space.quaternion_rate(p, rate))
    q0 = np.concatenate([x[0], p, x[1], p])
    v0 = np.concatenate([np.cross(rate, x[0]), pdot, np.cross(rate, x[1]), pdot])
    return hb.Problem(name="arm", system=Arm(), t_span=(0, t_end), q0=q0, v0=v0)


def _resting(name, system, lengths, angles, t_end):
    q0, end = [], np.zeros(2)
    for length, angle in zip(lengths, angles, strict=True):
        along = length * np.array([np.cos(angle), np.sin(angle)])
        q0 += [*(end + along / 2), angle]
        end = end + along
    return hb.Problem(name=name, system=system, t_span=(0, t_end), q0=q0, v0=np.zeros(len(q0)))
