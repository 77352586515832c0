r"""A thin disk rolling steadily on a table with its axis at a constant inclination: both kinds of constraints at once.

Source: E. J. Routh, Advanced Rigid Dynamics, Macmillan 1905 (steady motion of a rolling disk); unit quaternions
as in P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall 1988.  Equations derived below::

         z |     a  axis, theta from z       q = (x, y, z, p0, p1, p2, p3): centre [m], quaternion, scalar first
           |   /                             a = third column of the rotation matrix R(p)
           |  /  \                           J = diag(A, A, C) = m R^2 / 4 diag(1, 1, 2)
           | /    \  disk, radius R          position constraints:
       ____c_______\________ table             0 = p.p - 1                            lam[0]
          / \                                  0 = z - R sin(theta), a_z = cos(theta) lam[1] [N]
    contact                                  velocity constraints, rolling without slip:
                                               0 = (x' + omega x rho)_x,  (...)_y     mu [N]

With ``a_z = p0^2 - p1^2 - p2^2 + p3^2`` and ``sin(theta) = sqrt(1 - a_z^2)`` the contact lies at
``rho = -R (e_z - a_z a) / sin(theta)`` from the centre.

Mass ``4 G^T J G + 4 j0 p p^T`` and force of the quaternion as in ``hhtbench/mechanics/space.py``.  The motion, lam[1]
and mu do not depend on j0, and **lam[0] does**; it depends also on the scale of the norm constraint and on writing the
height homogeneous in p.  The reference values belong to this choice and the default ``j0 = (2 A + C) / 3``.  With
j0 = 0 M is singular while the KKT matrix stays regular.

Steady motion: precession ``Om`` about z and spin ``w3`` about the axis,

    p = qz(Om t) qy(theta) qz((w3 - Om cos theta) t),
    w3 = (A Om^2 sin cos - m g R cos) / ((C + m R^2) Om sin)   (sin, cos of theta),

the centre on a circle of signed radius ``r = -R w3 / Om`` about (-r, 0), starting at (0, 0, R sin theta).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.space import body_rate, norm_rows, rotation, rotational_force, rotational_mass, velocity_at
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Motion, Problem, Scales, System, parameter
from problems._common import checked, load_reference

SOURCE = "Routh, Advanced Rigid Dynamics, 1905; Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988"


class RollingDisk(System):
    """``q`` (7,): centre and unit quaternion; mass matrix varies with p, two constraints of each kind."""

    m: Array = parameter(1.0, doc="mass [kg]")
    R: Array = parameter(0.5, doc="radius [m]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    j0: Array = parameter(0.25 / 3, doc="inertia along p that makes M regular; the motion does not depend on it [kg m^2]")

    @property
    def inertia(self) -> Array:
        """Diagonal (3,) of the thin disk's inertia in its own frame [kg m^2]."""
        return self.m * self.R**2 / 4 * jnp.array([1.0, 1.0, 2.0])

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (7, 7): ``m`` three times and the block of the quaternion."""
        block = rotational_mass(q[3:], self.inertia, self.j0)
        return jnp.zeros((7, 7)).at[:3, :3].set(self.m * jnp.eye(3)).at[3:, 3:].set(block)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and the terms quadratic in p', (7,)."""
        weight = jnp.zeros(3).at[2].set(-self.m * self.g)
        return jnp.concatenate([weight, rotational_force(q[3:], v[3:], self.inertia)])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norm of the quaternion and height of the centre, (2,) [1, m]."""
        return jnp.stack([norm_rows(q[3:]), q[2] - self.R * jnp.sqrt(1 - rotation(q[3:])[2, 2] ** 2)])

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: horizontal velocity of the point of contact, (2,) [m/s]."""
        a = rotation(q[3:])[:, 2]
        rho = -self.R * (jnp.array([0.0, 0.0, 1.0]) - a[2] * a) / jnp.sqrt(1 - a[2] ** 2)
        return velocity_at(q, v, [0], rho[None])[0, :2]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]; j0 does not contribute."""
        w = body_rate(q[3:], v[3:])
        return (self.m * v[:3] @ v[:3] + w @ (self.inertia * w)) / 2 + self.m * self.g * q[2]

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: axial rate w3 and inclination: constant in the steady motion."""
        return {"axial_rate": body_rate(q[3:], v[3:])[2], "axis_height": rotation(q[3:])[2, 2]}


@dataclass(frozen=True)
class Steady:
    """Parameters of one steady motion."""

    m: float  #: [kg]
    R: float  #: [m]
    g: float  #: [m/s^2]
    theta: float  #: axis from the vertical [rad]
    Om: float  #: precession [rad/s]
    j0: float  #: [kg m^2]

    @property
    def w3(self) -> float:
        """Angular velocity about the disk's axis [rad/s] for which the weight's moment holds the inclination."""
        A, C, sin, cos = self.m * self.R**2 / 4, self.m * self.R**2 / 2, math.sin(self.theta), math.cos(self.theta)
        return (A * self.Om**2 * sin * cos - self.m * self.g * self.R * cos) / ((C + self.m * self.R**2) * self.Om * sin)


