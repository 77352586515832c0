"""Scenes of rigid bodies in space in equations written by hand, against which their mechanisms are judged."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import bushings, contact, forces, space
from hhtbench.protocol.system import System, parameter

X, Y, Z = np.eye(3)


class Bodies(System):
    """k free bodies."""

    m: object = parameter(doc="masses (k,) [kg]")
    J: object = parameter(doc="principal moments (k, 3) [kg m^2]")
    g: object = parameter(doc="gravity (3,) [m/s^2]")

    def mass_matrix(self, t, q):
        return space.mass_of_bodies(q, self.m, self.J, jnp.mean(self.J, axis=1))

    def force(self, t, q, v):
        return space.force_on_bodies(q, v, self.m, self.J, self.g)


class Governor(Bodies):
    """Shaft, slider and two arms of problems/flyball_governor.py."""

    centre: object = parameter(doc="hinge to centre of mass of an arm [m]")
    K: object = parameter(doc="[N/m]")
    C: object = parameter(doc="[N s/m]")
    l0: object = parameter(doc="[m]")

    def lengths(self, q):
        at, sides = space.placed_with_ground(q), 0.05 * np.stack([X, -X])
        arms = space.points_on(at, [2, 3], jnp.tile((0.5 - self.centre) * X, (2, 1)))
        return jnp.linalg.norm(arms - space.points_on(at, [1, 1], sides), axis=1)

    def force(self, t, q, v):
        length, rate = jax.jvp(self.lengths, (q,), (v,))
        (along,) = jax.vjp(self.lengths, q)[1](self.K * (length - self.l0) + self.C * rate)
        return super().force(t, q, v) - along

    def constraint(self, t, q):
        at = space.placed_with_ground(q)
        a = np.stack([0 * X, 0.5 * Z + 0.05 * X, 0.5 * Z - 0.05 * X])
        b = jnp.concatenate([-0.5 * Z[None], jnp.tile(-self.centre * X, (2, 1))])
        across, axis = np.array([[X, Y], [X, Z], [X, Z]]), np.stack([Z, Y, Y])
        hinges = space.revolute_rows(at, [4, 0, 0], [0, 2, 3], a, b, across, axis)
        beside = (at.x[1] - at.x[0]) @ at.R[0][:, :2]
        frame = (at.R[0].T @ at.R[1])[np.array([0, 0, 1]), np.array([1, 2, 2])]
        return jnp.concatenate([space.norm_rows(space.split(q)[1]), hinges, beside, frame])


def governor(K=8e5, C=4e4, l0=0.5, ball=5.0, g=9.81, **start):
    rod, slider, centre = 0.3, 3.0, (0.15 + ball) / (0.3 + ball)
    thin, slender = rod * 1e-4 / 6, rod * (1 + 1e-4) / 12
    arm = slender + rod * (centre - 0.5) ** 2 + ball * (1 - centre) ** 2
    J = [[slender, slender, thin], [slider * 0.01 / 6] * 3, [thin, arm, arm], [thin, arm, arm]]
    return Governor(m=[rod, slider, rod + ball, rod + ball], J=J, g=-g * Z, centre=centre, K=K, C=C, l0=l0)


class Loop(Bodies):
    """Five rods of problems/bricard.py."""

    L: object = parameter(doc="[m]")

    def constraint(self, t, q):
        along, axis = np.stack([X, -Y, Z, -X, Y]), np.stack([Y, Z, X, Y, Z, X])
        across = np.stack([np.roll(axis, 1, axis=1), np.roll(axis, 2, axis=1)], axis=1)
        a, b = self.L * np.concatenate([[0 * X], along / 2]), self.L * np.concatenate([-along / 2, [Z]])
        at = space.placed_with_ground(q)
        hinges = space.revolute_rows(at, [5, 0, 1, 2, 3, 4], np.arange(6), a, b, across, axis)
        return jnp.concatenate([space.norm_rows(space.split(q)[1]), hinges])


def loop(m=1.0, L=1.0, a=0.1, g=9.81):
    along = np.stack([X, Y, Z, X, Y])
    J = m / 12 * np.where(along > 0, 2 * a**2, L**2 + a**2)
    return Loop(m=np.full(5, m), J=J, g=-g * Y, L=L)


class Top(Bodies):
    """Body of problems/heavy_top.py."""

    l: object = parameter(doc="[m]")  # noqa: E741

    def constraint(self, t, q):
        return jnp.concatenate([space.norm_rows(q[3:])[None], q[:3] - self.l * space.rotation(q[3:])[:, 1]])


def top(m=15.0, l=1.0, A=0.234375, C=0.46875, g=9.81, **start):  # noqa: E741
    return Top(m=[m], J=[[A, C, A]], g=-g * Z, l=l)


class Disk(Bodies):
    """Body of problems/rolling_disk3d_steady.py."""

    R: object = parameter(doc="[m]")

    def constraint(self, t, q):
        return jnp.stack([space.norm_rows(q[3:]), q[2] - self.R * jnp.sqrt(1 - space.rotation(q[3:])[2, 2] ** 2)])

    def velocity_constraint(self, t, q, v):
        a = space.rotation(q[3:])[:, 2]
        rho = -self.R * (Z - a[2] * a) / jnp.sqrt(1 - a[2] ** 2)
        return space.velocity_at(q, v, [0], rho[None])[0, :2]


def disk(m=1.0, R=0.5, g=9.81, **start):
    return Disk(m=[m], J=m * R**2 / 4 * np.array([[1.0, 1.0, 2.0]]), g=-g * Z, R=R)


class Mill(Bodies):
    """Drum and balls of problems/ball_mill.py."""

    mount_k: object = parameter(doc="[N/m]")
    mount_c: object = parameter(doc="[N s/m]")
    law: object = parameter(doc="of contact: stiffness, loss, onset [N/m^1.5, s/m, m]")
    rub: object = parameter(doc="coefficient of friction, creep [1, m/s]")
    push: object = parameter(doc="[N]")
    Om: object = parameter(doc="[rad/s]")
    n: int = eqx.field(static=True)

    def offsets(self, q):
        feet = np.array([(x, y, -0.15) for x, y in [(0.2, 0.15), (0.2, -0.15), (-0.2, -0.15), (-0.2, 0.15)]])
        return bushings.offsets_in_space(space.placed_with_ground(q), [-1] * 4, [0] * 4, feet, feet)

    def contacts(self, q):
        at, (first, second) = space.placed_with_ground(q), np.triu_indices(self.n, 1)
        balls, axis, side = at.x[1:-1], at.R[0][:, 1], np.repeat([1.0, -1.0], self.n)[:, None]
        wall = contact.on_cylinder(balls, 0.025, at.x[0], axis, -0.15)
        ends = contact.on_plane(jnp.tile(balls, (2, 1)), 0.025, at.x[0] + side * 0.15 * axis, -side * axis)
        each = contact.on_sphere(balls[first], 0.025, balls[second], 0.025)
        return contact.Contact(*(jnp.concatenate(parts) for parts in zip(wall, ends, each, strict=True)))

    def force(self, t, q, v):
        shares, (first, second) = np.array([1, 1, 2, *[0.03**2] * 3]), np.triu_indices(self.n, 1)
        mounts = forces.force_of(self.offsets, forces.spring_damper(self.mount_k * shares, self.mount_c * shares, 0.0), q, v)
        law, gaps = contact.hunt_crossley(*self.law), lambda y: self.contacts(y).gap
        touching = np.append(np.tile(np.arange(self.n), 3), first) + 1, np.append(np.zeros(3 * self.n, int), second + 1)
        push = -law(*forces.rates(gaps, q, v))
        rubbing = contact.friction_force(space, *touching, self.contacts(q), push, tuple(self.rub), q, v)
        exciter = self.push * jnp.stack([jnp.cos(self.Om * t), 0.0, jnp.sin(self.Om * t)])
        inner = mounts + forces.force_of(gaps, law, q, v) + rubbing
        return (super().force(t, q, v) + inner).at[:3].add(exciter)

    def constraint(self, t, q):
        return space.norm_rows(space.split(q)[1])


def mill(n=3, mount_k=1e5, mount_c=200.0, k=1e7, c=0.3, onset=5e-5, mu=0.3, creep=0.02, push=1500.0, Om=100.0):
    J = [[0.3, 0.4, 0.3]] + n * [3 * [0.4 * 0.5 * 0.025**2]]
    laws = {"law": [k, c, onset], "rub": [mu, creep], "push": push, "Om": Om, "n": n}
    return Mill(m=[20.0] + n * [0.5], J=J, g=-9.81 * Z, mount_k=mount_k, mount_c=mount_c, **laws)


SCENES = {"flyball_governor": governor, "bricard": loop, "heavy_top": top, "rolling_disk3d_steady": disk, "ball_mill": mill}
