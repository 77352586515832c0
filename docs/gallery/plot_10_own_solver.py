"""
A solver of your own
====================

Anything with ``name``, ``accepts`` and ``solve`` takes part, and is judged as all others are.  ``hb.Equations`` gives the
accelerations of the constrained system, so that an explicit method is a few lines; what it does not do is hold constraints.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb


class Heun:
    """Heun's method of order two on the underlying ODE."""

    name = "heun"

    def accepts(self, problem, request):
        return None if request.fixed else "heun takes steps: give step or steps"

    def solve(self, problem, request):
        equations, plan = hb.Equations(problem, request), hb.plan_steps(request, *problem.t_span)
        t, q, v = problem.t_span[0], problem.q0, problem.v0
        rows = [(t, q, v)]
        for i in range(plan.count):
            h, a = plan.length(i), equations.acceleration(t, q, v)
            t, middle = plan.end(i), v + h * a
            b = equations.acceleration(t, q + h * v, middle)
            q, v = q + h * (v + middle) / 2, v + h * (a + b) / 2
            rows.append((t, q, v))
        return equations.solution(*map(np.array, zip(*rows, strict=True)))


figure, axes = plt.subplots(layout="constrained")
for solver in (Heun(), "hht"):
    solution = hb.solve("simple_pendulum", solver, step=0.01, t_span=(0.0, 5.0))
    drift = solution.drift()
    print(f"{getattr(solver, 'name', solver)}: {solution.status.label}, drift {drift.position.max():.0e}")
    axes.semilogy(drift.t[1:], np.maximum(drift.position[1:], 1e-17), label=getattr(solver, "name", solver))
axes.set(xlabel="t [s]", ylabel="position drift / scale")
axes.legend()
