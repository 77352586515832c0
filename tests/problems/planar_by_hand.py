"""Scenes of rigid bodies in the plane in equations written by hand, against which their mechanisms are judged."""

import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import bushings, forces, plane
from hhtbench.protocol.system import System, parameter


class Bodies(System):
    """k free bodies (x, y, angle)."""

    m: object = parameter(doc="masses (k,) [kg]")
    J: object = parameter(doc="moments of inertia (k,) [kg m^2]")
    g: object = parameter(doc="[m/s^2]")

    @property
    def mass_matrix(self):
        return plane.mass_of_bodies(self.m, self.J)

    def force(self, t, q, v):
        return plane.weight_of_bodies(self.m, jnp.stack([0.0, -self.g]))


class Chain(Bodies):
    """Bars of problems/bushing_chain.py."""

    length: object = parameter(doc="[m]")
    stiffness: object = parameter(doc="(3,) [N/m, N/m, N m/rad]")
    damping: object = parameter(doc="(3,) [N s/m, N s/m, N m s/rad]")

    def offsets(self, q):
        bars = np.arange(self.m.size)
        end = jnp.stack([self.length / 2, 0.0])
        ends = jnp.where((bars == 0)[:, None], 0.0, end)  # the ground's is the origin
        return bushings.offsets_in_plane(plane.placed_with_ground(q), bars - 1, bars, ends, -end[None])

    def force(self, t, q, v):
        law = forces.spring_damper(self.stiffness, self.damping, 0.0)
        return super().force(t, q, v) + forces.force_of(self.offsets, law, q, v)


def chain(n_bars=20, m=1.8, J=0.001, length=0.0753, k=7e7, c=3.5e3, turning_k=500.0, turning_c=25.0, g=9.81):
    stiffness, damping = [k, k, turning_k], [c, c, turning_c]
    return Chain(m=np.full(n_bars, m), J=np.full(n_bars, J), g=g, length=length, stiffness=stiffness, damping=damping)


class Windows(Bodies):
    """Cranks and couplers of problems/four_bars.py."""

    l: object = parameter(doc="[m]")  # noqa: E741

    def constraint(self, t, q):
        bars, cranks = q.reshape(-1, 3), self.m.size // 2 + 1
        arm = self.l / 2 * jnp.stack([jnp.cos(bars[:, 2]), jnp.sin(bars[:, 2])], axis=1)
        begins, ends = bars[:, :2] - arm, bars[:, :2] + arm
        ground = self.l * jnp.stack([jnp.arange(cranks), jnp.zeros(cranks)], axis=1)
        joints = [begins[:cranks] - ground, begins[cranks:] - ends[: cranks - 1], ends[cranks:] - ends[1:cranks]]
        return jnp.concatenate(joints).ravel()


def windows(n_windows=2, m=1.0, l=1.0, g=9.81, speed=1.0):  # noqa: E741
    masses = np.full(2 * n_windows + 1, m)
    return Windows(m=masses, J=masses * l**2 / 12, g=g, l=l)


SCENES = {"bushing_chain": chain, "four_bars": windows}
