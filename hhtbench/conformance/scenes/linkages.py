"""Double pendulum with any ratio of masses."""

from __future__ import annotations

from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.conformance.scenes.pendulum import GRAVITY
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter


class DoublePendulum(System):
    """Two masses on unit rods, q (4,): the upper one 1 kg, the lower one ``ratio``."""

    ratio: Any = parameter(1.0, doc="of the lower mass to the upper one")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Mass matrix: constant."""
        return jnp.diag(jnp.stack([1.0 + 0 * self.ratio, 1.0 + 0 * self.ratio, self.ratio, self.ratio]))

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weights."""
        return -GRAVITY * jnp.stack([0.0 * self.ratio, 1.0 + 0.0 * self.ratio, 0.0 * self.ratio, self.ratio])

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: both rods."""
        d = q[2:] - q[:2]
        return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2.0, (d @ d - 1.0) / 2.0])

    @staticmethod
    def bent(upper: float, lower: float) -> tuple[np.ndarray, np.ndarray]:
        """State at rest with the rods at these angles [rad] from below."""
        first, second = (np.array([np.sin(x), -np.cos(x)]) for x in (upper, lower))
        return np.concatenate([first, first + second]), np.zeros(4)

    @staticmethod
    def straight(angle: float) -> tuple[np.ndarray, np.ndarray]:
        """State at rest with both rods at ``angle`` [rad] from below."""
        return DoublePendulum.bent(angle, angle)

    @staticmethod
    def fastest(ratio: float) -> float:
        """Highest frequency of small vibrations [rad/s]: omega^4 - 2 (1 + ratio) g omega^2 + (1 + ratio) g^2 = 0."""
        return float(np.sqrt(np.roots([1.0, -2.0 * (1.0 + ratio) * GRAVITY, (1.0 + ratio) * GRAVITY**2]).max()))


def double_pendulum(ratio: float, span: float) -> Problem:
    """Double pendulum released straight at 0.5 rad, at rest."""
    q0, v0 = DoublePendulum.straight(0.5)
    return Problem(
        name="double_pendulum", system=DoublePendulum(ratio=ratio), t_span=(0.0, span), q0=q0, v0=v0, scales=Scales(v=3.0)
    )


@cache
def double_pendulum_angles(start: float, ratio: float, t: float) -> tuple[float, float]:
    """Angles [rad] at ``t`` [s] of the double pendulum released straight at ``start``, by DOP853 in minimal coordinates."""

    def rates(_: float, y: Any) -> Any:
        upper, lower, w, z = y
        s, c = np.sin(upper - lower), np.cos(upper - lower)
        pull = s * w**2 - GRAVITY * np.sin(lower)
        rate = (-ratio * s * z**2 - (1 + ratio) * GRAVITY * np.sin(upper) - ratio * c * pull) / (1 + ratio * s**2)
        return [w, z, rate, pull - c * rate]

    found = solve_ivp(rates, (0, t), [start, start, 0.0, 0.0], "DOP853", rtol=1e-10, atol=1e-12)
    return float(found.y[0, -1]), float(found.y[1, -1])
