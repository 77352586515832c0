r"""A flyball governor: two arms with balls on a turning shaft, held by stiff springs and dampers from a sliding mass.

Source: IFToMM library of computational benchmark problems for multibody dynamics, A05 (flyball governor)::

                  | z
          hinge o-+-o (d, 0, H)          q: centre [m] and unit quaternion, scalar first, of
              ,'  |  `.                     shaft, slider, arm 1, arm 2: 4 x 7
            ,' \  |  / `.  arm, alpha    arm: rod of length l, ball at its end, hinge across the shaft;
          ,'    K,C     `.   below level    alpha is its angle below the level
        (O)     \ | /     (O) ball       spring K and damper C, side by side, from the slider (d, 0, s)
                [ | ] slider, height s      to the middle of the arm: F = K (L - l0) + C L'
                [_|_]
                  |                      the shaft turns freely about z, the slider turns with it
                __|__ ground

4 degrees of freedom (s, two arm angles, shaft angle), 24 independent position constraints in this order: four norms
``p.p - 1``; for shaft in ground, arm 1 and arm 2 on the shaft the common points (9 rows [m]) and the axes (6 rows); for the
slider its place across the shaft (2 rows [m]) and its frame, that of the shaft (3 rows).

The source gives shaft and arms 1 x 0.01 x 0.01 m, a slider of side 0.1 m, density 3000 kg/m^3 and balls of 5 kg as points.
At the start the springs are free, and the eigenvalues of the motion (1/s) are -8117 and -1450 of the dampers against slider
and arms, -20.3 and -20.1 (near -K/C) of springs that relax against their dampers, and +-7.35i of the swing of arms and
slider together, which the shaft answers with its turning rate.  The dampers take energy; the moment of momentum about z is
constant.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.space import (
    energy_of_bodies,
    force_on_bodies,
    mass_of_bodies,
    moment_of_momentum,
    norm_rows,
    placed_with_ground,
    points_on,
    quaternion_rate,
    revolute_rows,
    rotation,
    space_rate,
    split,
)
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "IFToMM library of computational benchmark problems, A05"
PUBLISHED = (8e5, 4e4, 0.5, 5.0, 9.81, 0.5, math.pi / 6, 2 * math.pi)
HEIGHT, OFFSET, SIDE, SECTION, DENSITY = 1.0, 0.05, 0.1, 0.01, 3000.0  #: H, d, slider, shaft and arms [m]; [kg/m^3]
X, Y, Z = np.eye(3)
SHAFT, SLIDER, ARMS, GROUND = 0, 1, np.array([2, 3]), 4
FIRST, SECOND = np.array([GROUND, SHAFT, SHAFT]), np.array([SHAFT, 2, 3])  #: bodies of the three hinges
AXIS = np.stack([Z, Y, Y])  #: in the second body (3, 3); arm 2 has turned by pi about z
ACROSS = np.array([[X, Y], [X, Z], [X, Z]])  #: in the first body (3, 2, 3)
SIDES = np.stack([X, -X])  #: of the shaft on which arm 1 and arm 2 hang (2, 3)


class FlyballGovernor(System):
    """``q`` (28,): shaft, slider, two arms with their balls."""

    m: Array = parameter(doc="masses (4,) [kg]")
    J: Array = parameter(doc="principal moments (4, 3) about the centres of mass [kg m^2]")
    j0: Array = parameter(doc="inertia along each quaternion (4,); the motion does not depend on it [kg m^2]")
    centre: Array = parameter(doc="hinge to centre of mass of an arm with its ball [m]")
    K: Array = parameter(8e5, doc="stiffness of a spring [N/m]")
    C: Array = parameter(4e4, doc="damping of a damper [N s/m]")
    l0: Array = parameter(0.5, doc="free length of a spring [m]")
    g: Array = parameter(9.81, doc="gravity, along -z [m/s^2]")

    @property
    def gravity(self) -> Array:
        """Gravity vector (3,) [m/s^2]."""
        return -self.g * jnp.asarray(Z)

    def spring_lengths(self, q: Array) -> Array:
        """Lengths of both springs (2,) [m]."""
        at = placed_with_ground(q)
        arms = points_on(at, ARMS, jnp.tile((HEIGHT / 2 - self.centre) * X, (2, 1)))
        span = arms - points_on(at, np.array([SLIDER, SLIDER]), OFFSET * SIDES)
        return jnp.sqrt(jnp.sum(span**2, axis=1))

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (28, 28), a block for each body."""
        return mass_of_bodies(q, self.m, self.J, self.j0)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, the terms quadratic in p', springs and dampers, (28,)."""
        length, rate = jax.jvp(self.spring_lengths, (q,), (v,))
        (along,) = jax.vjp(self.spring_lengths, q)[1](self.K * (length - self.l0) + self.C * rate)
        return force_on_bodies(q, v, self.m, self.J, self.gravity) - along

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norms, three hinges and the slider, (24,)."""
        at = placed_with_ground(q)
        a = np.concatenate([[0 * X], HEIGHT / 2 * Z + OFFSET * SIDES])
        b = jnp.concatenate([-HEIGHT / 2 * Z[None], jnp.tile(-self.centre * X, (2, 1))])
        across = (at.x[SLIDER] - at.x[SHAFT]) @ at.R[SHAFT][:, :2]
        frame = (at.R[SHAFT].T @ at.R[SLIDER])[np.array([0, 0, 1]), np.array([1, 2, 2])]
        hinges = revolute_rows(at, FIRST, SECOND, a, b, ACROSS, AXIS)
        return jnp.concatenate([norm_rows(split(q)[1]), hinges, across, frame])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic, gravitational and spring energys [J]."""
        stretch = self.spring_lengths(q) - self.l0
        return energy_of_bodies(q, v, self.m, self.J, self.gravity) + self.K * stretch @ stretch / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the dampers [W]."""
        rate = jax.jvp(self.spring_lengths, (q,), (v,))[1]
        return -self.C * rate @ rate

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: angular momentum about the shaft [kg m^2/s]."""
        return {"vertical_momentum": moment_of_momentum(q, v, self.m, self.J)[2]}


