"""
Stick and slip
==============

A block on a belt is held by a spring.  By switching, it sticks truly: a velocity constraint begins and ends by events.  By
the bristle of LuGre friction, a first-order state, it creeps.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

import hhtbench as hb

BELT, STATIC, KINETIC, SPRING = 0.2, 6.0, 4.0, 100.0  # [m/s], [N], [N], [N/m]; the block has 1 kg


class Slips(hb.System):
    def force(self, t, q, v):
        return KINETIC - SPRING * q


class Sticks(hb.System):
    def force(self, t, q, v):
        return -SPRING * q

    def velocity_constraint(self, t, q, v):
        return v - BELT


class Bristle(hb.System):
    stiffness: object = hb.parameter(1e6, doc="[N/m]")

    def state_rate(self, t, q, v, x):  # of the deflection x [m]
        sliding = v - BELT
        level = KINETIC + (STATIC - KINETIC) * jnp.exp(-((sliding / 1e-3) ** 2))
        return sliding - jnp.abs(sliding) * x * self.stiffness / level

    def force(self, t, q, v, x):
        return -SPRING * q - self.stiffness * x - jnp.sqrt(self.stiffness) * self.state_rate(t, q, v, x)


sticks, slips = Sticks(), Slips()
breaks = hb.Event(lambda t, q, v, lam, mu: STATIC - abs(mu[0]), direction=-1, during=sticks, then=slips, name="breaks")
holds = hb.Event(lambda t, q, v: v[0] - BELT, direction=1, during=slips, then=sticks, name="holds")
start = {"t_span": (0.0, 2.0), "q0": [0.0], "v0": [BELT]}
switched = hb.solve(hb.Problem(name="switched", system=sticks, **start, events=[breaks, holds]), rtol=1e-6)
scales = hb.Scales(q=0.1, v=0.2, x=1e-6)
creeping = hb.solve(hb.Problem(name="bristle", system=Bristle(), **start, x0=[0.0], scales=scales), rtol=1e-5)
print([f"{phase.event or 'sticks'} {phase.t:.4f}" for phase in switched.phases])

figure, axes = plt.subplots(layout="constrained")
axes.plot(switched.t, switched.v[:, 0], label="by switching")
axes.plot(creeping.t, creeping.v[:, 0], "--", label="by a bristle")
axes.set(xlabel="t [s]", ylabel="velocity of the block [m/s]")
axes.legend()
