"""A chain of bars that rubber bushings hold together: stiff springs with dampers in the place of pins.

``hhtbench trade docs/scenes/bushings.py:problem --accuracy 1e-2,1e-3`` compares solvers on it.
"""

import jax
import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import forces, plane

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

    def gaps(self, q):  # (2 bars,): where a bar starts less where the one before ends
        bars = np.arange(self.bars)
        half = jnp.stack([self.length / 2, 0.0])
        before = jnp.where((bars == 0)[:, None], 0.0, half)
        at = plane.placed_with_ground(q)
        return plane.revolute_rows(at, first=bars, second=bars - 1, a=-half * jnp.ones((self.bars, 1)), b=before)

    def bends(self, q):  # (bars,): angles between bars, the first to the ground
        return jnp.diff(q[2::3], prepend=0.0)

    def force(self, t, q, v):
        weight = plane.weight_of_bodies(self.masses()[0], jnp.array([0.0, -9.81]))
        pull = forces.force_of(self.gaps, forces.spring_damper(self.stiffness, self.damping, 0.0), q, v)
        bend = forces.force_of(self.bends, forces.spring_damper(self.turning_stiffness, self.turning_damping, 0.0), q, v)
        return weight + pull + bend

    def energy(self, t, q, v):
        springs = self.stiffness * jnp.sum(self.gaps(q) ** 2) + self.turning_stiffness * jnp.sum(self.bends(q) ** 2)
        return plane.energy_of_bodies(q, v, *self.masses(), jnp.array([0.0, -9.81])) + springs / 2

    def power(self, t, q, v, lam, mu):  # of the dampers
        (gaps, bends) = (jax.jvp(measure, (q,), (v,))[1] for measure in (self.gaps, self.bends))
        return -self.damping * gaps @ gaps - self.turning_damping * bends @ bends


def problem(bars: int = 3, stiffness: float = 1e9, damping: float = 1e6) -> hb.Problem:
    """The chain let go at rest, stretched out from the ground along x."""
    middles = 0.2 * (np.arange(bars) + 0.5)
    q0 = np.stack([middles, np.zeros(bars), np.zeros(bars)], axis=1).ravel()
    system = Bushings(bars=bars, stiffness=stiffness, damping=damping)
    return hb.Problem(name="bushings", system=system, t_span=(0.0, 1.0), q0=q0, v0=np.zeros(3 * bars), scales=SCALES)
