r"""A homogeneous sphere that rolls on a turning table: its centre runs a circle, whatever the start.

Source: Yu. I. Neimark, N. A. Fufaev, Dynamics of Nonholonomic Systems, American Mathematical Society 1972::

          y |     ___            q = (x, y, p0, p1, p2, p3): centre [m], quaternion, scalar first
            |    /   \           J = 2/5 m R^2, the same about every axis
            |   | .c  |          w = 2 E(p) p', the rate in space
       Om   |    \___/
      /~~>  O--------------> x   0 = p.p - 1                       lam[0]
      table turns about O        0 = x' - R w_y + Om y             mu[0] [N]
                                 0 = y' + R w_x - Om x             mu[1] [N]

As all moments of inertia are J, the rotational energy is ``2 J p'.p'`` on ``p.p = 1``: M = diag(m, m, 4J, 4J, 4J, 4J) is
constant and no force is applied at all.  Only the constraints make the motion,

    x'' = -k y',   y'' = k x',   k = Om J / (J + m R^2) = 2/7 Om,   mu = (k m y', -k m x'),   w_z constant,

with x, y known in closed form and the quaternion not.  The table does work, so the energy is not constant; the power is
``Om (mu[0] y - mu[1] x)``.  With the general ``4 G^T J G + 4 J p p^T`` and its quadratic force, instead of the constant
4 J, the motion and mu are the same and ``lam[0]`` is three times the ``2 J p'.p'`` of here.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.space import norm_rows, quaternion_rate, rotation, space_rate
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Neimark and Fufaev, Dynamics of Nonholonomic Systems, American Mathematical Society 1972"
PUBLISHED = {"m": 2.0, "R": 0.25, "Om": 3.0, "x": 1.0, "y": 0.0, "vx": 0.0, "vy": 0.5, "wz": 1.0}


class RollingSphere(System):
    """``q`` (6,): centre in the plane and unit quaternion; constant mass, no applied force."""

    m: Array = parameter(2.0, doc="mass [kg]")
    R: Array = parameter(0.25, doc="radius [m]")
    Om: Array = parameter(3.0, doc="turning rate of the table [rad/s]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (6,): m twice [kg], 4 J four times [kg m^2]."""
        return self.m * jnp.concatenate([jnp.ones(2), jnp.full(4, 1.6) * self.R**2])

    @property
    def circling_rate(self) -> Array:
        """Angular velocity ``k`` of the centre on its circle [rad/s]."""
        return 2 * self.Om / 7

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: zero, (6,)."""
        return jnp.zeros(6)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norm of the quaternion, (1,)."""
        return norm_rows(q[2:])[None]

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: velocity of the point of contact over the table, (2,) [m/s]."""
        w = space_rate(q[2:], v[2:])
        return jnp.stack([v[0] - self.R * w[1] + self.Om * q[1], v[1] + self.R * w[0] - self.Om * q[0]])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the turning table [W]."""
        return self.Om * (mu[0] * q[1] - mu[1] * q[0])

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: spin about the vertical [rad/s] and, times k, the centre of the circle [m/s]."""
        k = self.circling_rate
        return {"spin": space_rate(q[2:], v[2:])[2], "circle_x": k * q[0] - v[1], "circle_y": k * q[1] + v[0]}


def centre(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of the sphere (2,) [m]."""
    return np.asarray(q[:2])


def sketch(R: float, table: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: axis of the table and centre as ``points`` (2, 3); rim of the table, three great circles of the
    sphere that turn with
    it and its radius to a mark as ``lines`` (121, 2, 3) [m].
    """
    frame, middle = np.asarray(rotation(q[2:])).T, np.array([q[0], q[1], R])
    angles = np.linspace(0.0, 2 * math.pi, 31)
    cos, sin = np.cos(angles), np.sin(angles)
    circles = [middle + R * (np.outer(cos, frame[i]) + np.outer(sin, frame[i - 1])) for i in range(3)]
    circles.append(table * np.stack([cos, sin, 0 * sin], axis=1))
    pieces = [np.stack([c[:-1], c[1:]], axis=1) for c in circles]
    return {"points": np.array([np.zeros(3), middle]), "lines": np.concatenate([*pieces, [[middle, middle + R * frame[0]]]])}


def problem(
    *,
    m: float = 2.0,
    R: float = 0.25,
    Om: float = 3.0,
    x: float = 1.0,
    y: float = 0.0,
    vx: float = 0.0,
    vy: float = 0.5,
    wz: float = 1.0,
    t_end: float = 10.0,
) -> Problem:
    """Make the problem: the rolling sphere over [0, ``t_end``] [s].

    Parameters
    ----------
    m, R
        Mass [kg] and radius [m], above 0.
    Om
        Turning rate of the table [rad/s].
    x, y, vx, vy
        Centre [m] and its velocity [m/s] at the start.
    wz
        Rate of the sphere about the vertical [rad/s]; the level rates follow from rolling.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "R": checked("R", R, above=0.0, unit="m"),
        "Om": checked("Om", Om, unit="rad/s"),
    }
    units = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "wz": "rad/s"}
    start = {key: checked(key, value, unit=units[key]) for key, value in zip(units, (x, y, vx, vy, wz), strict=True)}
    x, y, vx, vy, wz = start.values()
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = {**values, **start} == PUBLISHED
    R, Om, identity = values["R"], values["Om"], np.array([1.0, 0.0, 0.0, 0.0])
    level = [(Om * x - vy) / R, (vx + Om * y) / R]  # w_x and w_y of rolling
    k, speed = 2 * Om / 7, math.hypot(vx, vy)
    farthest = math.hypot(x - vy / k, y + vx / k) + speed / abs(k) if k else math.hypot(x, y) + speed * t_end
    reach = math.hypot(x, y) + min(2 * speed / max(abs(k), 1e-9), speed * t_end)  # at most a diameter of the circle
    rate = max(math.hypot(*level), abs(wz), 0.1)
    return Problem(
        name="rolling_sphere_table",
        system=RollingSphere(**values),
        t_span=(0.0, t_end),
        q0=np.concatenate([[x, y], identity]),
        v0=np.concatenate([[vx, vy], quaternion_rate(identity, [*level, wz])]),
        scales=Scales(
            q=np.array([max(reach, R)] * 2 + [1.0] * 4),
            v=np.array([max(speed, R * 0.1)] * 2 + [rate / 2] * 4),
            lam=0.2 * values["m"] * R**2 * rate**2,
            mu=values["m"] * max(abs(k) * speed, R * 0.01),
        ),
        observables={"centre": centre},
        reference=load_reference("rolling_sphere_table", t_end) if published else None,
        sketch=functools.partial(sketch, R, 1.1 * farthest + R),
        tags=("mixed",),
        good_for="Nonholonomic rolling that is not at rest in its constraint (it depends on the place): the table feeds and "
        "takes energy, while the path is a circle known in closed form.",
        source=SOURCE,
    )
