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

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.space import (
    energy_of_bodies,
    force_on_bodies,
    mass_of_bodies,
    norm_rows,
    placed_with_ground,
    revolute_rows,
    rotation,
    split,
)
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Problem, Scales, System, parameter
from problems._common import checked, load_reference

SOURCE = "IFToMM library of computational benchmark problems, A04"
X, Y, Z = np.eye(3)
ALONG = np.stack([X, -Y, Z, -X, Y])  #: directions of the rods at the start (5, 3)
AXIS = np.stack([Y, Z, X, Y, Z, X])  #: axes of the six hinges (6, 3); every frame is that of space at the start
ACROSS = np.stack([np.roll(AXIS, 1, axis=1), np.roll(AXIS, 2, axis=1)], axis=1)  #: (6, 2, 3)
FIRST, SECOND = np.array([5, 0, 1, 2, 3, 4]), np.arange(6)  #: bodies at each hinge; 5 is the ground
END_OF_FIRST = np.concatenate([[0 * X], ALONG / 2])  #: hinge in the first body, times L (6, 3)
BEGIN_OF_SECOND = np.concatenate([-ALONG / 2, [Z]])  #: hinge in the second body, times L (6, 3)


class Bricard(System):
    """``q`` (35,): five rods; five norms and six hinges of five rows each."""

    m: Array = parameter(1.0, doc="mass of a rod [kg]")
    L: Array = parameter(1.0, doc="length of a rod [m]")
    a: Array = parameter(0.1, doc="side of the square section [m]")
    g: Array = parameter(9.81, doc="gravity, along -y [m/s^2]")
    j0: Array = parameter(0.0566, doc="inertia along each quaternion; the motion does not depend on it [kg m^2]")

    @property
    def masses(self) -> Array:
        """Masses of the rods (5,) [kg]."""
        return jnp.full(5, self.m)

    @property
    def inertia(self) -> Array:
        """Principal moments (5, 3) [kg m^2]; each rod lies along another axis of its frame."""
        along, across = self.m * self.a**2 / 6, self.m * (self.L**2 + self.a**2) / 12
        return across + (along - across) * ALONG**2

    @property
    def gravity(self) -> Array:
        """Gravity vector (3,) [m/s^2]."""
        return -self.g * jnp.asarray(Y)

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (35, 35), a block for each rod."""
        return mass_of_bodies(q, self.masses, self.inertia, jnp.full(5, self.j0))

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and the terms quadratic in p', (35,)."""
        return force_on_bodies(q, v, self.masses, self.inertia, self.gravity)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norms and hinges, (35,), one row of which depends on the others."""
        a, b = self.L * END_OF_FIRST, self.L * BEGIN_OF_SECOND
        hinges = revolute_rows(placed_with_ground(q), FIRST, SECOND, a, b, ACROSS, AXIS)
        return jnp.concatenate([norm_rows(split(q)[1]), hinges])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy above P0 [J]."""
        return energy_of_bodies(q, v, self.masses, self.inertia, self.gravity)


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
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "L": checked("L", L, above=0.0, unit="m"),
        "a": checked("a", a, above=0.0, unit="m"),
        "g": checked("g", g, unit="m/s^2"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (1.0, 1.0, 0.1, 9.81)
    m, L, a, g = values.values()
    values["j0"] = m * (L**2 + 2 * a**2) / 18  # the mean of the principal moments
    corners = L * np.cumsum(ALONG, axis=0)
    rate = max(math.sqrt(abs(g) / L), 0.1)
    force = m * L * rate**2
    start = np.concatenate([corners - L / 2 * ALONG, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))], axis=1)
    return Problem(
        name="bricard",
        system=Bricard(**values),
        t_span=(0.0, t_end),
        q0=start.ravel(),
        v0=np.zeros(35),
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
