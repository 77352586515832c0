"""Velocity constraints: a skate, and a screw that has a position constraint besides."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector
from hhtbench.conformance.scenes.scene import Equations, Levels, Scene, make_scene
from hhtbench.protocol import System, parameter

TURN = 1.5  # [rad/s]


class Skate(System):
    """A plate that slides along its edge only, on a slope, and turns steadily."""

    slope: Any = parameter(2.0, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight along the slope."""
        return jnp.stack([self.slope, 0.0, 0.0])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """No motion across the edge."""
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and potential energy."""
        return v @ v / 2 - self.slope * q[0]


def skate() -> Scene:
    """The speed u along the edge obeys u' = 2 cos(phi), phi = TURN t."""

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
        """Along the screw."""
        return jnp.stack([0.0, 0.0, self.pull])

    def constraint(self, t: Any, q: Any) -> Any:
        """The circle."""
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """The nut rises as it turns, and slips."""
        return jnp.stack([v[2] + q[1] * v[0] - q[0] * v[1] - self.slip * t])


def screw() -> Scene:
    """phi'' = (PULL - SLIP) / 2."""
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