def exact(steady: Steady, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    m, R, g, Om, w3 = steady.m, steady.R, steady.g, steady.Om, steady.w3
    sin, cos = math.sin(steady.theta), math.cos(steady.theta)
    r, w = -R * w3 / Om, w3 - Om * cos
    turn = np.array([math.cos(Om * t), math.sin(Om * t), 0.0])
    ahead = np.array([-turn[1], turn[0], 0.0])
    # qz(a) qy(theta) qz(b) written out: half sum and half difference of a and b
    half = np.array([(Om + w) * t / 2, (w - Om) * t / 2])
    sizes, rates = np.array([math.cos(steady.theta / 2), math.sin(steady.theta / 2)]), np.array([Om + w, w - Om]) / 2
    (c0, c1), (s0, s1) = sizes * np.cos(half), sizes * np.sin(half)
    p = np.array([c0, s1, c1, s0])
    pdot = np.array([-s0 * rates[0], c1 * rates[1], -s1 * rates[1], c0 * rates[0]])
    centre = np.array([-r, 0.0, R * sin]) + r * turn
    spin = m * R**2 / 4 * ((Om * sin) ** 2 + 2 * w3**2)  # w^T J w
    norm = spin + steady.j0 * ((Om * sin) ** 2 + w3**2) / 2 + m * g * R * cos**2 / sin  # p . (equations) / 2
    return Motion(
        q=np.concatenate([centre, p]),
        v=np.concatenate([r * Om * ahead, pdot]),
        lam=np.array([norm, -m * g]),
        mu=m * r * Om**2 * turn[:2],
    )


def sketch(R: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: centre and tip of the axis as ``points`` (2, 3), axis and rim as ``lines`` (25, 2, 3) [m]."""
    first, second, a = np.asarray(rotation(q[3:])).T
    angles = np.linspace(0.0, 2 * math.pi, 25)
    rim = q[:3] + R * (np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second))
    tip = q[:3] + R * a
    lines = np.concatenate([[[q[:3], tip]], np.stack([rim[:-1], rim[1:]], axis=1)])
    return {"points": np.array([q[:3], tip]), "lines": lines}


def centre(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of the disk, (3,) [m]."""
    return np.array(q[:3])


def problem(
    *,
    m: float = 1.0,
    R: float = 0.5,
    g: float = 9.81,
    theta: float = math.pi / 3,
    Om: float = 3.0,
    j0: float | None = None,
    t_end: float = 5.0,
) -> Problem:
    """Make the problem: the disk in steady motion over [0, ``t_end``] [s].

    Parameters
    ----------
    m, R
        Mass [kg] and radius [m], above 0.
    g
        Gravity [m/s^2].
    theta
        Inclination of the axis from the vertical [rad], in (0, pi/2).
    Om
        Precession [rad/s], above 0; the axial spin that belongs to it is computed.
    j0
        Inertia along the quaternion [kg m^2], at least 0; None takes the mean ``(2 A + C) / 3`` of the disk.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "R": checked("R", R, above=0.0, unit="m"),
        "g": checked("g", g, unit="m/s^2"),
    }
    mean = values["m"] * values["R"] ** 2 / 3
    values["j0"] = mean if j0 is None else checked("j0", j0, at_least=0.0, unit="kg m^2")
    theta = checked("theta", theta, above=0.0, below=math.pi / 2, unit="rad")
    Om, t_end = checked("Om", Om, above=0.0, unit="rad/s"), checked("t_end", t_end, above=0.0, unit="s")
    steady = Steady(**values, theta=theta, Om=Om)
    published = steady == Steady(m=1.0, R=0.5, g=9.81, theta=math.pi / 3, Om=3.0, j0=0.25 / 3)
    motion = functools.partial(exact, steady)
    start = motion(0.0)
    rate = max(Om, abs(steady.w3))
    return Problem(
        name="rolling_disk3d_steady",
        system=RollingDisk(**values),
        t_span=(0.0, t_end),
        q0=start.q,
        v0=start.v,
        scales=Scales(
            q=np.array([values["R"]] * 3 + [1.0] * 4),
            v=np.array([values["R"] * rate] * 3 + [rate / 2] * 4),
            lam=np.maximum(np.abs(start.lam), 1e-3),
            mu=max(float(np.abs(start.mu).max()), 1e-3),
        ),
        observables={"centre": centre},
        exact=motion,
        reference=load_reference("rolling_disk3d_steady", t_end) if published else None,
        sketch=functools.partial(sketch, values["R"]),
        tags=("mixed", "variable mass", "singular") if values["j0"] == 0 else ("mixed", "variable mass"),
        good_for="Both kinds of constraints at once, with a unit quaternion, a closed solution, and on demand a singular "
        "mass matrix in a regular KKT matrix.",
        source=SOURCE,
    )
