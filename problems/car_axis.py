r"""The car axis: a chassis on two light springs, its left wheel at rest, its right wheel on a bumpy road.

Source: car axis problem of the Test Set for IVP Solvers (F. Mazzia, F. Iavernaro, C. Magherini, Bari)::

      (xl, yl) ====== chassis, length L ====== (xr, yr)      q = (xl, yl, xr, yr) [m]
         >                                       >           each end carries K = M eps^2 / 2
         <  springs, 1 N/m, free length L0       <           yb = r sin(w t), xb = sqrt(L^2 - yb^2)
         >                                       >
         O--------------- axle, length L --------O
       (0, 0)                                (xb, yb)  moves as the road wants

    K q'' = F(t, q) - g_q^T lam
    0 = g_1 = -(xl xb + yl yb)                         the left spring stands across the axle
    0 = g_2 = -((xl - xr)^2 + (yl - yr)^2 - L^2)       the chassis is rigid

The source multiplies its equations by ``eps^2``: springs of 1/eps^2 on M / 2 become 1 N/m on K, which is small against 1, so
the springs are fast and only the constraints hold the chassis.  The source adds ``+g_q^T lam``; the signs of g above turn
that into the default reaction, and lam keeps the source's values.  SI units; lam [N/m].

Start: springs unstretched, ``q = (0, L0, L, L0)``, ``v = -(L0 r w / L) (1, 0, 1, 0)``; there lam = 0.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import circle_lines, ground_lines, spring_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Test Set for IVP Solvers, car axis problem"


class CarAxis(System):
    """``q = (xl, yl, xr, yr)``; scalar mass, two position constraints, one of them moving."""

    L: Array = parameter(1.0, doc="length of chassis and axle [m]")
    L0: Array = parameter(0.5, doc="free length of the springs [m]")
    eps: Array = parameter(0.01, doc="square root of mass over stiffness, scaled [1]")
    M: Array = parameter(10.0, doc="mass of the chassis before scaling with eps^2 [kg]")
    grav: Array = parameter(1.0, doc="gravity [m/s^2]")
    r: Array = parameter(0.1, doc="height of the bumps [m]")
    w: Array = parameter(10.0, doc="rate of the bumps [rad/s]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar K = M eps^2 / 2 [kg]."""
        return self.M * self.eps**2 / 2

    def base(self, t: Array) -> Array:
        """Right end of the axle (xb, yb), (2,) [m]."""
        y = self.r * jnp.sin(self.w * t)
        return jnp.stack([jnp.sqrt(self.L**2 - y**2), y])

    def base_rate(self, t: Array) -> Array:
        """Velocity of the right end of the axle, (2,) [m/s]."""
        x, y = self.base(t)
        rise = self.r * self.w * jnp.cos(self.w * t)
        return jnp.stack([-y * rise / x, rise])

    def springs(self, t: Array, q: Array) -> Array:
        """Vectors of the left and right spring from the axle to the chassis, (2, 2) [m]."""
        return q.reshape(2, 2) - jnp.stack([jnp.zeros(2), self.base(t)])

    def spring_forces(self, t: Array, q: Array) -> Array:
        """Forces of the left and right spring on the chassis, (2, 2) [N]."""
        springs = self.springs(t, q)
        length = jnp.sqrt(jnp.sum(springs**2, axis=1, keepdims=True))
        return (self.L0 - length) / length * springs

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: springs and weight, (4,) [N]."""
        weight = self.mass_matrix * self.grav
        return (self.spring_forces(t, q) - weight * jnp.array([0.0, 1.0])).ravel()

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: left spring across the axle, length of the chassis, (2,) [m^2]."""
        chassis = q[:2] - q[2:]
        return jnp.stack([-(q[:2] @ self.base(t)), self.L**2 - chassis @ chassis])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, springs and gravity [J]."""
        stretch = jnp.sqrt(jnp.sum(self.springs(t, q) ** 2, axis=1)) - self.L0
        return (self.mass_matrix * (v @ v) + stretch @ stretch) / 2 + self.mass_matrix * self.grav * (q[1] + q[3])

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """The road's power through the right spring and through the moving constraint, ``lam . g_t`` [W]."""
        rate = self.base_rate(t)
        return self.spring_forces(t, q)[1] @ rate - lam[0] * (q[:2] @ rate)


def tilt(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle of the chassis from the level [rad]."""
    return float(np.arctan2(q[3] - q[1], q[2] - q[0]))


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: wheels and chassis ends as ``points`` (4, 2); axle, chassis, springs, wheels, road as ``lines``
    (64, 2, 2) [m].

    The axle is found from the coordinates alone: it stands across the left spring and is as long as the chassis.
    """
    left, right = np.array(q[:2]), np.array(q[2:])
    wheel = np.zeros(2)
    base = np.linalg.norm(right - left) / np.linalg.norm(left) * np.array([left[1], -left[0]])
    size = float(np.linalg.norm(right - left))
    wheels = [circle_lines(place, 0.08 * size) for place in (wheel, base)]
    springs = [spring_lines(wheel, left, 5, 0.08 * size), spring_lines(base, right, 5, 0.08 * size)]
    road = ground_lines(wheel + size * np.array([-0.2, -0.08]), wheel + size * np.array([0.2, -0.08]), 0.05 * size)
    lines = np.concatenate([[(wheel, base), (left, right)], *springs, *wheels, road])
    return {"points": np.array([wheel, base, left, right]), "lines": lines}


def problem(
    *,
    L: float = 1.0,
    L0: float = 0.5,
    eps: float = 0.01,
    M: float = 10.0,
    grav: float = 1.0,
    r: float = 0.1,
    w: float = 10.0,
    t_end: float = 3.0,
) -> Problem:
    """Make the problem: the drive over [0, ``t_end``] [s] from unstretched springs.

    Parameters
    ----------
    L, L0
        Length of chassis and axle, free length of the springs [m], above 0.
    eps
        Square root of mass over stiffness, scaled [1], above 0: the smaller, the faster the springs.
    M
        Mass of the chassis before scaling [kg], above 0.
    grav
        Gravity [m/s^2], at least 0.
    r
        Height of the bumps [m], above 0 and below ``L``.
    w
        Rate of the bumps [rad/s], above 0.
    """
    values: dict[str, Any] = {
        "L": checked("L", L, above=0.0, unit="m"),
        "L0": checked("L0", L0, above=0.0, unit="m"),
        "eps": checked("eps", eps, above=0.0, unit="1"),
        "M": checked("M", M, above=0.0, unit="kg"),
        "grav": checked("grav", grav, at_least=0.0, unit="m/s^2"),
    }
    values["r"] = checked("r", r, above=0.0, below=values["L"], unit="m")
    values["w"] = checked("w", w, above=0.0, unit="rad/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (1.0, 0.5, 0.01, 10.0, 1.0, 0.1, 10.0)
    L, L0, eps, M, grav, r, w = values.values()
    sideways = -L0 * r * w / L
    return Problem(
        name="car_axis",
        system=CarAxis(**values),
        t_span=(0.0, t_end),
        q0=np.array([0.0, L0, L, L0]),
        v0=np.array([sideways, 0.0, sideways, 0.0]),
        scales=Scales(q=L, v=r * w, lam=M * eps**2 / 2 * (grav + r * w**2) / L),
        observables={"tilt": tilt},
        reference=load_reference("car_axis", t_end) if published else None,
        sketch=sketch,
        tags=("holonomic", "rheonomic", "stiff"),
        good_for="a constraint that moves with time, with springs fast against the drive: g_t and g_tt must be right",
        source=SOURCE,
    )
