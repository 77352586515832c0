r"""A vibrating ball mill: a drum on four rubber mounts in space is shaken, and balls in it hit wall, ends and one another.

Source: rigid bodies by unit quaternions as in P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall
1988; contact of Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the mill is of this bench::

          z ^   .--------.               q = (x, p) of the drum, then of each ball (7 each): place [m], unit quaternion
            |  /          \              force of the exciter at the drum's centre:
            | |      +     |  radius         push (cos Om t, 0, sin Om t)
            |  \ o o o    /              axis of the drum along y, its ends at +- half
         ___|___'--------'___            n balls of radius ball, 3 n + n (n - 1) / 2 contacts
         [ ]                [ ]          four mounts with six stiffnesses each, at (+-foot, +-half, -radius)
      ----------------------------> x

    0 = g = p.p - 1  for every body

Mounts: ``mount_k (1, 1, 2)`` against translation and ``mount_k block^2`` against every turn, with dampers in the same
proportions.  Contact is ``k s^1.5 max(0, 1 + 1.5 c s')`` of the smooth depth s, and friction
``mu N w / sqrt(w^2 + creep^2)``, as in ``hhtbench.mechanics.contact``.  At the start the drum is at rest on free
mounts, and the balls slide along the axis just above the wall, one forth, the next back.  Impacts multiply errors: a long
motion is not predictable.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import bushings, contact, forces, space
from hhtbench.mechanics.lines import outline
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Nikravesh, Prentice Hall 1988; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the mill is of this bench"
DRUM = 0
AXIS = np.array([0.0, 1.0, 0.0])
SLIDE = 0.7  #: speed of the balls along the axis at the start [m/s]
MOST_BALLS = 5  #: that find room in a row along the bottom


class BallMill(System):
    """``q`` (7 n + 7,): drum and balls; a norm of a quaternion each."""

    drum_m: Array = parameter(20.0, doc="mass of the drum [kg]")
    drum_J: Array = parameter([0.3, 0.4, 0.3], doc="moments of inertia of the drum [kg m^2]")
    radius: Array = parameter(0.15, doc="inner radius of the drum [m]")
    half: Array = parameter(0.15, doc="half of its inner length [m]")
    foot: Array = parameter(0.2, doc="from the axis to a mount, across [m]")
    ball: Array = parameter(0.025, doc="radius of a ball [m]")
    ball_m: Array = parameter(0.5, doc="mass of a ball [kg]")
    mount_k: Array = parameter(1e5, doc="stiffness of a mount across [N/m]")
    mount_c: Array = parameter(200.0, doc="damping of a mount across [N s/m]")
    block: Array = parameter(0.03, doc="arm of a mount's stiffness against turns [m]")
    k: Array = parameter(1e7, doc="stiffness of contact [N/m^1.5]")
    c: Array = parameter(0.3, doc="loss of contact [s/m]: an impact at u keeps 1 - c u of its speed")
    onset: Array = parameter(5e-5, doc="gap over which contact sets in [m]")
    mu: Array = parameter(0.3, doc="coefficient of friction [1]")
    creep: Array = parameter(0.02, doc="speed at which 0.71 of the friction acts [m/s]")
    push: Array = parameter(1500.0, doc="force of the exciter [N]")
    Om: Array = parameter(100.0, doc="rate of the exciter [rad/s]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    j0: Array = parameter(1.0, doc="inertia along the quaternions over the mean moment of inertia [1]")
    n_balls: int = eqx.field(static=True, default=3)

    @property
    def bodies(self) -> tuple[Array, Array]:
        """Masses (n + 1,) [kg] and principal moments of inertia (n + 1, 3) [kg m^2]."""
        sphere = 0.4 * self.ball_m * self.ball**2 * jnp.ones((self.n_balls, 3))
        return jnp.append(self.drum_m, self.ball_m * jnp.ones(self.n_balls)), jnp.concatenate([self.drum_J[None], sphere])

    @property
    def gravity(self) -> Array:
        """Gravity (3,) [m/s^2]."""
        return jnp.stack([0.0, 0.0, -self.g])

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: a block for each body, (7 n + 7, 7 n + 7)."""
        m, J = self.bodies
        return space.mass_of_bodies(q, m, J, self.j0 * jnp.mean(J, axis=1))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norms of the quaternions, (n + 1,) [1]."""
        return space.norm_rows(space.split(q)[1])

    @property
    def feet(self) -> Array:
        """Mounts (4, 3) [m] in the frame of the drum, and in space at the start."""
        corners = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
        return jnp.column_stack([self.foot * corners[:, 0], self.half * corners[:, 1], -self.radius * jnp.ones(4)])

    @property
    def shares(self) -> Array:
        """Stiffness (6,) of a mount over its stiffness across: along x, y, z and against turns about them [1, m^2]."""
        return jnp.concatenate([jnp.array([1.0, 1.0, 2.0]), self.block**2 * jnp.ones(3)])

    def offsets(self, q: Array) -> Array:
        """Offsets (4, 6) [m, rad] of the mounts from the ground to the drum."""
        return bushings.offsets_in_space(space.placed_with_ground(q), [-1] * 4, [DRUM] * 4, self.feet, self.feet)

    @property
    def mount_law(self) -> Any:
        """Law of springs and dampers of the mounts."""
        return forces.spring_damper(self.mount_k * self.shares, self.mount_c * self.shares, 0.0)

    @property
    def pairs(self) -> tuple[Any, Any]:
        """Bodies that touch: every ball with the wall and both ends, then all pairs of balls."""
        balls, (first, second) = np.arange(1, self.n_balls + 1), np.triu_indices(self.n_balls, 1)
        return np.concatenate([np.tile(balls, 3), first + 1]), np.append(np.full(3 * self.n_balls, DRUM), second + 1)

    def contacts(self, q: Array) -> contact.Contact:
        """Contacts, in the order of ``pairs``."""
        at, n, (first, second) = space.placed_with_ground(q), self.n_balls, self.pairs
        balls, axis = at.x[1:-1], at.R[DRUM] @ AXIS
        side = np.repeat([1.0, -1.0], n)[:, None]
        wall = contact.on_cylinder(balls, self.ball, at.x[DRUM], axis, -self.radius)
        ends = contact.on_plane(jnp.tile(balls, (2, 1)), self.ball, at.x[DRUM] + side * self.half * axis, -side * axis)
        each = contact.on_sphere(at.x[first[3 * n :]], self.ball, at.x[second[3 * n :]], self.ball)
        return contact.Contact(*(jnp.concatenate(parts) for parts in zip(wall, ends, each, strict=True)))

    def gaps(self, q: Array) -> Array:
        """Gaps (3 n + n (n - 1) / 2,) [m]."""
        return self.contacts(q).gap

    @property
    def contact_law(self) -> Any:
        """Law of the contacts."""
        return contact.hunt_crossley(self.k, self.c, self.onset)

    def pushes(self, q: Array, v: Array) -> Array:
        """Normal forces [N] of all contacts."""
        return -self.contact_law(*forces.rates(self.gaps, q, v))

    def friction(self, q: Array, v: Array) -> Array:
        """Generalised force of friction at all contacts, (7 n + 7,)."""
        law = (self.mu, self.creep)
        return contact.friction_force(space, *self.pairs, self.contacts(q), self.pushes(q, v), law, q, v)

    def exciter(self, t: Array) -> Array:
        """Force (3,) [N] of the exciter."""
        return self.push * jnp.stack([jnp.cos(self.Om * t), 0.0, jnp.sin(self.Om * t)])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, terms quadratic in v, mounts, contact, friction, exciter, (7 n + 7,)."""
        inertial = space.force_on_bodies(q, v, *self.bodies, self.gravity)
        mounts = forces.force_of(self.offsets, self.mount_law, q, v)
        contacts = forces.force_of(self.gaps, self.contact_law, q, v) + self.friction(q, v)
        return (inertial + mounts + contacts).at[:3].add(self.exciter(t))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy, mounts and contacts [J]."""
        stored = self.mount_k * jnp.sum(self.shares * self.offsets(q) ** 2) / 2
        stored += contact.contact_energy(self.gaps(q), self.k, self.onset)
        return space.energy_of_bodies(q, v, *self.bodies, self.gravity) + stored

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the exciter less what mounts, contact and friction take [W]."""
        lost = forces.power_lost(self.offsets, self.mount_law, q, v) + forces.power_lost(self.gaps, self.contact_law, q, v)
        return lost + self.friction(q, v) @ v + self.exciter(t) @ v[:3]


