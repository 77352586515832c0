r"""A bead that slides without friction on a rod turning in the level plane at a constant rate.

Source: textbook, for instance H. Goldstein, Classical Mechanics, section 1.6 (bead on a rotating wire)::

            /
           /  bead, m          q = (x, y): the bead [m], no gravity in the plane
          o                    M = m,  F = 0
         /  r                  0 = y cos(Om t) - x sin(Om t), moving (rheonomic)
        /.  Om t
       O------ x               m r'' = m Om^2 r,   lam = -2 m Om r'

From the distance r0 at the radial speed u0 the bead is thrown out, ``r = r0 cosh(Om t) + u0 / Om sinh(Om t)``.  The
multiplier balances the Coriolis force.  The drive does work: the energy ``m v^2 / 2`` grows, while Jacobi's integral
``m (r'^2 - Om^2 r^2) / 2``, energy less Om times angular momentum, is conserved.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import circle_lines, pin_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Goldstein, Classical Mechanics, section 1.6; closed solution by insertion"


class BeadOnRod(System):
    """``q = (x, y)``; scalar mass, one moving position constraint, no force."""

    m: Array = parameter(2.0, doc="mass of the bead [kg]")
    Om: Array = parameter(3.0, doc="turning rate of the rod [rad/s]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: none, (2,) [N]."""
        return jnp.zeros_like(q)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: distance from the rod's line, (1,) [m]."""
        return jnp.stack([q[1] * jnp.cos(self.Om * t) - q[0] * jnp.sin(self.Om * t)])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy [J]."""
        return self.m * (v @ v) / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the moment that turns the rod [W]: ``lam g_t``."""
        return -lam[0] * self.Om * (q[1] * jnp.sin(self.Om * t) + q[0] * jnp.cos(self.Om * t))

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: Jacobi's integral [J]: energy less Om times angular momentum."""
        return {"jacobi_integral": self.m * (v @ v) / 2 - self.Om * self.m * (q[0] * v[1] - q[1] * v[0])}


def exact(m: float, Om: float, r0: float, u0: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    cosh, sinh = math.cosh(Om * t), math.sinh(Om * t)
    r, u = r0 * cosh + u0 / Om * sinh, u0 * cosh + r0 * Om * sinh
    along = np.array([math.cos(Om * t), math.sin(Om * t)])
    across = np.array([-along[1], along[0]])
    return Motion(q=r * along, v=u * along + Om * r * across, lam=np.array([-2 * m * Om * u]), mu=np.zeros(0))


def radius(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Distance of the bead from the pivot [m]."""
    return math.hypot(q[0], q[1])


def sketch(reach: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot and bead as ``points`` (2, 2), the rod, the bead and the support as ``lines`` (26, 2, 2) [m].

    ``reach``: length of the rod [m].
    """
    bead = np.asarray(q, dtype=float)
    along = bead / np.linalg.norm(bead)
    rod, ground = [[np.zeros(2), reach * along]], pin_lines(np.zeros(2), 0.05 * reach)
    return {
        "points": np.array([np.zeros(2), bead]),
        "lines": np.concatenate([rod, circle_lines(bead, 0.03 * reach), ground]),
    }


def problem(*, m: float = 2.0, Om: float = 3.0, r0: float = 0.5, u0: float = 0.0, t_end: float = 1.0) -> Problem:
    """Make the problem: the bead over [0, ``t_end``] [s]; the rod lies along x at the start.

    Parameters
    ----------
    m
        Mass [kg], above 0.
    Om
        Turning rate [rad/s], at least 0.01: the closed solution divides by it.
    r0, u0
        Distance from the pivot [m], above 0, and radial speed [m/s], at least 0, at the start.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "Om": checked("Om", Om, at_least=0.01, unit="rad/s"),
    }
    r0, u0 = checked("r0", r0, above=0.0, unit="m"), checked("u0", u0, at_least=0.0, unit="m/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    m, Om = values.values()
    motion = functools.partial(exact, m, Om, r0, u0)
    reach = float(np.linalg.norm(motion(t_end).q))
    return Problem(
        name="bead_on_rotating_rod",
        system=BeadOnRod(**values),
        t_span=(0.0, t_end),
        q0=np.array([r0, 0.0]),
        v0=np.array([u0, Om * r0]),
        scales=Scales(q=reach, v=Om * reach, lam=2 * m * Om**2 * reach),
        observables={"radius": radius},
        exact=motion,
        reference=load_reference("bead_on_rotating_rod", t_end) if (m, Om, r0, u0) == (2.0, 3.0, 0.5, 0.0) else None,
        sketch=functools.partial(sketch, 1.1 * reach),
        tags=("holonomic", "rheonomic"),
        good_for="a moving constraint with a closed solution: are the time derivatives of the constraint right?",
        source=SOURCE,
    )
