"""
Damping of fast vibrations
==========================

A stiff spring that starts a tenth of a millimetre too long rings.  ``rho_inf`` says how much of the fastest vibrations is
left after a step: 1 keeps them, smaller values damp them, while the slow motion stays second order.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb

stiff = hb.load_problem("stiff_spring_pendulum(stiffness=1e6)")
figure, axes = plt.subplots(layout="constrained")
for rho in (1.0, 0.8, 0.5):
    solution = hb.solve(stiff, f"hht(rho_inf={rho})", step=0.004, q0=[1.0001, 0.0, 2.0001, 0.0])
    length = np.linalg.norm(solution.q[:, :2], axis=1)
    axes.plot(solution.t, length - 1.0, label=f"rho_inf = {rho}", linewidth=1)
    print(f"rho_inf = {rho}: the spring moves by {np.ptp(length[-25:]):.1e} m in the last tenth of a second")
axes.set(xlabel="t [s]", ylabel="stretch of the spring [m]")
axes.legend()
