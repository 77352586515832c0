r"""A band track runs over two wheels: shoes on rubber bushings, penalty contact and friction on both wheels.

Source: shoe and bushings after the band track of an M113 in Project Chrono's vehicle models (a tread and a web together
are one shoe here; the wheels are as large as ``n_wrap`` shoes on half of one ask); contact of Hunt and Crossley, J. Appl.
Mech. 42 (1975) 440-445; planar, with two wheels and friction in place of teeth, by this bench::

          o---o---o---o---o            n = 2 (n_wrap + n_free) shoes (x, y, angle), end to end
        o  .--.           .--. o       o: bushing k, c along both directions, turning_k, turning_c about the pin
       o  ( W1 )         ( W2 ) o      W1: driven by the torque motor (Om - w1) [N m],  W2: braked by brake w2
        o  '--'           '--' o       bearings: W1 at the origin, W2 at (n_free pitch, 0)
          o---o---o---o---o

    0 = g = (W1, W2 - bearing)          4 rows
    every shoe is a circle of radius thickness / 2 about its centre; contact with both wheels, 2 n pairs

At the start all joints lie on the two half circles and the straight lines between them, at rest, bushings without
translation, gaps zero; the turning bushings are free in the straight band.  No closed solution.  lam: bearings [N].  SI
units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import bushings, contact, forces, plane
from hhtbench.mechanics.lines import chain, circle_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import Problem, Scales, System, parameter
from problems._common import checked, load_reference

SOURCE = "M113 band track of Project Chrono; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; two wheels by this bench"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


class BandTrack(System):
    """``q`` (3 n + 6,): shoes, then driven and braked wheel, (x, y, angle) each; four position constraints."""

    m: Array = parameter(2.13, doc="mass of a shoe [kg]")
    J: Array = parameter(0.002, doc="inertia of a shoe about its centre [kg m^2]")
    pitch: Array = parameter(0.1101, doc="length of a shoe [m]")
    wheel_radius: Array = parameter(0.2, doc="of both wheels [m]")
    thickness: Array = parameter(0.02, doc="of a shoe [m]")
    wheel_m: Array = parameter(40.0, doc="mass of a wheel [kg]")
    k: Array = parameter(7e7, doc="stiffness of a bushing [N/m]")
    c: Array = parameter(3.5e6, doc="damping of a bushing [N s/m]")
    turning_k: Array = parameter(500.0, doc="stiffness about the pin [N m/rad]")
    turning_c: Array = parameter(25.0, doc="damping about the pin [N m s]")
    contact_k: Array = parameter(6e6, doc="stiffness of contact [N/m^1.5]")
    loss: Array = parameter(0.2, doc="loss of contact [s/m]")
    onset: Array = parameter(2e-4, doc="gap over which contact sets in [m]")
    mu: Array = parameter(0.8, doc="coefficient of friction [1]")
    creep: Array = parameter(0.05, doc="speed at which 0.71 of the friction acts [m/s]")
    motor: Array = parameter(20.0, doc="torque of the motor per rate [N m s]")
    Om: Array = parameter(10.0, doc="rate that the motor drives to [rad/s]")
    brake: Array = parameter(5.0, doc="torque of the brake per rate [N m s]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    n_wrap: int = eqx.field(static=True, default=6)
    n_free: int = eqx.field(static=True, default=4)

    @property
    def shoes(self) -> int:
        """Number n of shoes."""
        return 2 * (self.n_wrap + self.n_free)

    @property
    def bodies(self) -> tuple[Array, Array]:
        """Masses [kg] and moments of inertia [kg m^2], (n + 2,) each."""
        shoe, wheel = jnp.ones(self.shoes), jnp.ones(2)
        inertia = self.wheel_m * self.wheel_radius**2 / 2
        return jnp.append(self.m * shoe, self.wheel_m * wheel), jnp.append(self.J * shoe, inertia * wheel)

    @property
    def gravity(self) -> Array:
        """Gravity (2,) [m/s^2]."""
        return jnp.stack([0.0, -self.g])

    @property
    def stiffness(self) -> Array:
        """Stiffness (3,) against the offsets along, across and in angle [N/m, N/m, N m/rad]."""
        return jnp.stack([self.k, self.k, self.turning_k])

    @property
    def bushing_law(self) -> Any:
        """Law of springs and dampers of the bushings."""
        return forces.spring_damper(self.stiffness, jnp.stack([self.c, self.c, self.turning_c]), 0.0)

    @property
    def contact_law(self) -> Any:
        """Law of the contacts."""
        return contact.hunt_crossley(self.contact_k, self.loss, self.onset)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3 n + 6,) [kg, kg, kg m^2]."""
        return plane.mass_of_bodies(*self.bodies)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: bearings of both wheels, (4,) [m]."""
        return jnp.concatenate([q[-6:-4], q[-3:-1] - jnp.stack([self.n_free * self.pitch, 0.0])])

    def offsets(self, q: Array) -> Array:
        """Offsets (n, 3) [m, m, rad] of the bushings; the angle grows by a turn once around, which the last makes good."""
        shoes = np.arange(self.shoes)
        end = jnp.stack([self.pitch / 2, 0.0])[None]
        found = bushings.offsets_in_plane(plane.placed_with_ground(q), shoes, np.roll(shoes, -1), end, -end)
        return found.at[-1, 2].add(2 * math.pi)

    @property
    def pairs(self) -> tuple[Any, Any]:
        """Shoes and wheels (2 n,) of all contacts."""
        shoes = np.arange(self.shoes)
        return np.tile(shoes, 2), np.repeat([self.shoes, self.shoes + 1], self.shoes)

    def contacts(self, q: Array) -> contact.Contact:
        """Contacts (2 n,) of the shoes with the wheels."""
        at, (shoes, wheels) = plane.placed_with_ground(q), self.pairs
        return contact.on_sphere(at.x[shoes], self.thickness / 2, at.x[wheels], self.wheel_radius)

    def gaps(self, q: Array) -> Array:
        """Gaps (2 n,) [m] of the shoes to the wheels."""
        return self.contacts(q).gap

    def pushes(self, q: Array, v: Array) -> Array:
        """Normal forces (2 n,) [N] between shoes and wheels."""
        return -self.contact_law(*forces.rates(self.gaps, q, v))

    def friction(self, q: Array, v: Array) -> Array:
        """Generalised force of friction between shoes and wheels, (3 n + 6,)."""
        law = (self.mu, self.creep)
        return contact.friction_force(plane, *self.pairs, self.contacts(q), self.pushes(q, v), law, q, v)

    def torques(self, v: Array) -> Array:
        """Torques (2,) [N m] of motor and brake on their wheels."""
        return jnp.stack([self.motor * (self.Om - v[-4]), -self.brake * v[-1]])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, bushings, contact, friction, motor and brake, (3 n + 6,) [N, N, N m]."""
        bushing = forces.force_of(self.offsets, self.bushing_law, q, v)
        push = forces.force_of(self.gaps, self.contact_law, q, v)
        weight = plane.weight_of_bodies(self.bodies[0], self.gravity)
        return (weight + bushing + push + self.friction(q, v)).at[np.array([-4, -1])].add(self.torques(v))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy, bushings and contacts [J]."""
        springs = jnp.sum(self.stiffness * self.offsets(q) ** 2) / 2
        stored = springs + contact.contact_energy(self.gaps(q), self.contact_k, self.onset)
        return plane.energy_of_bodies(q, v, *self.bodies, self.gravity) + stored

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the motor less what brake, dampers, contact and friction take [W]."""
        lost = forces.power_lost(self.offsets, self.bushing_law, q, v) + forces.power_lost(self.gaps, self.contact_law, q, v)
        return lost + self.friction(q, v) @ v + self.torques(v) @ v[np.array([-4, -1])]


