r"""A floating mooring line between an anchor and a ship that moves: a rope both stiff and damped.

Source of the line: lines.txt for MoorDyn that a user posted in issue 1214 of github.com/WEC-Sim/WEC-Sim (rope of HMPE,
0.086 m, 4 kg/m, EA = 1.29e8 N, damping 0.95 of critical, drag 1 across and 0 along); lumped masses and damping as in
M. Hall, A. Goupee, Ocean Engineering 104 (2015) 590-603.  Length, pull and motion of the ship are the team's own::

             z ^   fairlead
    ~~~~~~~~~~ | ~~~~~ O ~~~~ ship: surge, sway, heave     q = (r_0, ..., r_N): points, r_i = (x, y, z) [m]
               |    .'                                     segment i of unstretched length l = length / N,
               |   o   buoyancy greater than weight:       tension  EA (d / l - 1) + c d' / l,   d = |r_(i+1) - r_i|
               |  o    an arch                             c = zeta l sqrt(EA mass)
               | o                                         end points carry half the mass, weight and drag
               |o
     anchor    O-------> x                                 0 = g = (r_0, r_N - ship(t))   [m]

    ship(t) = r_N(0) + (surge (1 - cos w t), sway (w t - sin w t), heave sin^2 (w t)),   w = 2 pi / period

Drag of a point with velocity u across the line (direction: that of the chord of its neighbours):
``-(rho / 2) Cd diameter l sqrt(|u|^2 + u0^2) u``, u0 = 0.01 m/s making it smooth.  Added mass is left out.  The start is
the equilibrium in which the line pulls the anchor with the force ``(pull_x, 0, pull_z)``; the ship pulls the line taut at
about 2 s.  ``zeta`` is the damping of the fastest vibration along the line, ``2 sqrt(EA / mass) / l = 8.3e3 rad/s``, over
critical; slower ones are damped less, in proportion.  SI units; lam [N].
"""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.forces import distances, force_of, power_lost, spring_damper
from hhtbench.mechanics.lines import chain, outline
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "line of WEC-Sim, issue 1214; Hall and Goupee, Ocean Engineering 104, 2015 (lumped masses)"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here
STILL = 0.01  # speed below which the drag becomes linear, so that it is smooth [m/s]


class MooringLine(System):
    """``q`` (3 N + 3,): points from the anchor on; constant diagonal mass, six linear position constraints, three moving."""

    EA: Array = parameter(1.29e8, doc="axial stiffness [N]")
    mass: Array = parameter(4.0, doc="mass per length [kg/m]")
    zeta: Array = parameter(0.95, doc="damping of the fastest vibration along the line over critical [1]")
    length: Array = parameter(55.0, doc="unstretched length [m]")
    diameter: Array = parameter(0.086, doc="of the displaced water [m]")
    water: Array = parameter(1025.0, doc="density [kg/m^3]")
    Cd: Array = parameter(1.0, doc="drag coefficient across the line [1]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    motion: Array = parameter((0.5, 0.3, 0.3), doc="sizes of surge, sway and heave of the ship, (3,) [m]")
    rate: Array = parameter(1.0, doc="of the ship's motion [rad/s]")
    fairlead: Array = parameter((27.0, 0.0, 45.0), doc="position of the upper end at t = 0, (3,) [m]")
    n_segments: int = eqx.field(static=True, default=40)

    @property
    def shares(self) -> Array:
        """Length of the line that each point stands for, (N + 1,) [m]."""
        return self.length / self.n_segments * np.concatenate([[0.5], np.ones(self.n_segments - 1), [0.5]])

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3 N + 3,) [kg]."""
        return jnp.repeat(self.mass * self.shares, 3)

    @property
    def lift(self) -> Array:
        """Buoyancy less weight of each point, (N + 1,) [N]."""
        return (self.water * math.pi / 4 * self.diameter**2 - self.mass) * self.g * self.shares

    def segments(self, q: Array) -> Array:
        """Lengths (N,) [m] of the segments."""
        points = q.reshape(-1, 3)
        return distances(points[1:], points[:-1])

    def springs(self) -> tuple[Array, Array, Array]:
        """Stiffness [N/m], damping [N s/m] and unstretched length [m] of a segment."""
        free = self.length / self.n_segments
        return self.EA / free, self.zeta * jnp.sqrt(self.EA * self.mass), free

    def drag(self, q: Array, v: Array) -> Array:
        """Force of the water on the points, (N + 1, 3) [N], against their velocities across the line."""
        points, speeds = jnp.pad(q.reshape(-1, 3), ((1, 1), (0, 0)), mode="edge"), v.reshape(-1, 3)
        chord = points[2:] - points[:-2]
        along = chord / jnp.linalg.norm(chord, axis=1, keepdims=True)
        across = speeds - along * jnp.sum(along * speeds, axis=1, keepdims=True)
        size = jnp.sqrt(jnp.sum(across**2, axis=1) + STILL**2)
        return -(self.water / 2 * self.Cd * self.diameter * self.shares * size)[:, None] * across

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: segments, buoyancy, weight and drag, (3 N + 3,) [N]."""
        lift = jnp.outer(self.lift, jnp.array([0.0, 0.0, 1.0]))
        return force_of(self.segments, spring_damper(*self.springs()), q, v) + (lift + self.drag(q, v)).ravel()

    def ship(self, t: Array) -> Array:
        """Position of the fairlead at ``t``, (3,) [m]."""
        turn = self.rate * t
        return self.fairlead + self.motion * jnp.stack([1 - jnp.cos(turn), turn - jnp.sin(turn), jnp.sin(turn) ** 2])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: lower end at the anchor, upper end at the ship, (6,) [m]."""
        return jnp.concatenate([q[:3], q[-3:] - self.ship(t)])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, stretch, weight and buoyancy [J]."""
        stiffness, _, free = self.springs()
        stretch = stiffness * jnp.sum((self.segments(q) - free) ** 2) / 2
        return jnp.sum(self.mass_matrix * v**2) / 2 + stretch - self.lift @ q[2::3]

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the damping, of the water and of the ship [W]."""
        ship = jax.jvp(self.ship, (t,), (jnp.ones_like(t),))[1]
        return power_lost(self.segments, spring_damper(*self.springs()), q, v) + self.drag(q, v).ravel() @ v - lam[3:] @ ship


def equilibrium(line: MooringLine, pull: Vector) -> Vector:
    """Points (N + 1, 3) [m] at rest if the line pulls the anchor with the force ``pull`` (3,) [N]: segment by segment.

    The force in the line changes from one segment to the next by the lift of the point between them.
    """
    lift = np.outer(np.asarray(line.lift)[1:-1], [0.0, 0.0, 1.0])
    forces = pull - np.vstack([np.zeros(3), np.cumsum(lift, axis=0)])
    tension = np.linalg.norm(forces, axis=1, keepdims=True)
    stiffness, _, free = (float(value) for value in line.springs())
    return np.vstack([np.zeros(3), np.cumsum(forces / tension * (free + tension / stiffness), axis=0)])


def pull_of_ship(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Force of the line on the fairlead [N]."""
    return float(np.linalg.norm(lam[3:]))