PUSHES: Any = eqx.filter_jit(BallMill.pushes)


def centre(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of the drum (3,) [m]."""
    return np.asarray(q[:3])


def largest_push(system: BallMill, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest normal force of a contact [N]."""
    return float(np.max(PUSHES(system, q, v)))


def ring(middle: Vector, R: Vector, radius: float, pieces: int) -> Vector:
    """Circle (pieces, 2, 3) about the axis y of the frame ``R``."""
    turn = np.linspace(0.0, 2 * math.pi, pieces, endpoint=False)
    return np.asarray(outline(middle + radius * np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)]) @ R.T))


def sketch(system: BallMill, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: balls as ``points`` (n, 3); ends, balls, brackets and mounts as ``lines`` (12 n + 56, 2, 3) [m]."""
    x, p = (np.asarray(part) for part in space.split(q))
    R, half, radius = np.asarray(space.rotation(p)), float(system.half) * AXIS, float(system.radius)
    ends = [ring(x[0] + side * R[0] @ half, R[0], radius, 24) for side in (-1.0, 1.0)]
    balls = [ring(x[i], R[i], float(system.ball), 12) for i in range(1, len(x))]
    feet = np.asarray(system.feet)
    sides = np.column_stack([np.sign(feet[:, 0]) * radius, feet[:, 1], 0 * feet[:, 0]])
    held = x[0] + feet @ R[0].T
    brackets = np.stack([x[0] + sides @ R[0].T, held], axis=1)
    mounts = np.stack([held, feet - (0.0, 0.0, radius / 3)], axis=1)
    return {"points": x[1:], "lines": np.concatenate([*ends, *balls, brackets, mounts])}


def start(system: BallMill) -> Vector:
    """Coordinates (7 n + 7,): the drum in its place, balls in a row along the bottom, a fiftieth of their radius above."""
    n, ball = system.n_balls, float(system.ball)
    along = 2.2 * ball * (np.arange(n) - (n - 1) / 2)
    tilt = 0.2 * np.sin(np.arange(n) + 1.0)  # they start beside the lowest line, and so roll
    arm = float(system.radius) - 1.02 * ball
    x = np.column_stack([arm * np.sin(tilt), along, -arm * np.cos(tilt)])
    bodies = np.concatenate([np.zeros((1, 3)), x])
    return np.column_stack([bodies, np.tile([1.0, 0.0, 0.0, 0.0], (n + 1, 1))]).ravel()


def problem(
    *,
    n_balls: int = 3,
    mount_k: float = 1e5,
    mount_c: float = 200.0,
    k: float = 1e7,
    c: float = 0.3,
    onset: float = 5e-5,
    mu: float = 0.3,
    creep: float = 0.02,
    push: float = 1500.0,
    Om: float = 100.0,
    t_end: float = 0.2,
) -> Problem:
    """Make the problem: the mill from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_balls
        n, from 1 to 5.
    mount_k, mount_c
        Stiffness [N/m], above 0, and damping [N s/m], at least 0, of a mount across.
    k, c, onset
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact, and gap over which it sets in [m], above 0.
    mu, creep
        Coefficient of friction [1], at least 0, and speed at which 0.71 of it acts [m/s], above 0.
    push, Om
        Force [N] and rate [rad/s], above 0, of the exciter.
    """
    n = positive_integer("n_balls", n_balls)
    if n > MOST_BALLS:
        raise ProblemError(f"n_balls must be at least 1 and at most {MOST_BALLS}, which find room in a row; got {n}.")
    values: dict[str, Any] = {
        "mount_k": checked("mount_k", mount_k, above=0.0, unit="N/m"),
        "mount_c": checked("mount_c", mount_c, at_least=0.0, unit="N s/m"),
        "k": checked("k", k, above=0.0, unit="N/m^1.5"),
        "c": checked("c", c, at_least=0.0, unit="s/m"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
        "push": checked("push", push, unit="N"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    plain, system = BallMill(), BallMill(**values, n_balls=n)
    published = n == 3 and values == {key: float(getattr(plain, key)) for key in values}
    speeds = np.zeros((n + 1, 7))
    speeds[1:, 1] = SLIDE * (-1.0) ** np.arange(n)
    force = max(abs(values["push"]), float(system.drum_m) * 9.81)
    size, rate = float(system.radius), 1.0 / float(system.ball)  # balls that roll at 1 m/s
    return Problem(
        name="ball_mill",
        system=system,
        t_span=(0.0, t_end),
        q0=start(system),
        v0=speeds.ravel(),
        scales=Scales(
            q=np.tile([size] * 3 + [1.0] * 4, n + 1),
            v=np.tile([1.0] * 3 + [rate / 2] * 4, n + 1),
            lam=np.append(force * size, np.full(n, float(system.ball_m))),
        ),
        observables={"centre": centre, "largest_push": functools.partial(largest_push, system)},
        reference=load_reference("ball_mill", t_end) if published else None,
        sketch=functools.partial(sketch, system),
        tags=("holonomic", "variable mass", "stiff", "damped", "contact"),
        good_for="contact and friction in space: balls in a drum on rubber mounts, impacts short against the motion",
        source=SOURCE,
    )
