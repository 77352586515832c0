r"""A pendulum whose length is fixed twice: two constraints, rank one.

Source: the pendulum of L. D. Landau, E. M. Lifshitz, Mechanics, section 11, with its constraint repeated; on redundant
constraints J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems, Springer 1994::

      pivot (0, 0)  O==========o  m      q = (x, y): the mass point [m], y upwards
                     two rods            M = m,  F = (0, -m g)
                     side by side        0 = g1 = (x^2 + y^2 - L^2) / 2
                                         0 = g2 = factor g1

The motion is the single pendulum's.  The multipliers are not: only ``lam1 + factor lam2 = S / L`` is determined (S: the
pull of both rods together [N]).  ``exact`` holds the pair of the smallest norm, ``S / L (1, factor) / (1 + factor^2)``,
which a solution by least squares gives; other pairs with the same sum are equally right.  SI units.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import parameter
from problems._common import checked, load_reference, minimal
from problems._pendulum import Bob, pendulum_lines, quarter, swinging_point

SOURCE = "Landau and Lifshitz, Mechanics, section 11, with the constraint repeated; closed solution by insertion"


class RedundantPendulum(Bob):
    """``q = (x, y)``; scalar mass, two position constraints that say the same."""

    factor: Array = parameter(2.0, doc="second constraint over the first")

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: length of both rods, (2,) [m^2]."""
        length = (q @ q - self.L**2) / 2
        return jnp.stack([length, self.factor * length])


def exact(m: float, L: float, g: float, factor: float, amplitude: float, t: float) -> Motion:
    """Closed solution at ``t`` [s], its multipliers those of the smallest norm."""
    motion, pull = swinging_point(m, L, g, amplitude, 4 * quarter(amplitude) * math.sqrt(L / g), t)
    return motion._replace(lam=pull / L * np.array([1.0, factor]) / (1 + factor**2))


def pull(factor: float, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Determined combination of the multipliers, ``lam1 + factor lam2`` [N/m]."""
    return float(lam[0] + factor * lam[1])


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot and bob as ``points`` (2, 2), two rods, support and bob as ``lines`` (23, 2, 2) [m]."""
    bob = np.asarray(q, dtype=float)
    lines = pendulum_lines(np.zeros(2), bob, 0.08 * float(np.linalg.norm(bob)))
    aside = 0.02 * np.array([-bob[1], bob[0]])
    rods = np.array([[aside, bob + aside], [-aside, bob - aside]])
    return {"points": np.array([np.zeros(2), bob]), "lines": np.concatenate([rods, lines[1:]])}


def problem(
    *,
    m: float = 1.0,
    L: float = 1.0,
    g: float = 9.81,
    factor: float = 2.0,
    amplitude: float = math.pi / 3,
    t_end: float = 5.0,
) -> Problem:
    """Make the problem: the pendulum let go at rest, over [0, ``t_end``] [s].

    Parameters
    ----------
    m, L
        Mass [kg] and length [m], above 0.
    g
        Gravity [m/s^2], above 0.
    factor
        The second constraint is this many times the first, above 0.
    amplitude
        Angle from hanging at the start [rad], in [-3.1, 3.1).  Away from pi/2 the rods pull from the beginning.
    """
    m, L = checked("m", m, above=0.0, unit="kg"), checked("L", L, above=0.0, unit="m")
    g, factor = checked("g", g, above=0.0, unit="m/s^2"), checked("factor", factor, above=0.0, unit="1")
    amplitude = checked("amplitude", amplitude, at_least=-3.1, below=3.1, unit="rad")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = (m, L, g, factor, amplitude) == (1.0, 1.0, 9.81, 2.0, math.pi / 3)
    return Problem(
        name="redundant_pendulum",
        system=RedundantPendulum(m=jnp.asarray(m), L=jnp.asarray(L), g=jnp.asarray(g), factor=jnp.asarray(factor)),
        t_span=(0.0, t_end),
        q0=L * np.array([math.sin(amplitude), -math.cos(amplitude)]),
        v0=np.zeros(2),
        scales=Scales(q=L, v=math.sqrt(2 * g * L), lam=m * g / L * np.array([1.0, factor]) / (1 + factor**2)),
        observables={"pull": functools.partial(pull, factor)},
        exact=functools.partial(exact, m, L, g, factor, amplitude),
        reference=load_reference("redundant_pendulum", t_end) if published else None,
        sketch=sketch,
        minimal=minimal("hanging_point", m, L, g, amplitude),
        tags=("holonomic", "redundant"),
        good_for="the smallest redundant system: is a singular KKT matrix noticed, and which multipliers come out?",
        source=SOURCE,
    )
