r"""A point driven around a circle at growing speed.

Source: a test equation of the literature on multistep methods of index 3, known under the name of C. Arevalo (the
original paper was not at hand; the solution is confirmed by insertion)::

            y
            |  ,-o        q = (x, y): a unit mass on the circle of radius 1, angle phi from the y axis
          --|-'   \       M = 1,  F = c (y, -x): a push along the circle, clockwise
       ,'   |phi   .
      -------O-----.-- x  0 = (x^2 + y^2 - 1) / 2
       .           '
        `--.___.--'       x'' = c y - lam x,   y'' = -c x - lam y   (source: c = 2)

The push turns it with ``phi'' = c``, so ``phi = c t^2 / 2`` if it starts with that angle and the rate ``c t``:

    x = sin(c t^2 / 2),   y = cos(c t^2 / 2),   lam = phi'^2 = c^2 t^2.

Dimensionless.  The push has no potential: the energy grows like ``c^2 t^2 / 2``.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "test equation known under the name of C. Arevalo; closed solution by insertion"


class DrivenOnCircle(System):
    """``q = (x, y)``; unit mass, one position constraint."""

    c: Array = parameter(2.0, doc="push, the angular acceleration [1]")

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: push along the circle, (2,)."""
        return self.c * jnp.stack([q[1], -q[0]])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: distance from the centre, (1,)."""
        return jnp.stack([(q @ q - 1) / 2])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy."""
        return (v @ v) / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the push."""
        return self.force(t, q, v) @ v


def exact(c: float, t: float) -> Motion:
    """Closed solution at ``t``."""
    angle, rate = c * t**2 / 2, c * t
    sin, cos = math.sin(angle), math.cos(angle)
    return Motion(q=np.array([sin, cos]), v=rate * np.array([cos, -sin]), lam=np.array([rate**2]), mu=np.zeros(0))


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: the point as ``points`` (1, 2), the circle and a spoke to the point as ``lines`` (49, 2, 2)."""
    turn = np.linspace(0.0, 2 * math.pi, 49)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    spoke = np.array([[np.zeros(2), q]])
    return {"points": np.array([q]), "lines": np.concatenate([np.stack([circle[:-1], circle[1:]], axis=1), spoke])}


def speed(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Speed of the mass [m/s]."""
    return float(np.hypot(*v))


def problem(*, c: float = 2.0, t_start: float = 1.0, t_end: float = 5.0) -> Problem:
    """Make the problem: the point over [``t_start``, ``t_end``], turning at the rate ``c t``.

    Parameters
    ----------
    c
        Push, above 0.
    t_start, t_end
        Start, at least 0, and end, above the start.
    """
    c, t_start = checked("c", c, above=0.0, unit="1"), checked("t_start", t_start, at_least=0.0, unit="1")
    t_end = checked("t_end", t_end, unit="1")
    if t_end <= t_start:
        raise ProblemError(f"t_end must be above t_start = {t_start:g} [1]; got {t_end:g}.")
    start, rate = exact(c, t_start), c * t_end
    return Problem(
        name="arevalo_circle",
        system=DrivenOnCircle(c=jnp.asarray(c)),
        t_span=(t_start, t_end),
        q0=start.q,
        v0=start.v,
        scales=Scales(q=1.0, v=rate, lam=rate**2),
        observables={"speed": speed},
        exact=functools.partial(exact, c),
        reference=load_reference("arevalo_circle", t_end) if (c, t_start) == (2.0, 1.0) else None,
        sketch=sketch,
        tags=("holonomic",),
        good_for="growing speed: curvature and multiplier rise with t, so a step that was fine becomes too long",
        source=SOURCE,
    )
