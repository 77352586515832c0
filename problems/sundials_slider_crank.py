r"""A slider crank with a spring and damper between crank and rod, driven by a constant force on the slider.

Source: example idaSlCrank (and its sensitivity variant) of SUNDIALS, Lawrence Livermore National Laboratory; its
equations written with the vector d between the middles of the bars::

              B                            q = (q, x, p): crank angle [rad], slider [m], rod angle [rad]
             / '-._  rod, length 1         M = diag(J1, m2, J2)
       a    /      '-._                    B = (a cos q, a sin q) = (x - cos p, -sin p)
           o~~~~~~~~~~~o._                 d = middle of rod - middle of crank
          /  k, c, l0     '-._               = (x - (cos p + a cos q) / 2, -(sin p + a sin q) / 2)
         / q                p '-._
    ----O---------------------[ x ]--> F   l = |d|,  f = (k (l - l0) + c l') / l

    M v' = -(dd/dq)^T d f + (0, F, -F sin p) - g_q^T lam
    0 = g = (x - cos p - a cos q, -sin p - a sin q)

F works on ``x + cos p``, not on x alone (so in the source).  The start is at rest with the crank upright, ``q = pi/2``,
``p = -asin(a)``, ``x = sqrt(1 - a^2)``.  SI units; lam [N].

The source prints q = (1.2757, 1.0236, -0.49881) at t = 10 and for the integral of the kinetic energy over [0, 10]
3.3366 J s, with derivatives 0.33346 to k and -0.36375 to c.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import pin_lines, spring_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "SUNDIALS (Lawrence Livermore National Laboratory), example idaSlCrank"


class SpringSliderCrank(System):
    """``q = (q, x, p)``; constant mass, two position constraints, one damper."""

    a: Array = parameter(0.5, doc="length of the crank; the rod has 1 [m]")
    J1: Array = parameter(1.0, doc="inertia of the crank [kg m^2]")
    m2: Array = parameter(1.0, doc="mass of the slider [kg]")
    J2: Array = parameter(2.0, doc="inertia of the rod [kg m^2]")
    k: Array = parameter(1.0, doc="stiffness of the spring [N/m]")
    c: Array = parameter(1.0, doc="damper [N s/m]")
    l0: Array = parameter(1.0, doc="free length of the spring [m]")
    F: Array = parameter(1.0, doc="force [N]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3,) [kg m^2, kg, kg m^2]."""
        return jnp.stack([self.J1, self.m2, self.J2])

    def spring(self, q: Array) -> Array:
        """Vector d of the spring, from the middle of the crank to the middle of the rod, (2,) [m]."""
        return jnp.stack(
            [q[1] - (jnp.cos(q[2]) + self.a * jnp.cos(q[0])) / 2, -(jnp.sin(q[2]) + self.a * jnp.sin(q[0])) / 2]
        )

    def spring_jacobian(self, q: Array) -> Array:
        """Jacobian dd/dq of the spring vector, (2, 3)."""
        one, crank, rod = jnp.ones_like(q[0]), self.a / 2, 0.5
        return jnp.stack(
            [
                jnp.stack([crank * jnp.sin(q[0]), one, rod * jnp.sin(q[2])]),
                jnp.stack([-crank * jnp.cos(q[0]), 0 * one, -rod * jnp.cos(q[2])]),
            ]
        )

    def spring_length(self, q: Array) -> Array:
        """Spring length l [m], positive while the slider is right of the crank's bearing."""
        d = self.spring(q)
        return jnp.sqrt(d @ d)

    def spring_rate(self, q: Array, v: Array) -> Array:
        """Rate l' of the spring length [m/s]."""
        return self.spring(q) @ (self.spring_jacobian(q) @ v) / self.spring_length(q)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: spring, damper and F, (3,) [N m, N, N m]."""
        length = self.spring_length(q)
        f = (self.k * (length - self.l0) + self.c * self.spring_rate(q, v)) / length
        drive = self.F * jnp.stack([jnp.zeros_like(q[0]), jnp.ones_like(q[0]), -jnp.sin(q[2])])
        return drive - f * (self.spring_jacobian(q).T @ self.spring(q))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: both bars meet in B, (2,) [m]."""
        return jnp.stack([q[1] - jnp.cos(q[2]) - self.a * jnp.cos(q[0]), -jnp.sin(q[2]) - self.a * jnp.sin(q[0])])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, spring, and ``-F (x + cos p)`` of the force [J]."""
        stretch = self.spring_length(q) - self.l0
        return (jnp.sum(self.mass_matrix * v**2) + self.k * stretch**2) / 2 - self.F * (q[1] + jnp.cos(q[2]))

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the damper [W]."""
        return -self.c * self.spring_rate(q, v) ** 2


