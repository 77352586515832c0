r"""A mass point on a massless rod: the first problem of the IFToMM benchmark library.

Source: IFToMM Library of Computational Benchmark Problems, A01 (simple pendulum); its closed solution is classical, for
instance L. D. Landau, E. M. Lifshitz, Mechanics, section 11::

       o----------O  pivot (0, 0)        q = (x, y): the mass point [m], y upwards
       m    L      .                     M = m,  F = (0, -m g)
                    . angle              0 = x^2 + y^2 - L^2
                     .
                     hanging             lam = S / (2 L),  S: pull of the rod [N]

Let go at ``amplitude`` from hanging (A01: on the left, level with the pivot), with ``k = sin(amplitude / 2)`` and
``w = sqrt(g / L)``:

    sin(angle / 2) = k sn(K(k) - w t),   S = m (L angle'^2 + g cos angle),   period 4 K(k) / w.  SI units.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference, minimal
from problems._pendulum import Bob, angle, quarter, sketch, swinging_point

SOURCE = "IFToMM Library of Computational Benchmark Problems, A01; Landau and Lifshitz, Mechanics, section 11"


class SimplePendulum(Bob):
    """``q = (x, y)``; scalar mass, one position constraint."""

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: length of the rod, (1,) [m^2]."""
        return jnp.stack([q @ q - self.L**2])


def exact(m: float, L: float, g: float, amplitude: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    motion, pull = swinging_point(m, L, g, amplitude, 4 * quarter(amplitude) * math.sqrt(L / g), t)
    return motion._replace(lam=np.array([pull / (2 * L)]))


def problem(
    *, m: float = 1.0, L: float = 1.0, g: float = 9.81, amplitude: float = -math.pi / 2, t_end: float = 10.0
) -> Problem:
    """Make the problem: the pendulum let go at rest, over [0, ``t_end``] [s].

    Parameters
    ----------
    m, L
        Mass [kg] and length [m], above 0.
    g
        Gravity [m/s^2], above 0.
    amplitude
        Angle from hanging at the start [rad], to the right if positive, in [-3.1, 3.1): short of standing upright, where
        the period grows beyond all bounds.
    """
    m, L = checked("m", m, above=0.0, unit="kg"), checked("L", L, above=0.0, unit="m")
    g = checked("g", g, above=0.0, unit="m/s^2")
    amplitude = checked("amplitude", amplitude, at_least=-3.1, below=3.1, unit="rad")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = (m, L, g, amplitude) == (1.0, 1.0, 9.81, -math.pi / 2)
    return Problem(
        name="simple_pendulum",
        system=SimplePendulum(m=jnp.asarray(m), L=jnp.asarray(L), g=jnp.asarray(g)),
        t_span=(0.0, t_end),
        q0=L * np.array([math.sin(amplitude), -math.cos(amplitude)]),
        v0=np.zeros(2),
        scales=Scales(q=L, v=math.sqrt(2 * g * L), lam=m * g / L),
        observables={"angle": angle},
        exact=functools.partial(exact, m, L, g, amplitude),
        reference=load_reference("simple_pendulum", t_end) if published else None,
        sketch=sketch,
        minimal=minimal("hanging_point", m, L, g, amplitude),
        tags=("holonomic",),
        good_for="the smallest holonomic system with a closed solution: orders of all variables, multiplier included",
        source=SOURCE,
    )