PUSHES: Any = eqx.filter_jit(BandTrack.pushes)


def start(n_wrap: int, n_free: int, pitch: float) -> Vector:
    """Shoes (n, 3) [m, m, rad] on two half circles and two lines, counterclockwise from below the right wheel.

    A chord of the length of a shoe turns by ``pi / n_wrap``; the first and last joint of each half circle lie on the lines.
    """
    turn = math.pi / n_wrap
    angles = np.concatenate([np.arange(0.5, n_wrap) * turn, np.full(n_free, math.pi)])
    angles = np.concatenate([angles, math.pi + angles])
    along = pitch * np.column_stack([np.cos(angles), np.sin(angles)])
    joint = pitch / (2 * math.sin(turn / 2))  # radius of the joints
    centres = np.cumsum(along, axis=0) - along / 2 + [n_free * pitch, -joint]
    return np.column_stack([centres, angles])


def wheel_speeds(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Rates of the driven and the braked wheel (2,) [rad/s]."""
    return np.array([v[-4], v[-1]])


def largest_push(system: BandTrack, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest normal force between a shoe and a wheel [N]."""
    return float(np.max(PUSHES(system, q, v)))


def sketch(radius: float, pitch: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: both bearings as ``points`` (2, 2); shoes, wheels and spokes as ``lines`` (n + 50, 2, 2) [m]."""
    bodies = np.asarray(q).reshape(-1, 3)
    arm = np.column_stack([np.cos(bodies[:, 2]), np.sin(bodies[:, 2])])
    x, half = bodies[:, :2], pitch / 2 * arm[:-2]
    shoes = np.stack([x[:-2] - half, x[:-2] + half], axis=1)
    spokes = [chain([x[i], x[i] + radius * arm[i]]) for i in (-2, -1)]
    return {"points": x[-2:], "lines": np.concatenate([shoes, *(circle_lines(x[i], radius, 24) for i in (-2, -1)), *spokes])}


def problem(
    *,
    n_wrap: int = 6,
    n_free: int = 4,
    k: float = 7e7,
    c: float = 3.5e6,
    turning_k: float = 500.0,
    turning_c: float = 25.0,
    contact_k: float = 6e6,
    loss: float = 0.2,
    onset: float = 2e-4,
    mu: float = 0.8,
    creep: float = 0.05,
    motor: float = 20.0,
    Om: float = 10.0,
    brake: float = 5.0,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the track from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_wrap, n_free
        Shoes around half a wheel, at least 3, and between the wheels, at least 1; ``2 (n_wrap + n_free)`` in all.
    k, c
        Stiffness [N/m], above 0, and damping [N s/m], at least 0, of a bushing.
    turning_k, turning_c
        The same about its pin [N m/rad, N m s], at least 0.
    contact_k, loss, onset
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact, and gap over which it sets in [m], above 0.
    mu, creep
        Coefficient of friction [1], at least 0, and speed at which 0.71 of it acts [m/s], above 0.
    motor, Om
        Torque of the motor per rate [N m s], at least 0, and rate that it drives to [rad/s], above 0.
    brake
        Torque of the brake per rate [N m s], at least 0.
    """
    wrap, free = positive_integer("n_wrap", n_wrap), positive_integer("n_free", n_free)
    if wrap < 3:
        raise ProblemError(f"n_wrap must be at least 3, for a band around a wheel; got {wrap}.")
    values: dict[str, Any] = {
        "k": checked("k", k, above=0.0, unit="N/m"),
        "c": checked("c", c, at_least=0.0, unit="N s/m"),
        "turning_k": checked("turning_k", turning_k, at_least=0.0, unit="N m/rad"),
        "turning_c": checked("turning_c", turning_c, at_least=0.0, unit="N m s"),
        "contact_k": checked("contact_k", contact_k, above=0.0, unit="N/m^1.5"),
        "loss": checked("loss", loss, at_least=0.0, unit="s/m"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
        "motor": checked("motor", motor, at_least=0.0, unit="N m s"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "brake": checked("brake", brake, at_least=0.0, unit="N m s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    plain = BandTrack()
    published = (wrap, free) == (6, 4) and values == {key: float(getattr(plain, key)) for key in values}
    pitch, thickness = float(plain.pitch), float(plain.thickness)
    radius = pitch / (2 * math.tan(math.pi / (2 * wrap))) - thickness / 2  # of wheels that the shoes just touch
    system = BandTrack(**values, wheel_radius=jnp.asarray(radius), n_wrap=wrap, n_free=free)
    shoes, speed = start(wrap, free, pitch), radius * values["Om"]
    count, force = len(shoes), float(plain.m) * 9.81 * len(shoes)
    return Problem(
        name="band_track",
        system=system,
        t_span=(0.0, t_end),
        q0=np.concatenate([shoes.ravel(), np.zeros(3), [free * pitch, 0.0, 0.0]]),
        v0=np.zeros(3 * count + 6),
        scales=Scales(
            q=np.tile([radius, radius, 1.0], count + 2), v=np.tile([speed, speed, values["Om"]], count + 2), lam=force
        ),
        observables={"wheel_speeds": wheel_speeds, "largest_push": functools.partial(largest_push, system)},
        reference=load_reference("band_track", t_end) if published else None,
        sketch=functools.partial(sketch, radius, pitch),
        tags=("holonomic", "stiff", "damped", "contact", *(("large",) if 3 * count + 6 >= LARGE else ())),
        good_for="what engineers take HHT for: stiff damped bushings, many contacts with friction and slow motion at once",
        source=SOURCE,
    )