def bodies(ball: float) -> dict[str, Any]:
    """Masses, moments of inertia and centre of mass from the source's dimensions; ``ball`` is a ball's mass [kg]."""
    rod, slider = DENSITY * HEIGHT * SECTION**2, DENSITY * SIDE**3
    thin, slender = rod * SECTION**2 / 6, rod * (HEIGHT**2 + SECTION**2) / 12
    centre = (rod / 2 + ball) * HEIGHT / (rod + ball)
    arm = slender + rod * (centre - HEIGHT / 2) ** 2 + ball * (HEIGHT - centre) ** 2
    J = np.array([[slender, slender, thin], [slider * SIDE**2 / 6] * 3, [thin, arm, arm], [thin, arm, arm]])
    return {"m": np.array([rod, slider, rod + ball, rod + ball]), "J": J, "j0": J.mean(axis=1), "centre": centre}


def start(centre: float, s: float, alpha: float, omega: float) -> tuple[Vector, Vector]:
    """State at the start: all bodies rotate with ``omega`` [rad/s] about z, slider at ``s`` [m], arms at ``alpha`` [rad]."""
    reach, drop = OFFSET + centre * math.cos(alpha), HEIGHT - centre * math.sin(alpha)
    x = np.array([[0, 0, HEIGHT / 2], [0, 0, s], [reach, 0, drop], [-reach, 0, drop]])
    cos, sin = math.cos(alpha / 2), math.sin(alpha / 2)
    p = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [cos, 0, sin, 0], [0, -sin, 0, cos]])  # arm 2: half a turn, then the tilt
    pdot = quaternion_rate(p, np.tile([0.0, 0.0, omega], (4, 1)))
    return np.concatenate([x, p], axis=1).ravel(), np.concatenate([omega * np.cross(Z, x), pdot], axis=1).ravel()


def typical_sizes(mass: float, rate: float) -> Scales:
    """Scales from the total mass [kg] and the fastest rotation [rad/s]; multipliers in the order of the constraints."""
    force = mass * HEIGHT * rate**2
    moment = force * HEIGHT
    return Scales(
        q=np.tile([HEIGHT] * 3 + [1.0] * 4, 4),
        v=np.tile([HEIGHT * rate] * 3 + [rate / 2] * 4, 4),
        lam=np.array([moment] * 4 + [force] * 9 + [moment] * 6 + [force] * 2 + [moment] * 3),
    )


