"""
A bar that is caught
====================

A free bar flies into the hand of an arm and is let go again: a joint begins and ends by events.  The impulse conserves
the moment of momentum about the shoulder.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import Mechanism


def arm(*, caught):
    """Two links along x, and a bar whose left end is in the hand as drawn."""
    m = Mechanism(gravity=(0, 0), plane=True)
    m.body("upper", 3.0, 0.25, at=(0.5, 0))
    m.body("lower", 2.0, 0.11, at=(1.4, 0))
    m.body("bar", 1.0, 0.03, at=(2.1, 0))
    m.revolute("shoulder", "ground", "upper", at=(0, 0))
    m.revolute("elbow", "upper", "lower", at=(1.0, 0))
    if caught:
        m.revolute("hand", "lower", "bar", at=(1.8, 0))
    return m


free, held = arm(caught=False), arm(caught=True)
problem = free.problem((0, 2))
q0, v0 = problem.q0.copy(), problem.v0.copy()
q0[6:8] += [0.2, -0.15]  # the bar begins off the hand, and comes there in 0.5 s
v0[6:8] = [-0.4, 0.3]
gripped = held.problem((0, 2)).system
catch = hb.Event(lambda t, q, v: q[6] - 2.1, direction=-1, during=problem.system, then=gripped, name="catch")
drop = hb.Event(lambda t, q, v: t - 1.5, direction=1, during=gripped, then=problem.system, name="drop")

figure, axes = plt.subplots(layout="constrained")
for solver in ("hht", "cvode", "projected"):
    run = hb.solve(problem, solver, rtol=1e-7, q0=q0, v0=v0, events=[catch, drop], t_eval=np.linspace(0, 2, 201))
    impulse = run.impacts[0].impulse[6:8]
    print(f"{solver}: caught at {run.t_events[0][0]:.9f} s, impulse on the bar {impulse.round(6)}")
    axes.plot(run.t, run.v[:, 6:8], label=[f"{solver}, {axis}" for axis in "xy"])
axes.set(xlabel="t [s]", ylabel="velocity of the bar [m/s]")
axes.legend()
