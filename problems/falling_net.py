r"""A square net, pinned at its corners, that falls with a load in it until its cords are tight and hold it.

Source: textbook mechanics (points joined by springs that only pull); numbers and start are the team's own::

       z ^    y                         q = (r_0, r_1, ...): knots, row by row, r = (x, y, z) [m]; n_side in a row
         |  /                           cords between neighbours in a row and in a column,
         | /                            unstretched a = slack span / (n_side - 1)
         | P---o---o---P                P: corners, pinned
         |/   /   /   /                 (L): knot with the load; every other knot has the mass  net / n_side^2
         o---o--(L)--o
        /   /   /   /                   tension of a cord of length l, s = l - a:
       P---o---o---P ---> x             EA / a p(s) + c p'(s) s',   p = (s + sqrt(s^2 + width^2)) / 2

A cord shorter than a by many ``width`` neither pulls nor damps: the stiffness switches on within width.  The start is flat,
with all cords slack, and at rest except for the load, which comes down with ``speed``.
``lam`` (12,) holds the forces of the corners [N].  SI units.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import cables
from hhtbench.mechanics.forces import distances, force_of, power_lost
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "textbook mechanics, points joined by cords that only pull"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


@functools.cache
def pairs(n: int) -> Any:
    """Knots (2, 2 n (n - 1)) that cords join, in a net of n by n."""
    knot = np.arange(n * n).reshape(n, n)
    rows, columns = (np.stack([a.ravel(), b.ravel()]) for a, b in ((knot[:, :-1], knot[:, 1:]), (knot[:-1], knot[1:])))
    return np.concatenate([rows, columns], axis=1)


def loaded(n: int) -> int:
    """Number of the knot with the load; with 6 knots in a row it lies on no line of symmetry."""
    return n * (n // 2) + n // 4


def corners(n: int) -> list[int]:
    """Numbers of the four corners."""
    return [0, n - 1, n * (n - 1), n * n - 1]


class FallingNet(System):
    """``q`` (3 n_side^2,): knots; constant diagonal mass, twelve linear position constraints."""

    EA: Array = parameter(1e5, doc="axial stiffness of a cord [N]")
    damping: Array = parameter(40.0, doc="of a tight cord [N s/m]")
    width: Array = parameter(2e-3, doc="stretch over which a cord gets tight [m]")
    span: Array = parameter(4.0, doc="side of the net [m]")
    slack: Array = parameter(1.1, doc="length of a cord over the distance of its knots at the start [1]")
    net: Array = parameter(2.0, doc="mass of the net [kg]")
    load: Array = parameter(10.0, doc="mass of the load [kg]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    n_side: int = eqx.field(static=True, default=6)

    @property
    def masses(self) -> Array:
        """Masses of the knots (n_side^2,) [kg]."""
        share = np.eye(self.n_side**2)[loaded(self.n_side)]
        return self.net / self.n_side**2 + self.load * share

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (n,) [kg]."""
        return jnp.repeat(self.masses, 3)

    @property
    def free(self) -> Array:
        """Unstretched length of a cord [m]."""
        return self.slack * self.span / (self.n_side - 1)

    def cords(self, q: Array) -> Array:
        """Lengths of the cords (2 n_side (n_side - 1),) [m]."""
        points = q.reshape(-1, 3)
        first, second = pairs(self.n_side)
        return distances(points[first], points[second])

    @property
    def law(self) -> Callable[[Array, Array], Array]:
        """Tension [N] of a cord from its length and rate."""
        return cables.cord(self.EA / self.free, self.damping, self.free, self.width)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and cords, (n,) [N]."""
        weight = jnp.outer(self.masses, jnp.stack([0.0, 0.0, -self.g])).ravel()
        return weight + force_of(self.cords, self.law, q, v)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: corners at their places, (12,) [m]."""
        at = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
        return (q.reshape(-1, 3)[np.array(corners(self.n_side))] - self.span * at).ravel()

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, weight and cords [J]."""
        cords = jnp.sum(cables.cord_energy(self.cords(q), self.EA / self.free, self.free, self.width))
        return jnp.sum(self.mass_matrix * v**2) / 2 + self.g * self.masses @ q[2::3] + cords

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the damping of tight cords [W]."""
        return power_lost(self.cords, self.law, q, v)


