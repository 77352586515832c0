r"""One coordinate, driven: the smallest index 3 problem, made for errors of multipliers alone.

Source: the scalar test equation of this bench, ``q'' + lam = 0, q = sin t``; the solution is inserted and read off::

         motor arm: A sin(w t)
      |=======================>[ m ]          q: place of the slider [m];  M = m,  F = 0
      |------------------------|---> q        0 = q - A sin(w t),  moving (rheonomic)
      0

Nothing is left to integrate: q and v are prescribed and ``lam = -m q'' = m A w^2 sin(w t)`` [N] is the push of the
slider on the arm.  A method that imposes the position constraint alone takes its multiplier from second differences of
the positions and from its own past.  What plain index 3 alpha methods then do, started from exact values: with spectral
radius 1 at infinity (trapezoidal rule) the multiplier's error alternates in sign and grows with t, no matter how small the
step (m = A = w = 1: 2/3 at t = 2); with a smaller radius an error of size O(h) dies out in a few steps.  SI units.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import ground_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "test equation of this bench; closed solution by insertion"


class DrivenCoordinate(System):
    """``q`` (1,); scalar mass, one moving position constraint, no force."""

    m: Array = parameter(1.0, doc="mass [kg]")
    A: Array = parameter(1.0, doc="amplitude of the drive [m]")
    w: Array = parameter(1.0, doc="circular frequency of the drive [rad/s]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: none, (1,) [N]."""
        return jnp.zeros_like(q)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: distance from the motor's arm, (1,) [m]."""
        return q - self.A * jnp.sin(self.w * t)

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy [J]."""
        return self.m * (v @ v) / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the motor [W]: ``lam g_t``."""
        return -lam[0] * self.A * self.w * jnp.cos(self.w * t)


def exact(m: float, A: float, w: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    sin, cos = math.sin(w * t), math.cos(w * t)
    return Motion(q=np.array([A * sin]), v=np.array([A * w * cos]), lam=np.array([m * A * w**2 * sin]), mu=np.zeros(0))


def sketch(A: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: slider as ``points`` (1, 2), wall, guide, arm and slider as ``lines`` (12, 2, 2) [m]."""
    x, size = float(q[0]), 0.1 * A
    corners = np.array([x, 0.0]) + size * np.array([[-1.0, -0.6], [1.0, -0.6], [1.0, 0.6], [-1.0, 0.6]])
    block = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    wall, below = -1.5 * A, -0.6 * size
    rail, arm = [[(wall, below), (1.5 * A, below)]], [[(wall, 0.0), (x - size, 0.0)]]
    ground = ground_lines((wall, 1.2 * size), (wall, -1.2 * size), size)
    return {"points": np.array([[x, 0.0]]), "lines": np.concatenate([block, rail, arm, ground])}


def pull(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Force that drives the coordinate [N]."""
    return float(lam[0])


def problem(*, m: float = 1.0, A: float = 1.0, w: float = 1.0, t_end: float = 5.0) -> Problem:
    """Make the problem: the driven slider over [0, ``t_end``] [s].

    Parameters
    ----------
    m
        Mass [kg], above 0.
    A, w
        Amplitude [m] and circular frequency [rad/s] of the drive, above 0.
    """
    m = checked("m", m, above=0.0, unit="kg")
    A, w = checked("A", A, above=0.0, unit="m"), checked("w", w, above=0.0, unit="rad/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    return Problem(
        name="driven_coordinate",
        system=DrivenCoordinate(m=jnp.asarray(m), A=jnp.asarray(A), w=jnp.asarray(w)),
        t_span=(0.0, t_end),
        q0=np.zeros(1),
        v0=np.array([A * w]),
        scales=Scales(q=A, v=A * w, lam=m * A * w**2),
        observables={"pull": pull},
        exact=functools.partial(exact, m, A, w),
        reference=load_reference("driven_coordinate", t_end) if (m, A, w) == (1.0, 1.0, 1.0) else None,
        sketch=functools.partial(sketch, A),
        tags=("holonomic", "rheonomic"),
        good_for="the multiplier by itself, with no motion left to hide behind: what errors of its start become",
        source=SOURCE,
    )
