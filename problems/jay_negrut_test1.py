"""First test problem of Jay and Negrut: a reaction that is nonlinear in its multiplier.

Source: L. O. Jay, D. Negrut, "Extensions of the HHT-alpha method to differential-algebraic equations in mechanics",
ETNA 26 (2007) 190-208, section 5, first problem.

No mechanism belongs to it; the point (y1, y2) runs along the curve ``y1^2 y2 = 1``::

    y2 |*                     y1' = z1,  y2' = z2
     1 | *  start (1, 1)      z1' = y1 z2 + 2 y2 z1 + e^-t y1 lam
       |   *                  z2' = -y1 y2 z1 - 2 y1 z1 y2 z2 + y2 lam^2
       |       *   *          0 = y1^2 y2 - 1,   0 = 2 y1 y2 z1 + y1^2 z2
       +------------*--- y1

With ``M = I`` the force is the part free of lam and the reaction is ``Q = (e^-t y1 lam, y2 lam^2)``.  This is not
``-g_q^T lam``, so it is declared.  Exact: ``y = (e^t, e^-2t), z = (e^t, -2 e^-2t), lam = e^t``.

Which reading.  In the available print of the paper minus signs and exponents of the two right-hand sides are lost.
The equations above are the reading that the exact solution satisfies identically,

    z1':  -2 e^-t + 2 e^-t + e^t = e^t,      z2':  -1 + 4 e^-2t + 1 = 4 e^-2t,

and with which the method shows the orders the paper reports.

Which root.  Along the solution ``g_q Q_lam = 2 e^-t + 2 lam = 4 cosh t`` is regular, but the acceleration level
is quadratic in lam and has a second root ``-e^t - 2 e^-t`` (-3 at the start).  ``lam_guess = 1`` picks the right one.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, circle_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System
from problems._common import checked, load_reference

SOURCE = "Jay and Negrut, ETNA 26 (2007) 190-208, section 5, first problem"


class NonlinearReaction(System):
    """``q = (y1, y2)``, unit mass, one position constraint, a reaction quadratic in lam; no parameters."""

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: the part of (z1', z2') free of lam, (2,)."""
        (y1, y2), (z1, z2) = q, v
        return jnp.stack([y1 * z2 + 2 * y2 * z1, -y1 * y2 * z1 - 2 * y1 * z1 * y2 * z2])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: ``y1^2 y2 - 1``, (1,)."""
        y1, y2 = q
        return jnp.stack([y1**2 * y2 - 1])

    def reaction(self, t: Array, q: Array, lam: Array) -> Array:
        """``(e^-t y1 lam, y2 lam^2)``, (2,)."""
        y1, y2 = q
        return jnp.stack([jnp.exp(-t) * y1 * lam[0], y2 * lam[0] ** 2])


def exact(t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    up, down = np.exp(t), np.exp(-2 * t)
    return Motion(q=np.array([up, down]), v=np.array([up, -2 * down]), lam=np.array([up]), mu=np.zeros(0))


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: the point on its curve: ``points`` (1, 2), ``lines`` (60, 2, 2) chords of the curve and a ring
    around the point.
    """
    y1 = np.linspace(0.8, 3.0, 45)
    curve = np.column_stack([y1, y1**-2])
    return {"points": np.array([q]), "lines": np.concatenate([chain(curve), circle_lines(q, 0.05)])}


def multiplier(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """The multiplier lam, in which the reaction is nonlinear."""
    return float(lam[0])


def problem(*, t_end: float = 1.0) -> Problem:
    """Make the problem: the problem over [0, ``t_end``] [s]; the paper measures errors at 1."""
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    start = exact(0.0)
    return Problem(
        name="jay_negrut_test1",
        system=NonlinearReaction(),
        t_span=(0.0, t_end),
        q0=start.q,
        v0=start.v,
        lam_guess=np.array([1.0]),
        scales=Scales(q=1.0, v=1.0, lam=1.0),
        observables={"multiplier": multiplier},
        exact=exact,
        reference=load_reference("jay_negrut_test1", t_end),
        sketch=sketch,
        tags=("holonomic", "nonlinear reaction"),
        good_for="orders of convergence where the reaction is nonlinear in its multiplier and not `-G^T lam`; the "
        "multiplier has a second root",
        source=SOURCE,
    )