def load_position(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position of the load, (3,) [m]."""
    return q.reshape(-1, 3)[loaded(math.isqrt(len(q) // 3))]


def largest_corner_force(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest force of the net on a corner [N]."""
    return float(np.linalg.norm(np.reshape(lam, (4, 3)), axis=1).max())


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: corners and load as ``points`` (5, 3), cords and posts as ``lines`` [m]."""
    knots = np.asarray(q).reshape(-1, 3)
    n = math.isqrt(len(knots))
    ends = knots[corners(n)]
    posts = np.stack([ends, ends - [0.0, 0.0, 0.5 * np.ptp(ends[:, 0])]], axis=1)
    points = np.vstack([ends, knots[loaded(n)]])
    return {"points": points, "lines": np.concatenate([np.swapaxes(knots[pairs(n)], 0, 1), posts])}


def problem(
    *,
    n_side: int = 6,
    EA: float = 1e5,
    damping: float = 40.0,
    width: float = 2e-3,
    span: float = 4.0,
    slack: float = 1.1,
    net: float = 2.0,
    load: float = 10.0,
    speed: float = 3.0,
    g: float = 9.81,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the flat net let go, with a load that falls into it, over [0, ``t_end``] [s].

    Parameters
    ----------
    n_side
        Knots in a row, at least 3.
    EA
        Axial stiffness of a cord [N], above 0.
    damping
        Of a tight cord [N s/m], at least 0.
    width
        Stretch over which a cord gets tight [m], above 0.
    span
        Side of the net [m], above 0.
    slack
        Length of a cord over the distance of its knots at the start [1], at least 1.
    net, load
        Masses [kg], above 0.
    speed
        Of the load at the start [m/s], downwards.
    g
        Gravity [m/s^2], above 0.
    """
    n = positive_integer("n_side", n_side)
    if n < 3:
        raise ProblemError(f"n_side must be at least 3, for a knot to move; got {n}.")
    values: dict[str, Any] = {
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "damping": checked("damping", damping, at_least=0.0, unit="N s/m"),
        "width": checked("width", width, above=0.0, unit="m"),
        "span": checked("span", span, above=0.0, unit="m"),
        "slack": checked("slack", slack, at_least=1.0, unit="1"),
        "net": checked("net", net, above=0.0, unit="kg"),
        "load": checked("load", load, above=0.0, unit="kg"),
        "g": checked("g", g, above=0.0, unit="m/s^2"),
    }
    speed, t_end = checked("speed", speed, unit="m/s"), checked("t_end", t_end, above=0.0, unit="s")
    published = (n, *values.values(), speed) == (6, 1e5, 40.0, 2e-3, 4.0, 1.1, 2.0, 10.0, 9.81, 3.0)
    span, g, total = values["span"], values["g"], values["net"] + values["load"]
    q0, v0 = np.zeros((2, n * n, 3))
    side = np.linspace(0.0, span, n)
    q0[:, 0], q0[:, 1] = np.tile(side, n), np.repeat(side, n)
    v0[loaded(n), 2] = -speed
    fall = math.hypot(math.sqrt(g * span), speed)
    return Problem(
        name="falling_net",
        system=FallingNet(**values, n_side=n),
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=v0.ravel(),
        scales=Scales(q=span, v=fall, lam=total * g),
        observables={"load_position": load_position, "largest_corner_force": largest_corner_force},
        reference=load_reference("falling_net", t_end) if published else None,
        sketch=sketch,
        tags=(
            "holonomic",
            "flexible",
            *(("damped",) if values["damping"] else ()),
            *(("large",) if q0.size >= LARGE else ()),
        ),
        good_for="cords that go slack and tight, each at its own time: stiffness that comes and goes all over a system",
        source=SOURCE,
    )