def kinetic_energy(masses: tuple[float, float, float], t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Kinetic energy [J], which the source integrates over time."""
    return float(np.array(masses) @ np.asarray(v) ** 2 / 2)


def sketch(a: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: joints as ``points`` (3, 2); bars, damper, spring, slider, guide and support as ``lines`` (29, 2,
    2) [m].
    """
    O, B, slider = np.zeros(2), a * np.array([np.cos(q[0]), np.sin(q[0])]), np.array([q[1], 0.0])  # noqa: E741
    corners = slider + np.array([(-0.1, -0.06), (0.1, -0.06), (0.1, 0.06), (-0.1, 0.06)])
    outline = [(corners[i], corners[i - 3]) for i in range(4)]
    guide = (np.array([-a, -0.06]), np.array([1 + a + 0.1, -0.06]))
    damper = (B / 2, (B + slider) / 2)
    return {
        "points": np.array([O, B, slider]),
        "lines": np.concatenate(
            [[(O, B), (B, slider), damper, guide], outline, spring_lines(*damper, 5, 0.06), pin_lines(O, 0.06)]
        ),
    }


def problem(
    *,
    a: float = 0.5,
    J1: float = 1.0,
    m2: float = 1.0,
    J2: float = 2.0,
    k: float = 1.0,
    c: float = 1.0,
    l0: float = 1.0,
    F: float = 1.0,
    t_end: float = 10.0,
) -> Problem:
    """Make the problem: the slider crank from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    a
        Length of the crank [m], above 0 and below 1, the length of the rod.
    J1, m2, J2
        Inertias of crank and rod [kg m^2] and mass of the slider [kg], above 0.
    k, c
        Spring [N/m] and damper [N s/m], at least 0.
    l0
        Free length of the spring [m], at least 0.
    F
        Force [N].
    """
    values: dict[str, Any] = {
        "a": checked("a", a, above=0.0, below=1.0, unit="m"),
        "J1": checked("J1", J1, above=0.0, unit="kg m^2"),
        "m2": checked("m2", m2, above=0.0, unit="kg"),
        "J2": checked("J2", J2, above=0.0, unit="kg m^2"),
        "k": checked("k", k, at_least=0.0, unit="N/m"),
        "c": checked("c", c, at_least=0.0, unit="N s/m"),
        "l0": checked("l0", l0, at_least=0.0, unit="m"),
        "F": checked("F", F, unit="N"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (0.5, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0)
    a, J1, m2, J2, k, c, l0, F = values.values()
    load = max(abs(F), k * (l0 + 1), 1e-3)
    return Problem(
        name="sundials_slider_crank",
        system=SpringSliderCrank(**values),
        t_span=(0.0, t_end),
        q0=np.array([math.pi / 2, math.sqrt(1 - a**2), -math.asin(a)]),
        v0=np.zeros(3),
        scales=Scales(q=1.0, v=math.sqrt(load / (J1 + m2 + J2)), lam=load),
        observables={"kinetic_energy": functools.partial(kinetic_energy, (J1, m2, J2))},
        reference=load_reference("sundials_slider_crank", t_end) if published else None,
        sketch=functools.partial(sketch, a),
        tags=("holonomic", "damped"),
        good_for="the one problem that a widely used DAE code prints results and parameter sensitivities for",
        source=SOURCE,
    )
