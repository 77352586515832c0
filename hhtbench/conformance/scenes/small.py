"""Small mechanisms with closed solutions, one for each kind of equation: forces alone, moving and velocity constraints."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.conformance.scenes.scene import SPAN, Equations, Levels, Scene, make_scene
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import System, parameter

STIFFNESS, DAMPING, DRIVE, FREQUENCY = 9.0, 0.5, 2.0, 2.0
INERTIA = np.array([[2.0, 1.0], [1.0, 2.0]])
SHARES = np.array([1.0, -0.5])  # of the two coordinates in the drive


class Oscillator(System):
    """Two coordinates coupled by their masses, damped and driven."""

    stiffness: Any = parameter(STIFFNESS, doc="[1/s^2]")
    damping: Any = parameter(DAMPING, doc="[1/s]")
    drive: Any = parameter(DRIVE, doc="[m/s^2]")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Mass matrix: full."""
        return jnp.asarray(INERTIA)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: springs, dampers and the drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return INERTIA @ (drive - self.stiffness * q - self.damping * v)

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic energy and energy of the springs."""
        return (v @ INERTIA @ v + self.stiffness * (q @ INERTIA @ q)) / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """Power of dampers and drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return v @ (INERTIA @ (drive - self.damping * v))


def oscillator(
    name: str = "unconstrained", stiffness: float = STIFFNESS, damping: float = DAMPING, free: float = 1.0
) -> Scene:
    """Coordinates with x'' + d x' + k x = A cos(w t) each, from x = 1 at rest; with ``free`` 0 the forced motion only.

    Overdamped parameters are allowed with ``free`` 0 only.
    """
    amplitude = DRIVE * stiffness / STIFFNESS  # so that what is stiff moves as far
    gain = amplitude * SHARES / ((stiffness - FREQUENCY**2) ** 2 + (damping * FREQUENCY) ** 2)
    in_phase, behind = gain * (stiffness - FREQUENCY**2), gain * damping * FREQUENCY
    decay, own = damping / 2, np.sqrt(abs(stiffness - damping**2 / 4))
    cosine = free * (1.0 - in_phase)
    sine = free * (decay * cosine - behind * FREQUENCY) / own

    def motion(t: float) -> tuple[Vector, Vector]:
        c, s, e = np.cos(own * t), np.sin(own * t), np.exp(-decay * t)
        wc, ws = np.cos(FREQUENCY * t), np.sin(FREQUENCY * t)
        q = e * (cosine * c + sine * s) + in_phase * wc + behind * ws
        free = e * (own * (sine * c - cosine * s) - decay * (cosine * c + sine * s))
        return q, free + FREQUENCY * (behind * wc - in_phase * ws)

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        drive = amplitude * np.cos(FREQUENCY * t) * SHARES
        return Equations(INERTIA, INERTIA @ (drive - stiffness * q - damping * v), np.zeros((0, 2)), np.zeros(0))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        return Levels(np.zeros(0), np.zeros(0))

    return make_scene(name, Oscillator(stiffness=stiffness, damping=damping, drive=amplitude), motion, equations, levels)


ROUND, GROWTH, DRIFT = 1.5, 0.3, 0.4  # [rad/s], [m/s], [m/s]


