r"""An eccentric cam turns in the yoke of a follower with backlash: contact changes sides twice a turn, with friction.

Source: textbook mechanics (an eccentric in a yoke without backlash is a Scotch yoke, lift = ecc sin(Om t)); contact of
Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the numbers are of this bench::

              | |                       q = (x_c, y_c, angle_c, x_f, y_f, angle_f): cam, follower [m, m, rad]
       =======| |=======  upper flat    O: bearing of the cam, ecc away from its middle C
           (       )                    the flats are 2 radius + backlash apart
          (   C     )                   the follower slides along y
           ( O     )      lower flat    spring spring_k to its place at the start
       =======| |=======

    0 = g = (C - ecc (cos, sin) angle_c,  x_f,  angle_f,  angle_c - Om t)
    gaps: backlash / 2 + (y_f - y_c)  above,  backlash / 2 - (y_f - y_c)  below

Push of a flat ``N = k s^1.5 max(0, 1 + 1.5 c s')`` with the smooth depth s of ``hhtbench.mechanics.contact``, friction
``mu N w / sqrt(w^2 + creep^2)`` against the sliding velocity w.  The follower starts at rest relative to the cam, in
the middle of the backlash.  lam: bearing [N, N], guide [N, N m], drive [N m].  SI units.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import contact, forces, plane
from hhtbench.mechanics.lines import chain, circle_lines, pin_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Problem, Scales, System, parameter
from problems._common import checked, load_reference

SOURCE = (
    "textbook mechanics, eccentric in a yoke; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; numbers of this bench"
)
CAM, FOLLOWER, GROUND = 0, 1, -1
UP = np.array([0.0, 1.0])


class CamFollower(System):
    """Two bodies (x, y, angle), five position constraints; one free coordinate between two contacts."""

    m: Array = parameter([3.0, 2.0], doc="masses of cam and follower [kg]")
    radius: Array = parameter(0.05, doc="of the cam [m]")
    ecc: Array = parameter(0.02, doc="from the bearing to the middle of the cam [m]")
    backlash: Array = parameter(5e-4, doc="distance of the flats less the cam's diameter [m]")
    Om: Array = parameter(40.0, doc="rate of the cam [rad/s]")
    spring_k: Array = parameter(500.0, doc="stiffness of the follower's spring [N/m]")
    k: Array = parameter(1e8, doc="stiffness of contact [N/m^1.5]")
    c: Array = parameter(0.5, doc="loss of contact [s/m]: an impact at u keeps 1 - c u of its speed")
    mu: Array = parameter(0.1, doc="coefficient of friction [1]")
    onset: Array = parameter(1e-5, doc="gap over which contact sets in [m]")
    creep: Array = parameter(0.02, doc="speed at which 0.71 of the friction acts [m/s]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def J(self) -> Array:
        """Moments of inertia (2,) [kg m^2] about the centres: a disk, and a follower that does not turn."""
        return self.m * self.radius**2 / 2

    @property
    def gravity(self) -> Array:
        """Gravity (2,) [m/s^2]."""
        return jnp.stack([0.0, -self.g])

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (6,) [kg, kg, kg m^2]."""
        return plane.mass_of_bodies(self.m, self.J)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: bearing, guide, drive, (5,) [m, m, m, rad, rad]."""
        at, none = plane.placed_with_ground(q), jnp.zeros((1, 2))
        pin = plane.revolute_rows(at, [CAM], [GROUND], jnp.stack([-self.ecc, 0.0])[None], none)
        guide = plane.prismatic_rows(at, [FOLLOWER], [GROUND], none, none, UP[None])
        return jnp.concatenate([pin, guide, q[2:3] - self.Om * t])

    def contacts(self, q: Array) -> contact.Contact:
        """Contacts of the cam with the upper and the lower flat."""
        at, side = plane.placed_with_ground(q), np.array([1.0, -1.0])[:, None]
        flats = side * (self.radius + self.backlash / 2) * UP
        inward = plane.turned(at.angle[FOLLOWER], -side * UP)
        return contact.on_plane(at.x[np.array([CAM, CAM])], self.radius, plane.points_on(at, [FOLLOWER] * 2, flats), inward)

    def gaps(self, q: Array) -> Array:
        """Gaps (2,) [m] to the upper and the lower flat."""
        return self.contacts(q).gap

    def stretch(self, q: Array) -> Array:
        """Stretch of the spring (1,) [m]."""
        return q[4:5]

    @property
    def law(self) -> Any:
        """Law of the contacts."""
        return contact.hunt_crossley(self.k, self.c, self.onset)

    def pushes(self, q: Array, v: Array) -> Array:
        """Normal forces (2,) [N] of the upper and the lower flat."""
        return -self.law(*forces.rates(self.gaps, q, v))

    def friction(self, q: Array, v: Array) -> Array:
        """Generalised force of friction at both flats, (6,)."""
        push = self.pushes(q, v)
        return contact.friction_force(plane, [CAM], [FOLLOWER], self.contacts(q), push, (self.mu, self.creep), q, v)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, spring, contact and friction, (6,) [N, N, N m]."""
        spring = forces.force_of(self.stretch, forces.spring_damper(self.spring_k, 0.0, 0.0), q, v)
        push = forces.force_of(self.gaps, self.law, q, v)
        return plane.weight_of_bodies(self.m, self.gravity) + spring + push + self.friction(q, v)

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy, spring and contacts [J]."""
        stored = self.spring_k * q[4] ** 2 / 2 + contact.contact_energy(self.gaps(q), self.k, self.onset)
        return plane.energy_of_bodies(q, v, self.m, self.J, self.gravity) + stored

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the drive less what contact and friction lose [W]."""
        return -self.Om * lam[4] + forces.power_lost(self.gaps, self.law, q, v) + self.friction(q, v) @ v


