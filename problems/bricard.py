r"""Bricard's mechanism: a closed loop of five rods and the ground on six hinges that moves although counting forbids it.

Source: IFToMM library of computational benchmark problems for multibody dynamics, A04 (Bricard's mechanism)::

          y                            q: centre [m] and unit quaternion, scalar first, of each rod, 5 x 7
          |  z                         rods P0P1, P1P2, ..., P4P5; the ground holds P0 = (0,0,0) and P5 = (0,0,L)
          | / P5
          |/ /|                        axis of the hinges at P0 ... P5: y, z, x, y, z, x in the drawn position
      P0  +-/-|--------- P1  x         at right angles to the two rods it joins
           /  |          |
             P4 ----------- P3         rods: mass m, length L, square section a x a:
                         |/            J = m a^2 / 6 along, m (L^2 + a^2) / 12 across
                         P2            the drawing is the start, at rest; gravity g along -y

Position constraints, 35 in this order: five norms ``p.p - 1``; at each hinge the point of one rod less that of the next
(18 rows [m]); the axis of the second is at right angles to two directions of the first (12 rows).  Counting gives
35 - 35 = 0 degrees of freedom, yet the loop has one: the rows are **redundant**, rank 34 everywhere on the motion, but
consistent.  Accelerations are unique, single multipliers are not, and every row is kept: to choose is the solver's part.

The middle of the loop, P2 (P3 in the source, which counts from 1), runs on ``z = -(L^2 - x^2)/(2 L)``,
``y = -sqrt(L^2 - z^2)``.  The energy is conserved.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.space import rotation, split
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference

SOURCE = "IFToMM library of computational benchmark problems, A04"
X, Y, Z = np.eye(3)
ALONG = np.stack([X, -Y, Z, -X, Y])  #: directions of the rods at the start (5, 3)
AXIS = np.stack([Y, Z, X, Y, Z, X])  #: axes of the six hinges (6, 3); every frame is that of space at the start


def mechanism(*, m: float = 1.0, L: float = 1.0, a: float = 0.1, g: float = 9.81) -> Mechanism:
    """Make the loop at its start, parameters as in :func:`problem`: ``rod 0`` to ``rod 4``, ``hinge 0`` to ``hinge 5``."""
    loop, point = Mechanism((0.0, -g, 0.0)), np.zeros(3)
    along, across = m * a**2 / 6, m * (L**2 + a**2) / 12
    for i, rod in enumerate(ALONG):
        loop.body(f"rod {i}", m, across + (along - across) * rod**2, point + L / 2 * rod)
        loop.revolute(f"hinge {i}", f"rod {i - 1}" if i else "ground", f"rod {i}", point, AXIS[i])
        point = point + L * rod
    loop.revolute("hinge 5", "rod 4", "ground", point, AXIS[5])
    return loop


def joints(L: float, q: Vector) -> Vector:
    """Positions of the hinges P0 ... P5 (6, 3) [m]."""
    x, p = map(np.asarray, split(q))
    ends = x + L / 2 * np.einsum("kij,kj->ki", np.asarray(rotation(p)), ALONG)
    return np.concatenate([[0 * X], ends])


def middle(L: float, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position of the hinge P2 (3,) [m], P3 in the source."""
    return joints(L, q)[2]


def sketch(L: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: hinges as ``points`` (6, 3); rods, ground from P5 to P0, axes of the hinges as ``lines`` (12, 2, 3)
    [m]; y up.
    """
    points = joints(L, q)
    frames = np.concatenate([np.asarray(rotation(split(q)[1])), np.eye(3)[None]])
    axes = 0.1 * L * np.einsum("kij,kj->ki", frames, AXIS)
    bars = np.stack([points, np.roll(points, -1, axis=0)], axis=1)
    return {"points": points, "lines": np.concatenate([bars, np.stack([points - axes, points + axes], axis=1)]), "up": 1}


def problem(*, m: float = 1.0, L: float = 1.0, a: float = 0.1, g: float = 9.81, t_end: float = 10.0) -> Problem:
    """Make the problem: the loop from rest on the edges of a cube over [0, ``t_end``] [s].

    Parameters
    ----------
    m, L
        Mass [kg] and length [m] of a rod, above 0.
    a
        Side of its section [m], above 0.
    g
        Gravity along -y [m/s^2].
    """
    values: dict[str, float] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "L": checked("L", L, above=0.0, unit="m"),
        "a": checked("a", a, above=0.0, unit="m"),
        "g": checked("g", g, unit="m/s^2"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (1.0, 1.0, 0.1, 9.81)
    m, L, a, g = values.values()
    rate = max(math.sqrt(abs(g) / L), 0.1)
    force = m * L * rate**2
    return mechanism(**values).problem(
        (0.0, t_end),
        name="bricard",
        scales=Scales(
            q=np.tile([L, L, L, 1.0, 1.0, 1.0, 1.0], 5),
            v=np.tile([L * rate] * 3 + [rate] * 4, 5),
            lam=np.array([force * L] * 5 + [force] * 18 + [force * L] * 12),
        ),
        observables={"P3": functools.partial(middle, L)},
        reference=load_reference("bricard", t_end) if published else None,
        sketch=functools.partial(sketch, L),
        tags=("holonomic", "redundant", "variable mass"),
        good_for="Redundant but consistent constraints on a mechanism that needs them: every single hinge is regular, only "
        "the closed loop is not.",
        source=SOURCE,
    )
