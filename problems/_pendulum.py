"""Helpers of the pendulum problems: mass and weight, the free swing by Jacobi elliptic functions, the drawing."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import ellipj, ellipkm1

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion
from hhtbench.protocol.system import System, parameter


class Bob(System):
    """Mass point ``q = (x, y)`` under its weight; subclasses add the constraint."""

    m: Array = parameter(1.0, doc="mass [kg]")
    L: Array = parameter(1.0, doc="length of the rod [m]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, (2,) [N]."""
        return jnp.stack([jnp.zeros_like(self.m), -self.m * self.g])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return self.m * (v @ v) / 2 + self.m * self.g * q[1]


def quarter(amplitude: float) -> float:
    """Complete elliptic integral K of the modulus ``k = sin(amplitude / 2)``; the period is ``4 K sqrt(L / g)``."""
    return float(ellipkm1(math.cos(amplitude / 2) ** 2))


def swing(amplitude: float, period: float, t: float) -> tuple[float, float]:
    """Angle from hanging [rad] and rate [rad/s] at ``t`` of a pendulum released at ``amplitude``.

    ``sin(angle / 2) = k cd(w t)`` with ``w = 4 K / period``.  Time is reduced modulo the period first, so that no digits
    are lost over many periods.
    """
    k, k1 = math.sin(amplitude / 2), math.cos(amplitude / 2)
    w = 4 * quarter(amplitude) / period
    sn, cn, dn, _ = ellipj(w * math.fmod(t, period), k**2)
    return 2 * math.atan2(k * cn, k1), -2 * k * w * k1 * float(sn / dn)


def swinging_point(m: float, L: float, g: float, amplitude: float, period: float, t: float) -> tuple[Motion, float]:
    """Motion ``q = (x, y)`` of the bob, without multipliers, and the tension of the rod [N]."""
    angle, rate = swing(amplitude, period, t)
    sin, cos = math.sin(angle), math.cos(angle)
    motion = Motion(
        q=np.array([L * sin, -L * cos]),
        v=L * rate * np.array([cos, sin]),
        lam=np.zeros(0),
        mu=np.zeros(0),
    )
    return motion, m * (L * rate**2 + g * cos)


def pendulum_lines(pivot: Vector, bob: Vector, size: float) -> Vector:
    """Rod, the bob's outline and a support above the pivot, (22, 2, 2) [m]; ``size`` of the support and the bob [m]."""
    from hhtbench.mechanics.lines import circle_lines, pin_lines  # solves draw nothing

    return np.concatenate([[[pivot, bob]], circle_lines(bob, size / 2, 12), pin_lines(pivot, size, 1.0)])


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot and bob as ``points`` (2, 2), rod, support and bob as ``lines`` (22, 2, 2) [m]."""
    bob = np.asarray(q, dtype=float)
    lines = pendulum_lines(np.zeros(2), bob, 0.08 * float(np.linalg.norm(bob)))
    return {"points": np.array([np.zeros(2), bob]), "lines": lines}


def angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle from hanging [rad]."""
    return math.atan2(q[0], -q[1])
