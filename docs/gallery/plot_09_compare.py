"""
Which solver for this scene?
============================

``run`` refines every solver until it reaches the errors that are asked for, or a stated cap; rows that fail are rows too.
"""

import matplotlib.pyplot as plt

import hhtbench as hb

solvers = ["hht", "ida(form=ggl)", "scipy(method=Radau)", "projected"]
runs = hb.run("car_axis", solvers, accuracies=[1e-1, 1e-2, 1e-3], jobs=1, timing=False)
figure, axes = plt.subplots(layout="constrained")
for solver in dict.fromkeys(row["solver"] for row in runs.table()):
    rows = [row for row in runs.table() if row["solver"] == solver and row["error"] and row["evaluations"]]
    axes.loglog([row["evaluations"] for row in rows], [row["error"] for row in rows], "o-", label=solver)
    print(f"{solver:24} {len(rows)} runs, smallest error {min(row['error'] for row in rows):.1e}")
axes.set(xlabel="evaluations of the equations", ylabel="scaled error of q and v")
axes.legend()
