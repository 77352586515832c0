"""No constraints: two coordinates coupled by their masses, damped and driven."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector
from hhtbench.conformance.scenes.scene import Equations, Levels, Scene, make_scene
from hhtbench.protocol import System, parameter

STIFFNESS, DAMPING, DRIVE, FREQUENCY = 9.0, 0.5, 2.0, 2.0
INERTIA = np.array([[2.0, 1.0], [1.0, 2.0]])
SHARES = np.array([1.0, -0.5])  # of the two coordinates in the drive


class Oscillator(System):
    """Two coordinates coupled by their masses, damped and driven."""

    stiffness: Any = parameter(STIFFNESS, doc="[1/s^2]")
    damping: Any = parameter(DAMPING, doc="[1/s]")
    drive: Any = parameter(DRIVE, doc="[m/s^2]")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Full."""
        return jnp.asarray(INERTIA)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Springs, dampers and the drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return INERTIA @ (drive - self.stiffness * q - self.damping * v)

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and of the springs."""
        return (v @ INERTIA @ v + self.stiffness * (q @ INERTIA @ q)) / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """Of dampers and drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return v @ (INERTIA @ (drive - self.damping * v))


def oscillator(
    name: str = "unconstrained", stiffness: float = STIFFNESS, damping: float = DAMPING, free: float = 1.0
) -> Scene:
    """Every coordinate for itself: x'' + d x' + k x = A cos(w t), from x = 1 at rest; without ``free`` the forced motion.

    Overdamped without ``free`` only.
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
