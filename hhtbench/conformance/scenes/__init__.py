"""Small mechanisms with closed solutions, one for every kind of equation.

The equations used for judging are written by hand in NumPy and share no code with what solvers receive: a fault in derived
functions shows like one in the solver.
"""

from __future__ import annotations

from collections.abc import Callable

from hhtbench.conformance.scenes.pendulum import DeclaredPendulum, HeavyingPendulum, pendulum
from hhtbench.conformance.scenes.scene import Scene
from hhtbench.conformance.scenes.small import moving_circle, oscillator, screw, skate

SCENES: dict[str, Callable[[], Scene]] = {
    "unconstrained": oscillator,
    "position": pendulum,
    "declared": lambda: pendulum(DeclaredPendulum, name="declared"),
    "mass": lambda: pendulum(HeavyingPendulum, name="mass"),
    "rheonomic": moving_circle,
    "velocity": skate,
    "mixed": screw,
}