def slider_height(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Height s of the slider on the shaft [m]."""
    return float(q[9])


def arm_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle alpha of arm 1 below the horizontal [rad]."""
    x, y, z = np.asarray(rotation(q[17:21]))[:, 0]
    return math.atan2(-z, math.hypot(x, y))


def shaft_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle of the shaft [rad] modulo whole turns, in [-pi, pi]."""
    return math.remainder(2 * math.atan2(q[6], q[3]), 2 * math.pi)


def shaft_rate(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angular velocity omega of the shaft [rad/s]."""
    return float(space_rate(q[3:7], v[3:7])[2])


def sketch(centre: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot, hinges and balls as ``points`` (5, 3); shaft, hinge bar, arms, slider, springs as ``lines``
    (36, 2, 3) [m].
    """
    x, p = map(np.asarray, split(q))
    R = np.asarray(rotation(p))
    top, foot = x[0] + HEIGHT / 2 * R[0, :, 2], x[0] - HEIGHT / 2 * R[0, :, 2]
    hinges, balls, middles = (x[2:] + (part - centre) * R[2:, :, 0] for part in (0.0, HEIGHT, HEIGHT / 2))
    ring = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
    lid, floor = (x[1] + SIDE / 2 * np.column_stack([ring, np.full(5, side)]) @ R[1].T for side in (1, -1))
    box = [np.stack(pair, axis=1) for pair in ((lid[:-1], lid[1:]), (floor[:-1], floor[1:]), (lid[:-1], floor[:-1]))]
    share = np.linspace(0.0, 1.0, 11)[:, None]
    zigzag = 0.03 * np.concatenate([[0], np.tile([1, -1], 4), [1, 0]])[:, None]
    springs = []
    for begin, end in zip(x[1] + OFFSET * SIDES @ R[1].T, middles, strict=True):
        across = np.cross(end - begin, R[0, :, 1])
        coil = begin + share * (end - begin) + zigzag * across / np.linalg.norm(across)
        springs.append(np.stack([coil[:-1], coil[1:]], axis=1))
    bars = [(foot, top), hinges, (hinges[0], balls[0]), (hinges[1], balls[1])]
    return {"points": np.array([foot, *hinges, *balls]), "lines": np.concatenate([bars, *box, *springs])}


def problem(
    *,
    K: float = 8e5,
    C: float = 4e4,
    l0: float = 0.5,
    ball: float = 5.0,
    g: float = 9.81,
    s: float = 0.5,
    alpha: float = math.pi / 6,
    omega: float = 2 * math.pi,
    t_end: float = 10.0,
) -> Problem:
    """Make the problem: the governor over [0, ``t_end``] [s], turning at the start while slider and arms rest on the shaft.

    Parameters
    ----------
    K, C, l0
        Stiffness [N/m], damping [N s/m] and free length [m] of the springs, at least 0.
    ball
        Mass at the end of an arm [kg], at least 0.
    g
        Gravity [m/s^2].
    s, alpha, omega
        Height of the slider [m] on the shaft, in (0, 1), angle of the arms below the level [rad], in
        (-pi/2, pi/2), and turning rate [rad/s] at the start.
    """
    values: dict[str, Any] = {
        "K": checked("K", K, at_least=0.0, unit="N/m"),
        "C": checked("C", C, at_least=0.0, unit="N s/m"),
        "l0": checked("l0", l0, at_least=0.0, unit="m"),
    }
    ball, values["g"] = checked("ball", ball, at_least=0.0, unit="kg"), checked("g", g, unit="m/s^2")
    s = checked("s", s, above=0.0, below=HEIGHT, unit="m")
    alpha = checked("alpha", alpha, above=-math.pi / 2, below=math.pi / 2, unit="rad")
    omega, t_end = checked("omega", omega, unit="rad/s"), checked("t_end", t_end, above=0.0, unit="s")
    published = (*list(values.values())[:3], ball, values["g"], s, alpha, omega) == PUBLISHED
    parts = bodies(ball)
    q0, v0 = start(parts["centre"], s, alpha, omega)
    return Problem(
        name="flyball_governor",
        system=FlyballGovernor(**parts, **values),
        t_span=(0.0, t_end),
        q0=q0,
        v0=v0,
        scales=typical_sizes(float(parts["m"].sum()), max(abs(omega), math.sqrt(abs(values["g"]) / HEIGHT), 0.1)),
        observables={
            "slider_height": slider_height,
            "arm_angle": arm_angle,
            "shaft_angle": shaft_angle,
            "shaft_rate": shaft_rate,
        },
        reference=load_reference("flyball_governor", t_end) if published else None,
        sketch=functools.partial(sketch, parts["centre"]),
        tags=("holonomic", "stiff", "damped", "variable mass"),
        good_for="Stiff dampers (8117/s) inside a mechanism that swings slowly: only a method that takes the force "
        "implicitly may choose its step by the motion, and its multipliers must not suffer.",
        source=SOURCE,
    )
