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
and mu do not depend on j0, and **lam[0] does**; it depends also on the scale of the norm constraint and on the height, which
here does not change with the length of p.  The reference values belong to this choice and the default
``j0 = (2 A + C) / 3``.  With j0 = 0 M is singular while the KKT matrix stays regular.

Steady motion: precession ``Om`` about z and spin ``w3`` about the axis,

    p = qz(Om t) qy(theta) qz((w3 - Om cos theta) t),
    w3 = (A Om^2 sin cos - m g R cos) / ((C + m R^2) Om sin)   (sin, cos of theta),

the centre on a circle of signed radius ``r = -R w3 / Om`` about (-r, 0), starting at (0, 0, R sin theta).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from jax import Array

from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.multibody.system import Multibody
from hhtbench.mechanics.space import body_rate, rotation
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference
from problems._spatial import with_j0

SOURCE = "Routh, Advanced Rigid Dynamics, 1905; Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988"


def axial_rate(system: Multibody, q: Array, v: Array) -> Array:
    """Rate w3 about the axis [rad/s]."""
    return body_rate(q[3:], v[3:])[2]


def axis_height(system: Multibody, q: Array, v: Array) -> Array:
    """Vertical component of the axis, cos(theta)."""
    return rotation(q[3:])[2, 2]


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
    norm = spin + steady.j0 * ((Om * sin) ** 2 + w3**2) / 2  # p . (equations) / 2
    return Motion(
        q=np.concatenate([centre, p]),
        v=np.concatenate([r * Om * ahead, pdot]),
        lam=np.array([norm, -m * g]),
        mu=m * r * Om**2 * turn[:2],
    )


def mechanism(*, m: float = 1.0, R: float = 0.5, g: float = 9.81, theta: float = math.pi / 3, Om: float = 3.0) -> Mechanism:
    """Make the disk at its start, parameters as in :func:`problem`: body ``disk``, joint ``contact``."""
    made = Mechanism((0.0, 0.0, -g))
    made.invariants |= {"axial_rate": axial_rate, "axis_height": axis_height}
    w3, cos, sin = Steady(m=m, R=R, g=g, theta=theta, Om=Om, j0=0.0).w3, math.cos(theta), math.sin(theta)
    centre, axis, up = (0.0, 0.0, R * sin), np.array([sin, 0.0, cos]), np.array([0.0, 0.0, 1.0])
    made.body(
        "disk",
        m,
        m * R**2 / 4 * np.array([1.0, 1.0, 2.0]),
        centre,
        turned=(math.cos(theta / 2), 0.0, math.sin(theta / 2), 0.0),
        velocity=(0.0, -R * w3, 0.0),
        rate=Om * up + (w3 - Om * cos) * axis,
    )
    made.rolling("contact", "disk", R, centre, axis=axis, point=0 * up, normal=up)
    return made


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
    values: dict[str, float] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "R": checked("R", R, above=0.0, unit="m"),
        "g": checked("g", g, unit="m/s^2"),
        "theta": checked("theta", theta, above=0.0, below=math.pi / 2, unit="rad"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    m, R, *_, Om = values.values()
    j0 = m * R**2 / 3 if j0 is None else checked("j0", j0, at_least=0.0, unit="kg m^2")
    steady = Steady(**values, j0=j0)
    published = steady == Steady(m=1.0, R=0.5, g=9.81, theta=math.pi / 3, Om=3.0, j0=0.25 / 3)
    motion = functools.partial(exact, steady)
    start = motion(0.0)
    rate = max(Om, abs(steady.w3))
    made = mechanism(**values).problem(
        (0.0, t_end),
        name="rolling_disk3d_steady",
        scales=Scales(
            q=np.array([R] * 3 + [1.0] * 4),
            v=np.array([R * rate] * 3 + [rate / 2] * 4),
            lam=np.maximum(np.abs(start.lam), 1e-3),
            mu=max(float(np.abs(start.mu).max()), 1e-3),
        ),
        observables={"centre": centre},
        exact=motion,
        reference=load_reference("rolling_disk3d_steady", t_end) if published else None,
        sketch=functools.partial(sketch, R),
        tags=("mixed", "variable mass", "singular") if j0 == 0 else ("mixed", "variable mass"),
        good_for="Both kinds of constraints at once, with a unit quaternion, a closed solution, and on demand a singular "
        "mass matrix in a regular KKT matrix.",
        source=SOURCE,
    )
    return with_j0(made, j0)
