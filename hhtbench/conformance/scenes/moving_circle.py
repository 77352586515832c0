"""A rheonomic constraint: a bead on a circle that grows and moves."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector
from hhtbench.conformance.scenes.scene import SPAN, Equations, Levels, Scene, make_scene
from hhtbench.protocol import System, parameter

TURN, GROWTH, DRIFT = 1.5, 0.3, 0.4  # [rad/s], [m/s], [m/s]


class MovingCircle(System):
    """A bead on a circle whose radius grows and whose centre moves; the constraint does work."""

    begin: Any = parameter(0.0, doc="time at which the radius is 1 m [s]")
    growth: Any = parameter(GROWTH, doc="[m/s]")
    drift: Any = parameter(DRIFT, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """None."""
        return jnp.zeros(2)

    def constraint(self, t: Any, q: Any) -> Any:
        """The circle."""
        s = t - self.begin
        return jnp.stack([((q[0] - self.drift * s) ** 2 + q[1] ** 2 - (1 + self.growth * s) ** 2) / 2])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic energy."""
        return v @ v / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """That of the reaction."""
        s = t - self.begin
        return -lam[0] * ((q[0] - self.drift * s) * v[0] + q[1] * v[1])


def moving_circle(begin: float = 0.0) -> Scene:
    """From ``begin`` [s] on; the moment of momentum about the centre is kept."""

    def motion(t: float) -> tuple[Vector, Vector]:
        s = t - begin
        radius = 1 + GROWTH * s
        angle, rate = TURN * s / radius, TURN / radius**2
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