def middle(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position of the point in the middle, (3,) [m]."""
    return q.reshape(-1, 3)[len(q) // 6]


def sketch(length: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: points (N + 1, 3); line, anchor block and the ship's deck as ``lines`` (N + 8, 2, 3) [m]."""
    points, size = np.asarray(q).reshape(-1, 3), 0.04 * length
    flat = size * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    return {"points": points, "lines": np.concatenate([chain(points), outline(flat), outline(points[-1] + 2 * flat)])}


def problem(
    *,
    n_segments: int = 40,
    EA: float = 1.29e8,
    zeta: float = 0.95,
    length: float = 55.0,
    pull_x: float = 500.0,
    pull_z: float = 1500.0,
    surge: float = 0.5,
    sway: float = 0.3,
    heave: float = 0.3,
    period: float = 8.0,
    t_end: float = 4.0,
) -> Problem:
    """Make the problem: the line from rest while the ship moves, over [0, ``t_end``] [s].

    Parameters
    ----------
    n_segments
        N, at least 2.
    EA
        Axial stiffness [N], above 0.
    zeta
        Damping of the fastest vibration over critical [1], at least 0.
    length
        Of the unstretched line [m], above 0.
    pull_x, pull_z
        Force of the line on the anchor at the start, towards +x and +z [N]; pull_x above 0.
    surge, sway, heave
        Sizes of the ship's motion along x, y and z [m].
    period
        Of the ship's motion [s], above 0.
    """
    n = positive_integer("n_segments", n_segments)
    if n < 2:
        raise ProblemError(f"n_segments must be at least 2, for a point to move; got {n}.")
    t_end, period = checked("t_end", t_end, above=0.0, unit="s"), checked("period", period, above=0.0, unit="s")
    rope = {
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "zeta": checked("zeta", zeta, at_least=0.0, unit="1"),
        "length": checked("length", length, above=0.0, unit="m"),
    }
    pull = np.array([checked("pull_x", pull_x, above=0.0, unit="N"), 0.0, checked("pull_z", pull_z, unit="N")])
    motion = [checked(name, size, unit="m") for name, size in (("surge", surge), ("sway", sway), ("heave", heave))]
    values: dict[str, Any] = rope | {"motion": np.array(motion), "rate": 2 * math.pi / period}
    points = equilibrium(MooringLine(**values, n_segments=n), pull)
    published = (n, *rope.values(), *pull[::2], *motion, period) == (
        40,
        1.29e8,
        0.95,
        55.0,
        500.0,
        1500.0,
        0.5,
        0.3,
        0.3,
        8.0,
    )
    size = max(np.abs(motion).max(), 0.01 * rope["length"])
    return Problem(
        name="mooring_line",
        system=MooringLine(**values, fairlead=points[-1], n_segments=n),
        t_span=(0.0, t_end),
        q0=points.ravel(),
        v0=np.zeros(points.size),
        scales=Scales(q=size, v=size * values["rate"], lam=1e-4 * rope["EA"]),
        observables={"middle": middle, "pull_of_ship": pull_of_ship},
        reference=load_reference("mooring_line", t_end) if published else None,
        sketch=functools.partial(sketch, rope["length"]),
        tags=("holonomic", "rheonomic", "flexible", "stiff", "damped", *(("large",) if points.size >= LARGE else ())),
        good_for="vibrations of 8e3 rad/s that die by themselves, in a line that moves within seconds and is pulled taut",
        source=SOURCE,
    )