PUSHES: Any = eqx.filter_jit(CamFollower.pushes)


def lift(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Lift of the follower [m]."""
    return float(q[4])


def push(system: CamFollower, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Normal forces of the upper and the lower flat (2,) [N]."""
    return np.asarray(PUSHES(system, q, v))


def sketch(radius: float, ecc: float, half: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: bearing and middles as ``points`` (3, 2); cam, spoke, yoke, support as ``lines`` (38, 2, 2) [m]."""
    q = np.asarray(q)
    cam, follower = q[:2], q[3:5]
    width = 1.5 * radius
    flats = follower + np.array([[(x, y) for x in (-width, width)] for y in (-half, half)])
    stem = chain(follower + np.array([(0.0, half), (0.0, half + radius)]))
    rim = circle_lines(cam, radius, 24)
    spoke = chain([cam, cam + radius * np.array([np.cos(q[2]), np.sin(q[2])])])
    points = np.array([[0.0, 0.0], cam, follower])
    return {"points": points, "lines": np.concatenate([rim, spoke, flats, stem, pin_lines((0.0, 0.0), ecc / 2)])}


def problem(
    *,
    ecc: float = 0.02,
    backlash: float = 5e-4,
    Om: float = 40.0,
    spring_k: float = 500.0,
    k: float = 1e8,
    c: float = 0.5,
    mu: float = 0.1,
    onset: float = 1e-5,
    creep: float = 0.02,
    t_end: float = 0.5,
) -> Problem:
    """Make the problem: the cam at a constant rate over [0, ``t_end``] [s].

    Parameters
    ----------
    ecc
        From the bearing to the middle of the cam [m], above 0 and below its radius, 0.05.
    backlash
        Distance of the flats less the cam's diameter [m], at least 0.
    Om
        Rate of the cam [rad/s], above 0.
    spring_k
        Stiffness of the follower's spring [N/m], at least 0.
    k, c
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact.
    mu
        Coefficient of friction [1], at least 0.
    onset, creep
        Gap over which contact sets in [m] and speed at which 0.71 of the friction acts [m/s], above 0.
    """
    values: dict[str, Any] = {
        "ecc": checked("ecc", ecc, above=0.0, below=0.05, unit="m"),
        "backlash": checked("backlash", backlash, at_least=0.0, unit="m"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "spring_k": checked("spring_k", spring_k, at_least=0.0, unit="N/m"),
        "k": checked("k", k, above=0.0, unit="N/m^1.5"),
        "c": checked("c", c, at_least=0.0, unit="s/m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    plain, system = CamFollower(), CamFollower(**values)
    published = values == {key: float(getattr(plain, key)) for key in values}
    radius, ecc, speed = float(system.radius), values["ecc"], values["ecc"] * values["Om"]
    force = float(system.m[1]) * (speed * values["Om"] + 9.81)
    return Problem(
        name="cam_follower",
        system=system,
        t_span=(0.0, t_end),
        q0=np.array([ecc, 0.0, 0.0, 0.0, 0.0, 0.0]),
        v0=np.array([0.0, speed, values["Om"], 0.0, speed, 0.0]),
        scales=Scales(
            q=np.array([ecc, ecc, 1.0] * 2),
            v=np.array([speed, speed, values["Om"]] * 2),
            lam=np.array([force, force, force, force * ecc, force * ecc]),
        ),
        observables={"lift": lift, "push": functools.partial(push, system)},
        reference=load_reference("cam_follower", t_end) if published else None,
        sketch=functools.partial(sketch, radius, ecc, radius + values["backlash"] / 2),
        tags=("holonomic", "rheonomic", "stiff", "damped", "contact"),
        good_for="impacts across backlash in a mechanism with constraints, seen in the drive's multiplier and in the energy",
        source=SOURCE,
    )
