r"""A skate (knife edge) sliding down an incline while it turns at a constant rate.

Source: A. M. Bloch, Nonholonomic Mechanics and Control, Springer 2003 (knife edge on an incline)::

      O--------> y  (level)        q = (x, y, phi): contact point [m] and heading [rad]
      |  \                         M = diag(m, m, I),  F = (m G, 0, 0),  G = g sin(incline)
      |   \ blade, angle phi       0 = x' sin phi - y' cos phi
      v    \  from the x axis
      x  (down the slope)          no motion across the blade: velocity level only, nonholonomic

From rest at the origin with ``phi' = Om``:

    x = G / (2 Om^2) sin^2(Om t),   y = G / (2 Om^2) (Om t - sin(2 Om t) / 2),   mu = 2 m G sin(Om t).

The skate does not run down the slope: it moves level, on average with ``G / (2 Om)``, along a cycloid.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import outline
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Bloch, Nonholonomic Mechanics and Control, Springer 2003"


class KnifeEdge(System):
    """``q = (x, y, phi)``; constant mass, one velocity constraint."""

    m: Array = parameter(1.25, doc="mass [kg]")
    I: Array = parameter(0.13, doc="inertia about the contact point [kg m^2]")  # noqa: E741
    incline: Array = parameter(0.5, doc="angle of the plane [rad]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3,) [kg, kg, kg m^2]."""
        return jnp.stack([self.m, self.m, self.I])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight along the slope, (3,)."""
        pull = self.m * self.g * jnp.sin(self.incline)
        return jnp.stack([pull, jnp.zeros_like(pull), jnp.zeros_like(pull)])

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: velocity across the blade, (1,) [m/s]."""
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2 - self.m * self.g * jnp.sin(self.incline) * q[0]

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: the turning rate [rad/s]: nothing exerts a moment."""
        return {"turning_rate": v[2]}


def exact(m: float, G: float, Om: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    angle, factor = Om * t, G / (2 * Om**2)
    sin, cos = math.sin(angle), math.cos(angle)
    q = np.array([factor * sin**2, factor * (angle - sin * cos), angle])
    v = np.array([G / Om * sin * cos, G / Om * sin**2, Om])
    return Motion(q=q, v=v, lam=np.zeros(0), mu=np.array([2 * m * G * sin]))


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: the contact as ``points`` (1, 2), the skate as ``lines`` (5, 2, 2) [m]; down the slope is down on
    the paper.
    """
    place = np.array([q[1], -q[0]])
    ahead = np.array([np.sin(q[2]), -np.cos(q[2])])
    side = np.array([-ahead[1], ahead[0]])
    shape = np.array([[-0.14, -0.05], [0.1, -0.05], [0.18, 0.0], [0.1, 0.05], [-0.14, 0.05]])
    corners = place + np.outer(shape[:, 0], ahead) + np.outer(shape[:, 1], side)
    return {"points": np.array([place]), "lines": outline(corners)}


def contact(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Contact point on the slope, (2,) [m]."""
    return np.array(q[:2])


def problem(
    *,
    m: float = 1.25,
    I: float = 0.13,  # noqa: E741
    incline: float = 0.5,
    g: float = 9.81,
    Om: float = 2.0,
    t_end: float = 5.0,
) -> Problem:
    """Make the problem: the skate from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    m, I
        Mass [kg] and inertia [kg m^2], above 0.
    incline
        Angle of the plane [rad], in [0, pi/2).
    g
        Gravity [m/s^2].
    Om
        Turning rate [rad/s], at least 0.01: the closed solution divides by its square.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "I": checked("I", I, above=0.0, unit="kg m^2"),
        "incline": checked("incline", incline, at_least=0.0, below=math.pi / 2, unit="rad"),
        "g": checked("g", g, unit="m/s^2"),
    }
    Om, t_end = checked("Om", Om, at_least=0.01, unit="rad/s"), checked("t_end", t_end, above=0.0, unit="s")
    G = values["g"] * math.sin(values["incline"])
    published = (*values.values(), Om) == (1.25, 0.13, 0.5, 9.81, 2.0)
    speed = max(abs(G) / Om, 1.0)
    return Problem(
        name="knife_edge",
        system=KnifeEdge(**values),
        t_span=(0.0, t_end),
        q0=np.zeros(3),
        v0=np.array([0.0, 0.0, Om]),
        scales=Scales(q=1.0, v=np.array([speed, speed, Om]), mu=max(2 * values["m"] * abs(G), 1.0)),
        observables={"contact": contact},
        exact=functools.partial(exact, values["m"], G, Om),
        reference=load_reference("knife_edge", t_end) if published else None,
        sketch=sketch,
        tags=("velocity-level",),
        good_for="the smallest nonholonomic system: velocity constraint alone",
        source=SOURCE,
    )
