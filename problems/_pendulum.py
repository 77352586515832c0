"""What the pendulum problems share: the free swing by Jacobi elliptic functions and the drawing."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ellipj, ellipkm1

from hhtbench.arguments import Vector
from hhtbench.mechanics.lines import circle_lines, pin_lines
from hhtbench.protocol import Motion


def quarter(amplitude: float) -> float:
    """Complete elliptic integral K of the modulus ``k = sin(amplitude / 2)``: the swing's period is ``4 K sqrt(L / g)``."""
    return float(ellipkm1(math.cos(amplitude / 2) ** 2))


def swing(amplitude: float, period: float, t: float) -> tuple[float, float]:
    """Angle from hanging [rad] and rate [rad/s] at ``t`` of a pendulum let go at ``amplitude``.

    ``sin(angle / 2) = k cd(w t)`` with ``w = 4 K / period``.  Time is reduced by the period first: whole periods then cost
    no digits, however many they are.
    """
    k, k1 = math.sin(amplitude / 2), math.cos(amplitude / 2)
    w = 4 * quarter(amplitude) / period
    sn, cn, dn, _ = ellipj(w * math.fmod(t, period), k**2)
    return 2 * math.atan2(k * cn, k1), -2 * k * w * k1 * float(sn / dn)


def swinging_point(m: float, L: float, g: float, amplitude: float, period: float, t: float) -> tuple[Motion, float]:
    """Motion ``q = (x, y)`` of the bob, without multipliers, and the pull of the rod [N]."""
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
    return np.concatenate([[[pivot, bob]], circle_lines(bob, size / 2, 12), pin_lines(pivot, size, 1.0)])
