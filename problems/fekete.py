r"""Points that repel one another on the unit sphere and come to rest, far apart, by friction (elliptic Fekete points).

Source: Fekete problem of the Test Set for IVP Solvers (F. Mazzia, F. Iavernaro, C. Magherini, Bari)::

          . - o - .           q = (p_1, ..., p_N) (3N,): places in space [m], unit masses [kg]
        o     |     o
       /   o  |      \        p_i'' = sum_(j != i) (p_i - p_j) / |p_i - p_j|^2 - damping p_i' + 2 lam_i p_i
      |  o----+--- o  |
       \      |  o   /        0 = g_i = 1 - |p_i|^2
        o     |     o
          ' - o - '           energy = sum |p_i'|^2 / 2 - sum_(i < j) log |p_i - p_j|

The source adds ``2 lam_i p_i``, the sign of g above turns it into the default reaction.  Every pair pushes p_i outwards
with ``p_i . (p_i - p_j) / |p_i - p_j|^2 = 1/2``, so along any motion on the sphere, whatever the other points do,

    lam_i = -((N - 1) / 2 + |p_i'|^2) / 2.

Start at rest.  N = 20: the source's rings of 3, 7, 6 and 4 points.  Other N: a golden-angle spiral, point i = 0..N-1 at
height ``1 - (2 i + 1) / N`` and azimuth ``pi (3 - sqrt 5) i``.  SI units (of repulsion 1 N m); lam [N/m].
"""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Test Set for IVP Solvers, Fekete problem"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here

#: count, offset of azimuth [rad], latitude [rad], first index (the source numbers the last ring from 0)
RINGS = (
    (3, math.pi / 13, 3 * math.pi / 8, 1),
    (7, math.pi / 29, math.pi / 8, 1),
    (6, math.pi / 7, -2 * math.pi / 15, 1),
    (4, math.pi / 17, -3 * math.pi / 10, 0),
)


class RepellingPoints(System):
    """``q`` (3N,): points one after another; unit masses, one constraint a point."""

    damping: Array = parameter(0.5, doc="friction on each point [N s/m]")

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: repulsion and friction, (3N,) [N]."""
        apart, squares = differences(q)
        return jnp.sum(apart / squares[:, :, None], axis=1).ravel() - self.damping * v

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: every point on the sphere, (N,) [m^2]."""
        return 1 - jnp.sum(q.reshape(-1, 3) ** 2, axis=1)

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and repulsion [J]; every pair stands twice among the squares."""
        return v @ v / 2 - jnp.sum(jnp.log(differences(q)[1])) / 4

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the friction [W]."""
        return -self.damping * (v @ v)


def differences(q: Array) -> tuple[Array, Array]:
    """``p_i - p_j`` (N, N, 3) [m] and its square (N, N) [m^2], with ones on the diagonal: a point does not push itself."""
    p = q.reshape(-1, 3)
    apart = p[:, None] - p[None]
    return apart, jnp.sum(apart**2, axis=2) + jnp.eye(p.shape[0])


def closed_multipliers(v: Vector) -> Vector:
    """Multipliers lam (N,) [N/m] in closed form from the velocities ``v`` (3N,) of any motion on the sphere."""
    rates = np.asarray(v).reshape(-1, 3)
    return -((len(rates) - 1) / 2 + np.sum(rates**2, axis=1)) / 2


def multiplier_error(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest difference of ``lam`` from its closed form [N/m]; 0 on the exact motion."""
    return float(np.abs(np.asarray(lam) - closed_multipliers(v)).max())


def rings() -> Vector:
    """Starting positions of the source's 20 points, (20, 3) [m]."""
    azimuth = np.concatenate([2 * math.pi * np.arange(i, i + n) / n + offset for n, offset, _, i in RINGS])
    latitude = np.concatenate([np.full(n, angle) for n, _, angle, _ in RINGS])
    return np.column_stack([np.cos(azimuth) * np.cos(latitude), np.sin(azimuth) * np.cos(latitude), np.sin(latitude)])


def spiral(n: int) -> Vector:
    """Positions of ``n`` points on a golden-angle spiral from pole to pole, (n, 3) [m]."""
    i = np.arange(n)
    height, azimuth = 1 - (2 * i + 1) / n, math.pi * (3 - math.sqrt(5)) * i
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


@functools.cache
def sphere() -> Vector:
    """Line pieces (72, 2, 3) [m] of the equator and two meridians, made once."""
    angle = np.linspace(0.0, 2 * math.pi, 25)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(25)])
    circles = [np.roll(circle, shift, axis=1) for shift in range(3)]
    return np.concatenate([np.stack([c[:-1], c[1:]], axis=1) for c in circles])


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: the points (N, 3) and three great circles of the sphere as ``lines`` (72, 2, 3) [m]."""
    return {"points": np.array(q).reshape(-1, 3), "lines": sphere().copy()}


def problem(*, n_points: int = 20, damping: float = 0.5, t_end: float = 1000.0) -> Problem:
    """Make the problem: the points from rest over [0, ``t_end``] [s]; the source's interval is long enough for them to
    rest again.

    Parameters
    ----------
    n_points
        N, at least 2.
    damping
        Friction on each point [N s/m], at least 0.
    """
    n = positive_integer("n_points", n_points)
    if n < 2:
        raise ProblemError(f"n_points must be at least 2, for points to repel one another; got {n}.")
    damping, t_end = checked("damping", damping, at_least=0.0, unit="N s/m"), checked("t_end", t_end, above=0.0, unit="s")
    published = (n, damping) == (20, 0.5)
    tags = ("holonomic", *(("damped",) if damping else ()), *(("large",) if 3 * n >= LARGE else ()))
    return Problem(
        name="fekete",
        system=RepellingPoints(damping=jnp.asarray(damping)),
        t_span=(0.0, t_end),
        q0=(rings() if n == 20 else spiral(n)).ravel(),
        v0=np.zeros(3 * n),
        scales=Scales(q=1.0, v=0.1, lam=(n - 1) / 4),
        observables={"multiplier_error": multiplier_error},
        reference=load_reference("fekete", t_end) if published else None,
        sketch=sketch,
        tags=tags,
        good_for="many constraints in a system of any size, all multipliers known in closed form along the whole motion",
        source=SOURCE,
    )
