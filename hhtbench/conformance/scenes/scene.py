"""Scene: a problem with its equations written again by hand in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem, System

SPAN = (0.0, 1.5)  # [s]
UNIT = Scales()
CORRECTIONS = 4  # Newton's, onto the position constraints


class Equations(NamedTuple):
    """``mass vdot + rows^T multipliers = force`` and ``rows vdot + curvature = 0``; position constraints come first."""

    mass: Matrix  #: (n, n)
    force: Vector  #: (n,)
    rows: Matrix  #: (m + p, n)
    curvature: Vector  #: (m + p,)


class Levels(NamedTuple):
    """Violation of the constraints by a state."""

    position: Vector  #: (m,)
    velocity: Vector  #: (m + p,)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A problem with independently written equations and constraint levels."""

    problem: Problem
    equations: Callable[[float, Vector, Vector], Equations]
    levels: Callable[[float, Vector, Vector], Levels]

    def put_back(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Return the nearest state on both levels of the constraints."""
        m = self.levels(t, q, v).position.size
        at, moved = np.array(q, dtype=np.float64), np.array(v, dtype=np.float64)
        for _ in range(CORRECTIONS if m else 0):
            at -= _least(self.equations(t, at, v).rows[:m], self.levels(t, at, v).position)
        moved -= _least(self.equations(t, at, v).rows, self.levels(t, at, v).velocity)
        return at, moved

    @property
    def name(self) -> str:
        """Name of the problem."""
        return self.problem.name

    def multipliers(self, t: float, q: Vector, v: Vector) -> Vector:
        """Multipliers (m + p,) of the acceleration level."""
        return multipliers(self.equations(t, q, v))

    def exact(self, t: float) -> Motion:
        """Closed solution at ``t``; raises if there is none."""
        if self.problem.exact is None:
            raise ValueError(f"{self.name} has no closed solution")
        return self.problem.exact(t)


def _least(rows: Matrix, misfit: Vector) -> Vector:
    """Return the minimum-norm vector (n,) that ``rows`` (k, n) map to ``misfit`` (k,)."""
    return np.asarray(np.linalg.pinv(rows) @ misfit, dtype=np.float64)


def multipliers(e: Equations) -> Vector:
    """Multipliers (m + p,) from the Schur complement of the KKT system."""
    if not e.rows.shape[0]:
        return np.zeros(0)
    schur = e.rows @ np.linalg.solve(e.mass, e.rows.T)
    right = e.rows @ np.linalg.solve(e.mass, e.force) + e.curvature
    return np.asarray(np.linalg.solve(schur, right), dtype=np.float64)


def on_motion(name: str, system: System, exact: Callable[[float], Motion], span: float, scales: Scales = UNIT) -> Problem:
    """Make a problem over [0, ``span``] that starts on its closed solution."""
    start = exact(0.0)
    return Problem(name=name, system=system, t_span=(0.0, span), q0=start.q, v0=start.v, exact=exact, scales=scales)


def make_scene(
    name: str,
    system: System | NumpySystem,
    motion: Callable[[float], tuple[Vector, Vector]],
    equations: Callable[[float, Vector, Vector], Equations],
    levels: Callable[[float, Vector, Vector], Levels],
    t_span: tuple[float, float] = SPAN,
    scales: Scales = UNIT,
) -> Scene:
    """Make a scene that starts on its closed ``motion``; the multipliers follow from the equations."""
    m = levels(t_span[0], *motion(t_span[0])).position.size

    def exact(t: float) -> Motion:
        q, v = motion(t)
        found = multipliers(equations(t, q, v))
        return Motion(q, v, found[:m], found[m:])

    start = exact(t_span[0])
    problem = Problem(name=name, system=system, t_span=t_span, q0=start.q, v0=start.v, exact=exact, scales=scales)
    return Scene(problem=problem, equations=equations, levels=levels)
