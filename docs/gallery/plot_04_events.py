"""
A pendulum that hits a wall
===========================

An event is a function whose zero is found; it may stop the run, be recorded, or change the state, which is then put back
onto the constraints.
"""

import matplotlib.pyplot as plt

import hhtbench as hb

wall = hb.Event(lambda t, q, v: q[0] - 0.3, direction=1, change=lambda t, q, v: (q, -0.8 * v), name="wall")
solution = hb.solve("simple_pendulum", rtol=1e-5, events=[wall], t_span=(0.0, 6.0), q0=[-0.6, -0.8], v0=[0.0, 0.0])
print(f"{solution.t_events[0].size} hits, at", solution.t_events[0].round(4))

figure, axes = plt.subplots(layout="constrained")
axes.plot(solution.t, solution.q[:, 0], label="x")
axes.plot(solution.t_events[0], solution.q_events[0][:, 0], "k.", label="hits")
axes.axhline(0.3, color="0.6", linewidth=1)
axes.set(xlabel="t [s]", ylabel="x [m]")
axes.legend()
