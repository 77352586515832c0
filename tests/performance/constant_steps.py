"""Constant steps on the stiff spring pendulum, 60 of 0.1 to 1e-6 s for every stiffness; 1 if one fails.

Each run covers the second of the problem with the compiled loops; as plain Python its first steps are the same.  The
error is that of the positions at the end against the rigid limit, which the motion of the spring nears like g/k; "levels"
is the larger of the two constraint residuals there.  Takes some minutes.  ``python -m tests.performance.constant_steps``
"""

from __future__ import annotations

import math
import sys
import warnings

import numpy as np

from problems.stiff_spring_pendulum import problem
from solvers.hht import HHT

STEPS = np.rint(1.0 / np.geomspace(1e-1, 1e-6, 60)).astype(int)  # in the second of the problem
STIFFNESS = [10.0**power for power in range(6, 14)]  # N/m
ALPHAS = (0.0, -0.05, -0.3)
FEW = 20  # steps as plain Python
CURVATURE = 15.0  # error over h^2 [m/s^2], of the method: 8 for the rigid pendulum and alpha = 0, 11 for alpha = -0.3
SWAY = 15.0  # error times k/g [kg]: what becomes of the spring's giving way in a second; 11 where h resolves it
ROUNDOFF = 1e-10  # of the levels and of positions after a million steps


def run(scene, engines, steps):
    """(error, levels) of one length of steps; NaN where it fails, or where the ``engines`` differ."""
    few = min(steps, FEW)
    solution = engines["compiled"].solve((0.0, 1.0), scene.q0, scene.v0, steps=steps, t_eval=[1.0])
    first, plain = (engine.solve((0.0, few / steps), scene.q0, scene.v0, steps=few) for engine in engines.values())
    if not (solution.success and plain.success and np.array_equal(first.q, plain.q) and np.array_equal(first.v, plain.v)):
        return math.nan, math.nan
    q, v = solution.q[-1], solution.v[-1]
    rod = q[2:] - q[:2]
    return float(np.abs(q - RIGID).max()), max(abs(rod @ rod - 1.0) / 2, abs(rod @ (v[2:] - v[:2])))


def row(stiffness, alpha):
    """How many lengths fail or err too much, and the text of the row."""
    scene = problem(stiffness=stiffness)
    engines = {name: HHT(scene.system, alpha=alpha, engine=name) for name in ("compiled", "python")}
    errors, levels = np.array([run(scene, engines, int(steps)) for steps in STEPS]).T
    allowed = CURVATURE / STEPS**2 + SWAY * 9.81 / stiffness + ROUNDOFF
    bad = ~((errors <= allowed) & (levels <= ROUNDOFF))
    failing = ", ".join(f"{1 / steps:.3g}" for steps in STEPS[bad])
    worst = float(np.nanmax(errors / allowed))
    most, drift = np.nanmax(errors), np.nanmax(levels)
    text = f"{stiffness:7.0e} {alpha:6.2f} {bad.sum():8d}  {most:9.1e} {worst:9.2f} {drift:9.1e}  {failing}"
    return int(bad.sum()), text


RIGID = problem(stiffness="inf").reference["q"][-1]


def main() -> int:
    warnings.simplefilter("ignore")
    sys.stdout.write("      k  alpha  failing  max error of bound    levels  failing h [s]\n")
    broken = 0
    for stiffness in STIFFNESS:
        for alpha in ALPHAS:
            failing, text = row(stiffness, alpha)
            broken += failing
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
