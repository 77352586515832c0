r"""A pendulum whose period is two seconds exactly: for drift and energy over very many steps.

Source: classical, for instance L. D. Landau, E. M. Lifshitz, Mechanics, section 11 (period by the complete elliptic
integral); let go level with the pivot, gravity chosen to fit::

      pivot (0, 0)  O----------o  m      q = (x, y): the mass point [m], y upwards
                         L               M = m,  F = (0, -m g),  g = 4 K^2 L / s^2
                                         0 = (x^2 + y^2 - L^2) / 2

``K = K(k^2 = 1/2) = 1.854...``, so the period ``4 K sqrt(L / g)`` is 2 s; ``g = 13.750371636040745655 m/s^2`` for L = 1 m.
At every even t the bob is back where it began, at rest, whatever the number of swings: no solution has to be stored to
see the error of a million steps.  ``lam = -3 m g y / L^2``: 0 at the turning points, ``3 m g / L`` at the bottom.  SI units.
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import parameter
from problems._common import checked, load_reference, minimal
from problems._pendulum import Bob, angle, quarter, sketch, swinging_point

SOURCE = "Landau and Lifshitz, Mechanics, section 11, with gravity such that the period is 2 s"
PERIOD = 2.0  #: [s]
AMPLITUDE = math.pi / 2  #: level with the pivot, on the right [rad]
GRAVITY = (4 * quarter(AMPLITUDE) / PERIOD) ** 2  #: for a rod of 1 m [m/s^2]


class TwoSecondPendulum(Bob):
    """``q = (x, y)``; scalar mass, one position constraint."""

    g: Array = parameter(GRAVITY, doc="gravity, in proportion to L [m/s^2]")

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: length of the rod, (1,) [m^2]."""
        return jnp.stack([(q @ q - self.L**2) / 2])


def exact(m: float, L: float, t: float) -> Motion:
    """Closed solution at ``t`` [s]; it keeps its digits over any number of periods."""
    motion, pull = swinging_point(m, L, GRAVITY * L, AMPLITUDE, PERIOD, t)
    return motion._replace(lam=np.array([pull / L]))


def problem(*, m: float = 1.0, L: float = 1.0, t_end: float = 30.0) -> Problem:
    """Make the problem: the pendulum let go level with its pivot, over [0, ``t_end``] [s].

    ``t_end = 20000`` with a step of 0.02 s makes a million steps, a hundred a swing.

    Parameters
    ----------
    m, L
        Mass [kg] and length [m], above 0; gravity is ``13.75... L`` and keeps the period at 2 s.
    """
    m, L = checked("m", m, above=0.0, unit="kg"), checked("L", L, above=0.0, unit="m")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    g = GRAVITY * L
    return Problem(
        name="pendulum_period2",
        system=TwoSecondPendulum(m=jnp.asarray(m), L=jnp.asarray(L), g=jnp.asarray(g)),
        t_span=(0.0, t_end),
        q0=np.array([L, 0.0]),
        v0=np.zeros(2),
        scales=Scales(q=L, v=math.sqrt(2 * g * L), lam=m * g / L),
        observables={"angle": angle},
        exact=functools.partial(exact, m, L),
        reference=load_reference("pendulum_period2", t_end) if (m, L) == (1.0, 1.0) else None,
        sketch=sketch,
        minimal=minimal("hanging_point", m, L, g, math.pi / 2),
        tags=("holonomic",),
        good_for="drift of the constraints and of the energy over a million steps: it is back at its start every 2 s",
        source=SOURCE,
    )
