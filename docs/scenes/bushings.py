"""A chain of bars that rubber bushings hold together: stiff springs with dampers in the place of pins.

``hhtbench trade docs/scenes/bushings.py:problem --accuracy 1e-2,1e-3`` compares solvers on it.
"""

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import bushings, forces, plane

SCALES = hb.Scales(q=1.0, v=1.0)  # [m, m/s]


class Bushings(hb.System):
    """Bars (x, y, angle) in a row; a bushing joins each to the one before, and the first to the ground."""

    bars: int = 3
    mass: object = hb.parameter(1.0, doc="of a bar [kg]")
    length: object = hb.parameter(0.2, doc="of a bar [m]")
    stiffness: object = hb.parameter(1e9, doc="of a bushing [N/m]")
    damping: object = hb.parameter(1e6, doc="of a bushing [N s/m]")
    turning_stiffness: object = hb.parameter(10.0, doc="against turning [N m]")
    turning_damping: object = hb.parameter(0.01, doc="against turning [N m s]")

    def masses(self):
        one = jnp.ones(self.bars)
        return self.mass * one, self.mass * self.length**2 / 12 * one

    def mass_matrix(self, t, q):
        return plane.mass_of_bodies(*self.masses())

    def offsets(self, q):  # (bars, 3): from where the bar before ends to where a bar starts, and the angle between them
        bars = np.arange(self.bars)
        half = jnp.stack([self.length / 2, 0.0])
        before = jnp.where((bars == 0)[:, None], 0.0, half)
        return bushings.offsets_in_plane(plane.placed_with_ground(q), bars - 1, bars, a=before, b=-half[None])

    def stiffnesses(self):  # against x, y and turning
        return jnp.stack([self.stiffness, self.stiffness, self.turning_stiffness])

    def law(self):
        damping = jnp.stack([self.damping, self.damping, self.turning_damping])
        return forces.spring_damper(self.stiffnesses(), damping, 0.0)

    def force(self, t, q, v):
        weight = plane.weight_of_bodies(self.masses()[0], jnp.array([0.0, -9.81]))
        return weight + forces.force_of(self.offsets, self.law(), q, v)

    def energy(self, t, q, v):
        springs = jnp.sum(self.stiffnesses() * self.offsets(q) ** 2) / 2
        return plane.energy_of_bodies(q, v, *self.masses(), jnp.array([0.0, -9.81])) + springs

    def power(self, t, q, v, lam, mu):  # of the dampers
        return forces.power_lost(self.offsets, self.law(), q, v)


def problem(bars: int = 3, stiffness: float = 1e9, damping: float = 1e6) -> hb.Problem:
    """The chain let go at rest, stretched out from the ground along x."""
    middles = 0.2 * (np.arange(bars) + 0.5)
    q0 = np.stack([middles, np.zeros(bars), np.zeros(bars)], axis=1).ravel()
    system = Bushings(bars=bars, stiffness=stiffness, damping=damping)
    return hb.Problem(name="bushings", system=system, t_span=(0.0, 1.0), q0=q0, v0=np.zeros(3 * bars), scales=SCALES)
