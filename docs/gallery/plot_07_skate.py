"""
A skate on an incline
=====================

A blade does not move sideways: a constraint on velocities that no position constraint replaces.  The skate does not run
down the slope, it goes level along a cycloid; the closed solution is Bloch's (Nonholonomic Mechanics and Control, 2003).
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb

skate = hb.load_problem("knife_edge")
solution = hb.solve(skate, rtol=1e-5)
true = np.array([skate.exact(t).q for t in solution.t])
print(f"largest error {np.abs(solution.q - true).max():.1e} m, after {solution.counters.steps_accepted} steps")

figure, axes = plt.subplots(figsize=(8, 2.2), layout="constrained")
axes.plot(true[:, 1], -true[:, 0], color="0.7", linewidth=4, label="closed solution")
axes.plot(solution.q[:, 1], -solution.q[:, 0], label="hht")
axes.set(xlabel="along the slope's contour [m]", ylabel="up the slope [m]", aspect="equal")
axes.legend(loc="upper right")
