"""
A bead on a dry ring
====================

Friction is a reaction that depends on velocities: ``reaction(t, q, v, lam)``.  The bead slides until gravity along the ring
is less than friction can hold, and rests off the lowest point, by at most the angle of friction.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb


class Bead(hb.System):
    """A bead of 1 kg on a ring of radius 1 m in a vertical plane: q = (x, y)."""

    friction: object = hb.parameter(0.15, doc="coefficient")
    slip: object = hb.parameter(0.02, doc="speed from which friction is whole [m/s]")

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1) / 2])

    def reaction(self, t, q, v, lam):
        along = jnp.stack([-q[1], q[0]])
        return -q * lam[0] - self.friction * jnp.abs(lam[0]) * jnp.tanh(along @ v / self.slip) * along


figure, axes = plt.subplots(layout="constrained")
for friction in (0.0, 0.15, 0.4):
    bead = hb.Problem(name="bead", system=Bead(friction=friction), t_span=(0, 6), q0=[1, 0], v0=[0, 0])
    solution = hb.solve(bead, rtol=1e-5)
    angle = np.degrees(np.arctan2(solution.q[:, 0], -solution.q[:, 1]))
    print(f"mu = {friction}: at the end {angle[-1]:.1f} degrees, angle of friction {np.degrees(np.arctan(friction)):.1f}")
    axes.plot(solution.t, angle, label=f"mu = {friction}")
axes.set(xlabel="t [s]", ylabel="from the lowest point [degrees]")
axes.legend()
