"""
A hundred links
===============

The same code at any size: here 200 coordinates and 100 constraints, a band matrix in every step.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb

chain = hb.load_problem("planar_chain(n_links=100)")
solution = hb.solve(chain, "hht(rho_inf=0.8)", rtol=1e-2, t_span=(0.0, 0.5), t_eval=np.linspace(0.0, 0.5, 9))
print(
    solution.status.label,
    "after",
    solution.counters.steps_accepted,
    "steps; drift",
    f"{solution.drift().position.max():.0e}",
)

figure, axes = plt.subplots(layout="constrained")
for row, t in zip(solution.q, solution.t, strict=True):
    points = np.vstack([[0.0, 0.0], row.reshape(100, -1)[:, :2]])
    axes.plot(points[:, 0], points[:, 1], color=plt.cm.viridis(2 * t), linewidth=1)
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="t = 0 (dark) to 0.5 s (light)")