class MovingCircle(System):
    """A bead on a circle whose radius grows and whose centre moves; the constraint does work."""

    begin: Any = parameter(0.0, doc="time at which the radius is 1 m [s]")
    growth: Any = parameter(GROWTH, doc="[m/s]")
    drift: Any = parameter(DRIFT, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: none."""
        return jnp.zeros(2)

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the circle."""
        s = t - self.begin
        return jnp.stack([((q[0] - self.drift * s) ** 2 + q[1] ** 2 - (1 + self.growth * s) ** 2) / 2])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic energy."""
        return v @ v / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """Power of the reaction."""
        s = t - self.begin
        return -lam[0] * ((q[0] - self.drift * s) * v[0] + q[1] * v[1])


def moving_circle(begin: float = 0.0) -> Scene:
    """Scene of :class:`MovingCircle` from ``begin`` [s] on; the angular momentum about the centre is conserved."""

    def motion(t: float) -> tuple[Vector, Vector]:
        s = t - begin
        radius = 1 + GROWTH * s
        angle, rate = ROUND * s / radius, ROUND / radius**2
        normal, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        shift = np.array([DRIFT, 0.0])
        return shift * s + radius * normal, shift + GROWTH * normal + radius * rate * along

    def relative(t: float, q: Vector, v: Vector) -> tuple[Vector, Vector, float]:
        shift = np.array([DRIFT, 0.0])
        return q - shift * (t - begin), v - shift, 1 + GROWTH * (t - begin)

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        d, u, _ = relative(t, q, v)
        return Equations(np.eye(2), np.zeros(2), d[None, :], np.array([u @ u - GROWTH**2]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        d, u, radius = relative(t, q, v)
        return Levels(np.array([(d @ d - radius**2) / 2]), np.array([d @ u - radius * GROWTH]))

    system = MovingCircle(begin=begin)
    return make_scene("rheonomic", system, motion, equations, levels, (begin, begin + SPAN[1]))


TURN = 1.5  # [rad/s]


class Skate(System):
    """A plate that slides along its edge only, on a slope, and turns steadily."""

    slope: Any = parameter(2.0, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight along the slope."""
        return jnp.stack([self.slope, 0.0, 0.0])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """Velocity constraints: no motion across the edge."""
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and potential energy."""
        return v @ v / 2 - self.slope * q[0]


def skate() -> Scene:
    """Scene of :class:`Skate`: the speed u along the edge obeys u' = 2 cos(phi), phi = TURN t."""

    def motion(t: float) -> tuple[Vector, Vector]:
        angle = TURN * t
        speed = 2 * np.sin(angle) / TURN
        q = np.array([np.sin(angle) ** 2 / TURN**2, (angle - np.sin(angle) * np.cos(angle)) / TURN**2, angle])
        return q, np.array([speed * np.cos(angle), speed * np.sin(angle), TURN])

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        s, c = np.sin(q[2]), np.cos(q[2])
        curvature = v[2] * (v[0] * c + v[1] * s)
        return Equations(np.eye(3), np.array([2.0, 0.0, 0.0]), np.array([[s, -c, 0.0]]), np.array([curvature]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        return Levels(np.zeros(0), np.array([v[0] * np.sin(q[2]) - v[1] * np.cos(q[2])]))

    return make_scene("velocity", Skate(), motion, equations, levels)


PULL, SLIP = 3.0, 1.0  # of the nut [N], [m/s^2]; (PULL - SLIP) / 2 = 1 rad/s^2


class Screw(System):
    """A nut on a circle, turned by a velocity constraint with a slip that grows with time."""

    pull: Any = parameter(PULL, doc="[N]")
    slip: Any = parameter(SLIP, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: along the screw."""
        return jnp.stack([0.0, 0.0, self.pull])

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the circle."""
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """Velocity constraints: the nut rises as it turns, and slips."""
        return jnp.stack([v[2] + q[1] * v[0] - q[0] * v[1] - self.slip * t])


def screw() -> Scene:
    """Scene of :class:`Screw`: the angle obeys phi'' = (PULL - SLIP) / 2."""
    rate = (PULL - SLIP) / 2

    def motion(t: float) -> tuple[Vector, Vector]:
        angle, turn = TURN * t + rate * t**2 / 2, TURN + rate * t
        c, s = np.cos(angle), np.sin(angle)
        return np.array([c, s, angle + SLIP * t**2 / 2]), np.array([-turn * s, turn * c, turn + SLIP * t])

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        rows = np.array([[q[0], q[1], 0.0], [q[1], -q[0], 1.0]])
        return Equations(np.eye(3), np.array([0.0, 0.0, PULL]), rows, np.array([v[0] ** 2 + v[1] ** 2, -SLIP]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        across = v[2] + q[1] * v[0] - q[0] * v[1] - SLIP * t
        return Levels(np.array([(q[0] ** 2 + q[1] ** 2 - 1) / 2]), np.array([q[0] * v[0] + q[1] * v[1], across]))

    return make_scene("mixed", Screw(), motion, equations, levels)
