"""
Redundant constraints
=====================

Bricard's mechanism moves although counting says that it cannot: one of its constraints follows from the others.  HHT keeps
all of them, leaves the dependent rows out of its matrices, and takes the multipliers of least norm.
"""

import warnings

import matplotlib.pyplot as plt

import hhtbench as hb

with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    solution = hb.solve("bricard", rtol=1e-4, t_span=(0.0, 4.0))
print(told[0].message)
drift = solution.drift()
print(solution.status.label, f"position drift {drift.position.max():.0e}, velocity drift {drift.velocity.max():.0e}")

figure, axes = plt.subplots(layout="constrained")
axes.plot(solution.t, solution.lam)
axes.set(xlabel="t [s]", ylabel="multipliers [N, N m]")
