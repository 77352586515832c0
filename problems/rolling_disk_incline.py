r"""A vertical disk (coin) that rolls on an incline while it turns about the vertical diameter.

Source: A. M. Bloch, Nonholonomic Mechanics and Control, Springer 2003 (vertical rolling disk), here pulled down a slope::

      O--------> y  (level)        q = (x, y, phi, th): contact point [m], heading and rolling angle [rad]
      |  \                         M = diag(m, m, Iflip, Irot),  F = (m gs, 0, 0, 0)
      |   \ disk seen from
      v    \ above, angle phi      0 = x' - R th' cos phi
      x  (down the slope)          0 = y' - R th' sin phi       rolling without slip, nonholonomic

It turns with ``phi' = Om`` and rolls with ``th' = spin + k sin(Om t)``, ``k = m gs R / ((Irot + m R^2) Om)``:

    th = spin t + k / Om (1 - cos(Om t)),     x = R / Om (spin sin(Om t) + k sin^2(Om t) / 2),
    y = R (spin (1 - cos(Om t)) / Om + k (t / 2 - sin(2 Om t) / (4 Om))),   mu = (m gs - m x'', -m y'').

On average the disk does not run down the slope but moves level, with ``R k / 2``.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Bloch, Nonholonomic Mechanics and Control, Springer 2003 (vertical rolling disk)"


class RollingDisk(System):
    """``q = (x, y, phi, th)``; constant mass, two velocity constraints."""

    m: Array = parameter(2.0, doc="mass [kg]")
    R: Array = parameter(0.5, doc="radius [m]")
    Iflip: Array = parameter(0.3, doc="inertia about a diameter [kg m^2]")
    Irot: Array = parameter(0.4, doc="inertia about the axis [kg m^2]")
    gs: Array = parameter(3.0, doc="gravity down the slope [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (4,) [kg, kg, kg m^2, kg m^2]."""
        return jnp.stack([self.m, self.m, self.Iflip, self.Irot])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight along the slope, (4,)."""
        pull = self.m * self.gs
        return jnp.stack([pull, *[jnp.zeros_like(pull)] * 3])

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: slip of the contact point, (2,) [m/s]."""
        rolling = self.R * v[3]
        return jnp.stack([v[0] - rolling * jnp.cos(q[2]), v[1] - rolling * jnp.sin(q[2])])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2 - self.m * self.gs * q[0]

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: the turning rate [rad/s]: nothing exerts a moment about the vertical diameter."""
        return {"turning_rate": v[2]}


def exact(m: float, R: float, gs: float, k: float, Om: float, spin: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]; ``k`` is the amplitude of the rolling rate [rad/s]."""
    angle = Om * t
    sin, cos = math.sin(angle), math.cos(angle)
    versed = 2 * math.sin(angle / 2) ** 2  # 1 - cos, without cancellation
    rate, slope = spin + k * sin, k * Om * cos
    x = R / Om * (spin * sin + k * sin**2 / 2)
    y = R / Om * (spin * versed + k * (angle - sin * cos) / 2)
    ax, ay = R * (slope * cos - rate * Om * sin), R * (slope * sin + rate * Om * cos)
    return Motion(
        q=np.array([x, y, angle, spin * t + k / Om * versed]),
        v=np.array([R * rate * cos, R * rate * sin, Om, rate]),
        lam=np.zeros(0),
        mu=np.array([m * (gs - ax), -m * ay]),
    )


def sketch(R: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: contact and centre as ``points`` (2, 3), rim and four spokes as ``lines`` (28, 2, 3) [m], third
    axis off the slope.

    The spokes turn with the rolling angle.
    """
    contact, centre = np.array([q[0], q[1], 0.0]), np.array([q[0], q[1], R])
    ahead, up = np.array([math.cos(q[2]), math.sin(q[2]), 0.0]), np.array([0.0, 0.0, 1.0])
    turn = q[3] + np.linspace(0.0, 2 * math.pi, 25)
    rim = centre + R * (np.outer(np.sin(turn), ahead) + np.outer(np.cos(turn), up))
    spokes = np.stack([np.broadcast_to(centre, (4, 3)), rim[[0, 6, 12, 18]]], axis=1)
    return {"points": np.array([contact, centre]), "lines": np.concatenate([np.stack([rim[:-1], rim[1:]], axis=1), spokes])}


def contact(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Contact point on the plane, (2,) [m]."""
    return np.array(q[:2])


def problem(
    *,
    m: float = 2.0,
    R: float = 0.5,
    Iflip: float = 0.3,
    Irot: float = 0.4,
    gs: float = 3.0,
    Om: float = 1.5,
    spin: float = 2.0,
    t_end: float = 5.0,
) -> Problem:
    """Make the problem: the disk over [0, ``t_end``] [s]; it heads down the slope at the start.

    Parameters
    ----------
    m, R
        Mass [kg] and radius [m], above 0.
    Iflip, Irot
        Inertia about a diameter and about the axis [kg m^2], above 0.
    gs
        Gravity down the slope [m/s^2].
    Om
        Turning rate [rad/s], at least 0.01: the closed solution divides by its square.
    spin
        Rolling rate at the start [rad/s].
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "R": checked("R", R, above=0.0, unit="m"),
        "Iflip": checked("Iflip", Iflip, above=0.0, unit="kg m^2"),
        "Irot": checked("Irot", Irot, above=0.0, unit="kg m^2"),
        "gs": checked("gs", gs, unit="m/s^2"),
    }
    Om, spin = checked("Om", Om, at_least=0.01, unit="rad/s"), checked("spin", spin, unit="rad/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = (*values.values(), Om, spin) == (2.0, 0.5, 0.3, 0.4, 3.0, 1.5, 2.0)
    m, R, _, Irot, gs = values.values()
    k = m * gs * R / ((Irot + m * R**2) * Om)
    rate = abs(spin) + abs(k) + Om
    return Problem(
        name="rolling_disk_incline",
        system=RollingDisk(**values),
        t_span=(0.0, t_end),
        q0=np.zeros(4),
        v0=np.array([R * spin, 0.0, Om, spin]),
        scales=Scales(
            q=np.array([R * rate / Om, R * rate / Om, 1.0, rate / Om]),
            v=np.array([R * rate, R * rate, Om, rate]),
            mu=m * (abs(gs) + R * rate * Om),
        ),
        observables={"contact": contact},
        exact=functools.partial(exact, m, R, gs, k, Om, spin),
        reference=load_reference("rolling_disk_incline", t_end) if published else None,
        sketch=functools.partial(sketch, R),
        tags=("velocity-level",),
        good_for="several velocity constraints at once with both multipliers in closed form",
        source=SOURCE,
    )
