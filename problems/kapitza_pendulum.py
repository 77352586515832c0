r"""Kapitza's pendulum: a mass point on a rod whose pivot is shaken up and down.

Source: P. L. Kapitza 1951; L. D. Landau, E. M. Lifshitz, Mechanics, section 30 (motion in a rapidly oscillating field)::

               o  m                q = (x, y): the mass point [m], y upwards
              /                    M = m,  F = (0, -m g)
             /  L                  0 = (x^2 + (y - p(t))^2 - L^2) / 2
            /. angle
      p   [O]  pivot               p(t) = A cos(w t), moving (rheonomic)
       |   |   guide

With the angle from the upright, ``angle'' = (g - A w^2 cos(w t)) / L sin(angle)``; the rod pulls with ``S = lam L``.  Fast
shaking holds the pendulum upright if ``A w > sqrt(2 g L)``.  The published case is just too slow, ``A w = 4 m/s`` against
``4.43 m/s``: it tips over within 3 s.  ``A w^2 = 320 m/s^2`` is 33 times gravity, so the multiplier swings with the drive.
SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import box_lines, circle_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import parameter
from problems._common import checked, load_reference
from problems._pendulum import Bob

SOURCE = "Kapitza 1951; Landau and Lifshitz, Mechanics, section 30"


class KapitzaPendulum(Bob):
    """``q = (x, y)``; scalar mass, one moving position constraint."""

    A: Array = parameter(0.05, doc="amplitude of the pivot [m]")
    w: Array = parameter(80.0, doc="circular frequency of the pivot [rad/s]")

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: length of the rod, (1,) [m^2]."""
        height = q[1] - self.A * jnp.cos(self.w * t)
        return jnp.stack([(q[0] ** 2 + height**2 - self.L**2) / 2])

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the force that shakes the pivot [W]: ``lam g_t``."""
        height = q[1] - self.A * jnp.cos(self.w * t)
        return lam[0] * height * self.A * self.w * jnp.sin(self.w * t)


def angle(A: float, w: float, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle from the upright [rad], in (-pi, pi]."""
    return math.atan2(q[0], q[1] - A * math.cos(w * t))


def sketch(L: float, A: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot and bob as ``points`` (2, 2), rod, bob, sleeve and guide as ``lines`` (18, 2, 2) [m].

    The pivot is where the rod meets the guide: of the two places the one nearer to the middle.
    """
    bob = np.asarray(q, dtype=float)
    reach = math.sqrt(max(L**2 - bob[0] ** 2, 0.0))
    pivot = np.array([0.0, min(bob[1] - reach, bob[1] + reach, key=abs)])
    lines = [[[pivot, bob]], circle_lines(bob, 0.04 * L, 12), box_lines(pivot, 0.06 * L, 0.1 * L)]
    guide = [[[0.0, -2 * A - 0.1 * L], [0.0, 2 * A + 0.1 * L]]]
    return {"points": np.array([pivot, bob]), "lines": np.concatenate([*lines, guide])}


def problem(
    *,
    m: float = 1.0,
    L: float = 1.0,
    g: float = 9.81,
    A: float = 0.05,
    w: float = 80.0,
    angle0: float = 0.1,
    t_end: float = 3.0,
) -> Problem:
    """Make the problem: the pendulum near the upright, at rest with its pivot at the top of its stroke, over [0,
    ``t_end``] [s].

    Parameters
    ----------
    m, L
        Mass [kg] and length [m], above 0.
    g
        Gravity [m/s^2].
    A, w
        Amplitude [m] and circular frequency [rad/s] of the pivot, at least 0.
    angle0
        Angle from the upright at the start [rad].
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "L": checked("L", L, above=0.0, unit="m"),
        "g": checked("g", g, unit="m/s^2"),
        "A": checked("A", A, at_least=0.0, unit="m"),
        "w": checked("w", w, at_least=0.0, unit="rad/s"),
    }
    angle0, t_end = checked("angle0", angle0, unit="rad"), checked("t_end", t_end, above=0.0, unit="s")
    published = (*values.values(), angle0) == (1.0, 1.0, 9.81, 0.05, 80.0, 0.1)
    m, L, g, A, w = values.values()
    field = abs(g) + A * w**2  # largest gravity felt at the pivot [m/s^2]
    return Problem(
        name="kapitza_pendulum",
        system=KapitzaPendulum(**values),
        t_span=(0.0, t_end),
        q0=np.array([L * math.sin(angle0), A + L * math.cos(angle0)]),
        v0=np.zeros(2),
        scales=Scales(q=L, v=max(math.sqrt(abs(g) * L) + A * w, 1e-3), lam=max(m * field / L, 1e-3)),
        observables={"angle": functools.partial(angle, A, w)},
        reference=load_reference("kapitza_pendulum", t_end) if published else None,
        sketch=functools.partial(sketch, L, A),
        tags=("holonomic", "rheonomic"),
        good_for="a fast moving constraint: the drive sets the step, and its work must show in the energy",
        source=SOURCE,
    )
