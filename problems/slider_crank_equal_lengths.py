r"""Slider-crank whose crank and rod are equally long: its constraints lose rank where both stand upright.

Source: textbook mechanics (Lagrange's equations of a slider-crank); equal lengths are the usual singular case::

                 o                          q = (a, b, x): angles of crank and rod from the x axis [rad], slider [m]
               .' `.                        crank and rod: mass m, length l, uniform; slider: mass m_slider
        l, m .'     `. l, m
           .' a     b `.  _________         0 = l cos a + l cos b - x
          O             `-| slider |        0 = l sin a + l sin b
    ------^---------------+--------+-->  x

    M = [[4/3 m l^2, 1/2 m l^2 cos(a - b), 0], [1/2 m l^2 cos(a - b), 1/3 m l^2, 0], [0, 0, m_slider]]
    F = (-1/2 m l^2 sin(a - b) b'^2 - 3/2 m g l cos a,  1/2 m l^2 sin(a - b) a'^2 - 1/2 m g l cos b,  0)

On the smooth branch ``b = -a, x = 2 l cos a`` the energy alone rules the motion,

    l^2 (m / 3 + (m + 2 m_slider) sin^2 a) a'^2 + m g l sin a = const.

At ``a = pi/2 + n pi`` crank and rod cover each other, the rank of g_q drops from 2 to 1 and a second branch crosses,
``b = a + pi, x = 0``: both turn together about the pin while the slider rests.  The equations do not say which one
follows.  The smooth branch goes on with bounded multipliers (``a'' = 0`` there), but the acceleration level is
singular at that point and badly conditioned beside it: solvers may stop, change branch or step across,
and a finer step is no safer.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import pin_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference, minimal

SOURCE = "textbook mechanics, slider-crank of equal lengths"


class SliderCrank(System):
    """``q = (a, b, x)``; mass matrix of the angles' difference, two position constraints."""

    m: Array = parameter(1.0, doc="mass of the crank and of the rod [kg]")
    m_slider: Array = parameter(1.0, doc="mass of the slider [kg]")
    l: Array = parameter(1.0, doc="length of the crank and of the rod [m]")  # noqa: E741
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (3, 3) [kg m^2, kg m^2, kg]."""
        inertia = self.m * self.l**2
        coupled = inertia * jnp.cos(q[0] - q[1]) / 2
        entries = jnp.stack([4 * inertia / 3, coupled, coupled, inertia / 3, self.m_slider])
        return jnp.zeros((3, 3)).at[np.array([0, 0, 1, 1, 2]), np.array([0, 1, 0, 1, 2])].set(entries)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and the terms quadratic in v, (3,) [N m, N m, N]."""
        coupled = self.m * self.l**2 * jnp.sin(q[0] - q[1]) / 2
        weight = self.m * self.g * self.l / 2
        crank = -coupled * v[1] ** 2 - 3 * weight * jnp.cos(q[0])
        rod = coupled * v[0] ** 2 - weight * jnp.cos(q[1])
        return jnp.stack([crank, rod, jnp.zeros_like(rod)])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: the rod ends at the slider, along and across the rail, (2,) [m]."""
        a, b, x = q
        return self.l * jnp.stack([jnp.cos(a) + jnp.cos(b), jnp.sin(a) + jnp.sin(b)]) - jnp.stack([x, jnp.zeros_like(x)])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        height = self.l * (3 * jnp.sin(q[0]) + jnp.sin(q[1])) / 2
        return v @ self.mass_matrix(t, q) @ v / 2 + self.m * self.g * height


def crank_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle of the crank from the rail [rad]."""
    return float(q[0])


def crank_rate(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angular velocity of the crank [rad/s]."""
    return float(v[0])


def sketch(l: float, q: Vector) -> dict[str, Vector]:  # noqa: E741
    """Drawing at ``q``: pin, joint and slider as ``points`` (3, 2); crank, rod, rail, slider and support as ``lines`` (16,
    2, 2) [m].
    """
    a, _, x = q
    pin, joint, slider = np.zeros(2), l * np.array([math.cos(a), math.sin(a)]), np.array([x, 0.0])
    corners = slider + l * np.array([[-0.15, -0.1], [0.15, -0.1], [0.15, 0.1], [-0.15, 0.1]])
    outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    rail = np.array([[-2.2 * l, -0.1 * l], [2.2 * l, -0.1 * l]])
    lines = np.concatenate([[[pin, joint], [joint, slider], rail], outline, pin_lines(pin, 0.1 * l)])
    return {"points": np.array([pin, joint, slider]), "lines": lines}


def problem(
    *,
    m: float = 1.0,
    m_slider: float = 1.0,
    l: float = 1.0,  # noqa: E741
    g: float = 9.81,
    angle: float = math.pi / 4,
    rate: float = 4.0,
    t_end: float = 2.0,
) -> Problem:
    """Make the problem: the mechanism over [0, ``t_end``] [s]; with the default values it meets a singular position first
    near 0.25 s.

    Parameters
    ----------
    m, m_slider
        Mass of the crank and of the rod, each, and of the slider [kg], above 0.
    l
        Length of the crank and of the rod [m], above 0.
    g
        Gravity [m/s^2], at least 0.
    angle
        Crank angle at the start [rad], in (-pi/2, pi/2): between two singular positions.
    rate
        Crank rate at the start [rad/s].
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "m_slider": checked("m_slider", m_slider, above=0.0, unit="kg"),
        "l": checked("l", l, above=0.0, unit="m"),
        "g": checked("g", g, at_least=0.0, unit="m/s^2"),
    }
    angle = checked("angle", angle, above=-math.pi / 2, below=math.pi / 2, unit="rad")
    rate, t_end = checked("rate", rate, unit="rad/s"), checked("t_end", t_end, above=0.0, unit="s")
    m, m_slider, l, g = values.values()  # noqa: E741
    published = (m, m_slider, l, g, angle, rate) == (1.0, 1.0, 1.0, 9.81, math.pi / 4, 4.0)
    share = 1 + 3 * (1 + 2 * m_slider / m) * math.sin(angle) ** 2  # energy of motion at the start over that at a = 0
    fastest = max(math.sqrt(share * rate**2 + 3 * g / l * (1 + math.sin(angle))), 1.0)  # bound of a' at a = 0 or pi
    return Problem(
        name="slider_crank_equal_lengths",
        system=SliderCrank(**values),
        t_span=(0.0, t_end),
        q0=np.array([angle, -angle, 2 * l * math.cos(angle)]),
        v0=np.array([rate, -rate, -2 * l * math.sin(angle) * rate]),
        scales=Scales(
            q=np.array([1.0, 1.0, l]), v=fastest * np.array([1.0, 1.0, 2 * l]), lam=(m + m_slider) * (g + l * fastest**2)
        ),
        observables={"crank_angle": crank_angle, "crank_rate": crank_rate},
        reference=load_reference("slider_crank_equal_lengths", t_end) if published else None,
        sketch=functools.partial(sketch, l),
        minimal=minimal("turning_crank", m, m_slider, l, g, angle, rate),
        tags=("holonomic", "singular", "variable mass"),
        good_for="Whether a solver gets across positions where the constraints lose rank and two branches of motion cross.",
        source=SOURCE,
    )
