"""A chain of bars that rubber bushings hold together: stiff springs with dampers in the place of pins.

``hhtbench trade docs/scenes/bushings.py:problem --accuracy 1e-2,1e-3`` compares solvers on it.
"""

import hhtbench as hb
from hhtbench.mechanics import Mechanism

LENGTH, MASS = 0.2, 1.0  # of a bar [m, kg]


def mechanism(bars: int = 3, stiffness: float = 1e9, damping: float = 1e6) -> Mechanism:
    """Bars in a row; a bushing joins each to the one before, and the first to the ground."""
    m, before = Mechanism(plane=True), "ground"
    for i in range(bars):
        bar = m.body(f"bar {i}", MASS, MASS * LENGTH**2 / 12, at=(LENGTH * (i + 0.5), 0))
        # along, across [N/m, N s/m] and against turning [N m, N m s]
        m.bushing(f"bushing {i}", before, bar, (LENGTH * i, 0), (stiffness, stiffness, 10), (damping, damping, 0.01))
        before = bar
    return m


def problem(bars: int = 3, stiffness: float = 1e9, damping: float = 1e6) -> hb.Problem:
    """The chain let go at rest, stretched out from the ground along x."""
    made = mechanism(bars, stiffness, damping)
    return made.problem((0.0, 1.0), name="bushings", scales=hb.Scales(q=1.0, v=1.0))  # [m, m/s]
