r"""A free particle whose velocity must stay in a plane that tilts with its place: ``z' = y x'``.

Source: R. M. Rosenberg, Analytical Dynamics of Discrete Systems, Plenum 1977; A. M. Bloch, Nonholonomic Mechanics and
Control, Springer 2003 (nonholonomic free particle)::

       z   admissible plane at q        q = (x, y, z): the particle [m], y in units of 1 m in z' = y x'
       |     ,---------,                M = m,  F = 0
       |    /    o    /                 0 = y x' - z'
       |   '---------'   spanned by (1, 0, y) and (0, 1, 0)
       +-------- x
      y

With ``y = y0 + vy t`` and ``c = vx sqrt(1 + y0^2)``:

    x' = c / sqrt(1 + y^2),                     z' = c y / sqrt(1 + y^2),
    x = c / vy (asinh y - asinh y0),            z = c / vy (sqrt(1 + y^2) - sqrt(1 + y0^2)),   mu = m c vy / (1 + y^2)^(3/2).

Each of ``y'`` and ``x' sqrt(1 + y^2)`` is conserved.  SI units.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Rosenberg, Analytical Dynamics of Discrete Systems, Plenum 1977; Bloch, Nonholonomic Mechanics and Control, 2003"


class NonholonomicParticle(System):
    """``q = (x, y, z)``; scalar mass, one velocity constraint, no force."""

    m: Array = parameter(1.0, doc="mass [kg]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: none, (3,) [N]."""
        return jnp.zeros_like(q)

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: velocity out of the admissible plane, (1,) [m/s]."""
        return jnp.stack([q[1] * v[0] - v[2]])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy [J]."""
        return self.m * (v @ v) / 2

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: speeds along the two directions of the admissible plane [m/s]."""
        return {"y_speed": v[1], "tilted_speed": v[0] * jnp.sqrt(1 + q[1] ** 2)}


def exact(m: float, y0: float, vx: float, vy: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    y, c = y0 + vy * t, vx * math.hypot(1.0, y0)
    root = math.hypot(1.0, y)
    rise = (y**2 - y0**2) / (root + math.hypot(1.0, y0))  # difference of the roots, without cancellation
    q = np.array([c / vy * (math.asinh(y) - math.asinh(y0)), y, c / vy * rise])
    return Motion(q=q, v=np.array([c / root, vy, c * y / root]), lam=np.zeros(0), mu=np.array([m * c * vy / root**3]))


def sketch(size: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: the particle as ``points`` (1, 3), a square of its admissible plane as ``lines`` (4, 2, 3) [m]."""
    along = size * np.array([1.0, 0.0, q[1]]) / math.hypot(1.0, q[1])
    across = np.array([0.0, size, 0.0])
    corners = np.array([q - along - across, q + along - across, q + along + across, q - along + across])
    return {"points": np.array([q]), "lines": np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)}


def height(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Coordinate z [m]."""
    return float(q[2])


def problem(*, m: float = 1.0, y0: float = 1.0, vx: float = 1.0, vy: float = 0.5, t_end: float = 10.0) -> Problem:
    """Make the problem: the particle from (0, ``y0``, 0) over [0, ``t_end``] [s].

    Parameters
    ----------
    m
        Mass [kg], above 0.
    y0
        Start on the y axis [m].
    vx, vy
        Speeds at the start [m/s]; vy is at least 0.01: the closed solution divides by it.
    """
    m, y0 = checked("m", m, above=0.0, unit="kg"), checked("y0", y0, unit="m")
    vx, vy = checked("vx", vx, unit="m/s"), checked("vy", vy, at_least=0.01, unit="m/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    speed = max(abs(vx) * math.hypot(1.0, y0), vy)
    return Problem(
        name="nonholonomic_particle",
        system=NonholonomicParticle(m=jnp.asarray(m)),
        t_span=(0.0, t_end),
        q0=np.array([0.0, y0, 0.0]),
        v0=np.array([vx, vy, y0 * vx]),
        scales=Scales(q=max(speed * t_end, abs(y0)), v=speed, mu=m * speed * vy),
        observables={"height": height},
        exact=functools.partial(exact, m, y0, vx, vy),
        reference=load_reference("nonholonomic_particle", t_end) if (m, y0, vx, vy) == (1.0, 1.0, 1.0, 0.5) else None,
        sketch=functools.partial(sketch, 0.06 * speed * t_end),
        tags=("velocity-level",),
        good_for="the textbook's nonholonomic constraint with no force at all: any change of speed is the method's",
        source=SOURCE,
    )
