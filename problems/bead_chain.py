r"""A string of N beads on massless rigid links, pinned, falling and swinging in space.

Source: textbook mechanics (Newton's law for N points on inextensible links); this start is the team's own::

    y ^
      |    l       l              l               q = (r_1, ..., r_N), r_i = (x_i, y_i, z_i) [m]; bead i has mass m_i
      O-------(1)-----(2)- ... --(N)--> x         M = diag(m_i),  F_i = (0, -m_i g, 0)
     pin     bead               tip               d_i = r_i - r_(i-1),  r_0 = (0, 0, 0)

      start: r_i = (i l, 0, 0), velocity (0, 0, w i / N)

    0 = (|d_i|^2 - l_i^2) / 2,   i = 1..N   [m^2]

so that link i carries the tension ``l_i lam_i`` [N], ``lam`` in [N/m].  The constraints are quadratic: exact
Jacobians cost little, and their second derivatives are constant.  The moment of momentum about the vertical through
the pin is conserved beside the energy.  SI units.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, outline
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference, minimal

SOURCE = "textbook mechanics, points on rigid links"
LARGE = 100  # beads from which the tag "large" is set: dense linear algebra stops being the best choice about here


class BeadChain(System):
    """``q`` (3 N,): N points in space; constant diagonal mass, links in order from the pin."""

    m: Array = parameter((0.25,) * 4, doc="mass of each bead, (N,) [kg]")
    l: Array = parameter((0.25,) * 4, doc="length of each link, (N,) [m]")  # noqa: E741
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3 N,) [kg]."""
        return jnp.repeat(self.m, 3)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, (3 N,) [N]."""
        return jnp.outer(-self.m * self.g, jnp.array([0.0, 1.0, 0.0])).ravel()

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: lengths of the links, (N,) [m^2]."""
        links = jnp.diff(jnp.pad(q.reshape(-1, 3), ((1, 0), (0, 0))), axis=0)
        return (jnp.sum(links**2, axis=1) - self.l**2) / 2

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2 + self.g * jnp.sum(self.m * q[1::3])

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: angular momentum about the vertical through the pin [kg m^2/s]."""
        return {"vertical_moment_of_momentum": jnp.sum(self.m * (q[2::3] * v[0::3] - q[0::3] * v[2::3]))}


def tip(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position of the last bead, (3,) [m]."""
    return q[-3:]


def tip_velocity(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Velocity of the last bead, (3,) [m/s]."""
    return v[-3:]


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: pin and beads as ``points`` (N + 1, 3), links and a plate around the pin as ``lines`` (N + 4, 2, 3)
    [m]; y up.
    """
    points = np.vstack([np.zeros((1, 3)), np.asarray(q).reshape(-1, 3)])
    plate = outline(0.4 * np.linalg.norm(points[1]) * np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)]))
    return {"points": points, "lines": np.concatenate([chain(points), plate]), "up": 1}


def problem(
    *, n_beads: int = 4, m: float = 1.0, L: float = 1.0, g: float = 9.81, w: float = 0.5, t_end: float = 1.0
) -> Problem:
    """Make the problem: N equal beads on the x axis, moving sideways, over [0, ``t_end``] [s].

    Parameters
    ----------
    n_beads
        N, at least 1.
    m, L
        Total mass [kg] and total length [m], above 0.
    g
        Gravity [m/s^2], above 0.
    w
        Velocity of the last bead along z at the start [m/s]; 0 keeps the motion in a plane.
    """
    n = positive_integer("n_beads", n_beads)
    m, L = checked("m", m, above=0.0, unit="kg"), checked("L", L, above=0.0, unit="m")
    g, w = checked("g", g, above=0.0, unit="m/s^2"), checked("w", w, unit="m/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    values: dict[str, Any] = {"m": np.full(n, m / n), "l": np.full(n, L / n), "g": g}
    share = np.arange(1, n + 1) / n
    q0, v0 = np.zeros((n, 3)), np.zeros((n, 3))
    q0[:, 0], v0[:, 2] = L * share, w * share
    speed = math.hypot(math.sqrt(g * L), w)
    return Problem(
        name="bead_chain",
        system=BeadChain(**values),
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=v0.ravel(),
        scales=Scales(q=L, v=speed, lam=m * speed**2 / L / (L / n)),
        observables={"tip": tip, "tip_velocity": tip_velocity},
        reference=load_reference(f"bead_chain_n{n}", t_end) if (m, L, g, w) == (1.0, 1.0, 9.81, 0.5) else None,
        sketch=sketch,
        minimal=minimal("level_beads", n, m, L, g, w),
        tags=("holonomic", "large") if n >= LARGE else ("holonomic",),
        good_for="Quadratic constraints in space without rotations, for any number of beads, with two invariants to watch.",
        source=SOURCE,
    )
