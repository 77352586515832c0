"""Scenes of rigid bodies in space in equations written by hand, against which their mechanisms are judged."""

import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import space
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


SCENES = {"bricard": loop, "heavy_top": top, "rolling_disk3d_steady": disk}
