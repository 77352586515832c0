"""
The error you ask for
=====================

A tolerance bounds the error of one step; what is left at the end is anybody's guess.  ``accuracy`` asks for the error of
the result, and the solution carries an estimate at every row.  Andrews' mechanism has a reference to compare with.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb

andrews = hb.load_problem("andrews")
asked = [1e-2, 1e-3, 1e-4]
figure, axes = plt.subplots(layout="constrained")
for accuracy in asked:
    solution = hb.solve(andrews, accuracy=accuracy)
    true = np.max(np.abs(solution.v[-1] - andrews.reference["v"][-1]) / andrews.scales.v)
    print(f"asked {accuracy:g}: bound {solution.error.bound:.1e}, true error of v at the end {true:.1e}")
    line = axes.semilogy(solution.t[1:], solution.error.v[1:], label=f"accuracy = {accuracy:g}")[0]
    axes.semilogy(solution.t[-1], true, "*", color=line.get_color(), markeredgecolor="k", markersize=12)
axes.set(xlabel="t [s]", ylabel="estimated error of v / scale", title="stars: the true error at the end")
axes.legend()
