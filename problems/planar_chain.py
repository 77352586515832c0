r"""A chain of N uniform rods, pinned at one end, that falls from the horizontal: the scalable problem in the plane.

Source: textbook mechanics (Newton and Euler for each rod, the N-link pendulum in absolute coordinates)::

    y ^
      |   1       2             N
      O-------o-------o- ... -o-------*--> x     q = (x_1, y_1, th_1, ..., x_N, y_N, th_N): centres of mass [m] and
     pin     joint                   tip         angles from the x axis [rad]; rod i has mass m_i and length l_i
                                                 M = diag(m_i, m_i, m_i l_i^2 / 12),  F_i = (0, -m_i g, 0)
      start: th_i = 0, at rest

With the ends ``s_i, e_i = (x_i, y_i) -+ l_i / 2 (cos th_i, sin th_i)`` and the pin ``e_0 = (0, 0)`` the joints are

    0 = s_i - e_(i-1),   i = 1..N   (2 N equations [m]),

so that ``lam`` holds the force [N] with which rod i pulls the rod (or the pin) before it.  The motion is chaotic: two
solvers agree for a time that grows only with the logarithm of their accuracy.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import pin_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference, minimal

SOURCE = "textbook mechanics, N-link pendulum in absolute coordinates"
LARGE = 100  # rods from which the tag "large" is set: dense linear algebra stops being the best choice about here


def rod_ends(q: Any, l: Any, xp: Any = np) -> tuple[Any, Any]:  # noqa: E741
    """Both ends of every rod, (N, 2) each [m]; ``xp`` is the array namespace."""
    rods = q.reshape(-1, 3)
    arm = l[:, None] / 2 * xp.stack([xp.cos(rods[:, 2]), xp.sin(rods[:, 2])], axis=1)
    return rods[:, :2] - arm, rods[:, :2] + arm


class PlanarChain(System):
    """``q`` (3 N,): N rods; constant diagonal mass, joints in order from the pin."""

    m: Array = parameter((0.125,) * 8, doc="mass of each rod, (N,) [kg]")
    l: Array = parameter((0.125,) * 8, doc="length of each rod, (N,) [m]")  # noqa: E741
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3 N,) [kg, kg, kg m^2]."""
        return jnp.stack([self.m, self.m, self.m * self.l**2 / 12], axis=1).ravel()

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, (3 N,) [N, N, N m]."""
        return jnp.outer(-self.m * self.g, jnp.array([0.0, 1.0, 0.0])).ravel()

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: each rod begins where the one before it ends, (2 N,) [m]."""
        begins, ends = rod_ends(q, self.l, jnp)
        return (begins - jnp.pad(ends[:-1], ((1, 0), (0, 0)))).ravel()

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2 + self.g * jnp.sum(self.m * q[1::3])


def tip(last: float, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position and velocity (x, y, u, v) of the free end [m, m/s]; ``last`` is the length of the last rod [m]."""
    x, y, angle = q[-3:]
    arm = last / 2 * np.array([math.cos(angle), math.sin(angle)])
    return np.array([x + arm[0], y + arm[1], v[-3] - arm[1] * v[-1], v[-2] + arm[0] * v[-1]])


def sketch(l: Vector, q: Vector) -> dict[str, Vector]:  # noqa: E741
    """Drawing at ``q``: pin, joints and tip as ``points`` (N + 1, 2), rods and support as ``lines`` (N + 9, 2, 2) [m]."""
    begins, ends = rod_ends(np.asarray(q), l)
    rods, ground = np.stack([begins, ends], axis=1), pin_lines(np.zeros(2), 0.05 * float(np.sum(l)), 1.0)
    return {"points": np.vstack([np.zeros((1, 2)), ends]), "lines": np.concatenate([rods, ground])}


def problem(*, n_links: int = 8, m: float = 1.0, L: float = 1.0, g: float = 9.81, t_end: float = 1.0) -> Problem:
    """Make the problem: N equal rods from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_links
        N, at least 1.
    m, L
        Total mass [kg] and total length [m], above 0.
    g
        Gravity [m/s^2], above 0.
    """
    n = positive_integer("n_links", n_links)
    m, L = checked("m", m, above=0.0, unit="kg"), checked("L", L, above=0.0, unit="m")
    g, t_end = checked("g", g, above=0.0, unit="m/s^2"), checked("t_end", t_end, above=0.0, unit="s")
    values: dict[str, Any] = {"m": np.full(n, m / n), "l": np.full(n, L / n), "g": g}
    q0 = np.zeros((n, 3))
    q0[:, 0] = L * (np.arange(n) + 0.5) / n
    speed, rate = math.sqrt(g * L), math.sqrt(g / L) * math.sqrt(n)  # short rods turn faster than the chain swings
    return Problem(
        name="planar_chain",
        system=PlanarChain(**values),
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=np.zeros(3 * n),
        scales=Scales(q=np.tile([L, L, 1.0], n), v=np.tile([speed, speed, rate], n), lam=m * g),
        observables={"tip": functools.partial(tip, L / n)},
        reference=load_reference(f"planar_chain_n{n}", t_end) if (m, L, g) == (1.0, 1.0, 9.81) else None,
        sketch=functools.partial(sketch, values["l"]),
        minimal=minimal("level_chain", n, m, L, g),
        tags=("holonomic", "large") if n >= LARGE else ("holonomic",),
        good_for="How cost grows with size: 3 N absolute coordinates whose banded, tree-like joints sparse solvers can use.",
        source=SOURCE,
    )
