"""
A robot with a digital controller
=================================

A controller samples the angles of two joints a hundred times a second and holds its torques, which act 4 ms later.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import Mechanism

m = Mechanism(plane=True)
m.body("upper", 3.0, 0.25, at=(0.5, 0))
m.body("lower", 2.0, 0.11, at=(1.4, 0))
m.revolute("shoulder", "ground", "upper", at=(0, 0))
m.revolute("elbow", "upper", "lower", at=(1.0, 0))
m.assemble({"shoulder": -0.5, "elbow": 0.3})
angles = [m.measure(joint) for joint in ("shoulder", "elbow")]
rates = [m.measure(joint, rate=True) for joint in ("shoulder", "elbow")]


def law(t, q, v, memory):
    """Two torques, then the two integrals of the errors."""
    error = np.array([0.5, -0.8]) - [angle(t, q, v) for angle in angles]
    integral = memory[2:] + 0.01 * error
    torque = [150, 60] * error + [200, 80] * integral - [40, 12] * np.array([rate(t, q, v) for rate in rates])
    return np.concatenate([np.clip(torque, -80, 80), integral])


m.input("memory", law, every=0.01, delay=0.004, start=np.zeros(4))
m.actuator("motor 1", "shoulder", lambda memory: memory[0])
m.actuator("motor 2", "elbow", lambda memory: memory[1])
problem = m.problem((0.0, 2.0))

figure, axes = plt.subplots(2, layout="constrained", sharex=True)
for solver in ("projected", "hht", "ida"):
    run = hb.solve(problem, solver, rtol=1e-5)
    found = [m.of(run, joint).angle() for joint in ("shoulder", "elbow")]
    print(solver, run.status.label, [f"{angle[-1]:.5f}" for angle in found])
    for angle in found:
        axes[0].plot(run.t, angle)
axes[1].step(run.t, run.u[:, :2], where="post")
axes[0].set(ylabel="angles [rad]")
axes[1].set(xlabel="t [s]", ylabel="torques [N m]")
