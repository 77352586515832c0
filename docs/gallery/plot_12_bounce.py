"""
A ball that bounces and rests
=============================

A distance with a restitution is an impact; when the rebounds follow one another without end, the system with the contact
as a constraint begins.  One solve returns all phases, by every solver.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb


class Flying(hb.System):
    def force(self, t, q, v):
        return jnp.stack([-9.81 + 0.0 * t])


class Resting(Flying):
    def constraint(self, t, q):
        return q


floor = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=0.6, then=Resting(), name="floor")
ball = hb.Problem(name="ball", system=Flying(), t_span=(0.0, 2.5), q0=[1.0], v0=[0.0], events=floor)

figure, axes = plt.subplots(layout="constrained")
for solver in ("hht", "ida", "projected"):
    solution = hb.solve(ball, solver, rtol=1e-6, t_eval=np.linspace(0.0, 2.5, 251))
    rest = solution.phases[1].t
    print(
        f"{solver}: {solution.t_events[0].size} hits, at rest from {rest:.6f} s, contact force {-solution.lam[-1, 0]:.3f} N"
    )
    axes.plot(solution.t, solution.q[:, 0], label=solver)
axes.axvline(rest, color="0.6", linewidth=1)
axes.set(xlabel="t [s]", ylabel="height [m]")
axes.legend()
