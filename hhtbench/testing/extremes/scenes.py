"""Mechanisms of the extremes, with closed solutions up to the largest parameters.

Directions are the rows of a matrix whose entries are halves: sums along them are exact in floating-point numbers, so that a
stiffness of 1e14 across a motion leaves no roundoff in it.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.arguments import Vector
from hhtbench.protocol import Motion, Problem, Scales, System, parameter
from hhtbench.testing.scenes import GRAVITY, RADIUS, swing

BASIS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]) / 2
SLOW, FAST, FIRST, SECOND = BASIS  # the last two are held by constraints


class Crossed(System):
    """Four coordinates, two of four directions held: along SLOW and FAST springs, a damper and a spin that couples them."""

    slow: Any = parameter(1.0, doc="spring along SLOW [1/s^2]")
    fast: Any = parameter(1.0, doc="spring along FAST [1/s^2]")
    damper: Any = parameter(0.0, doc="along SLOW [1/s]")
    spin: Any = parameter(0.0, doc="gyroscopic [1/s]")
    push: Any = parameter(0.0, doc="of a force along SLOW and one along FIRST, after `begin` [m/s^2]")
    begin: Any = parameter(0.0, doc="[s]")
    rows: Any = parameter(BASIS[2:], doc="(m, 4) of the constraints")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Along each direction by itself."""
        y, z, y_rate, z_rate = SLOW @ q, FAST @ q, SLOW @ v, FAST @ v
        pushed = jnp.where(t > self.begin, self.push, 0.0)
        along = pushed - self.slow * y - self.damper * y_rate - self.spin * z_rate
        across = -self.fast * z + self.spin * y_rate
        return along * SLOW + across * FAST + pushed * FIRST

    def constraint(self, t: Any, q: Any) -> Any:
        """The rows."""
        return self.rows @ q


def stiff(stiffness: float, span: float) -> Problem:
    """y = cos t along SLOW, and a vibration as large as 1 / stiffness along FAST."""
    w = math.sqrt(stiffness)

    def exact(t: float) -> Motion:
        y, z = math.cos(t), math.cos(w * t) / stiffness
        q, v = y * SLOW + z * FAST, -math.sin(t) * SLOW - math.sin(w * t) / w * FAST
        return Motion(q, v, np.zeros(2), np.zeros(0))

    return _problem("stiff", Crossed(fast=stiffness), exact, span)


def damped(damper: float, span: float) -> Problem:
    """y'' = -damper (y' + y) on its slow motion, about e^-t; ``damper`` above 4."""
    rate = 2.0 / (1.0 + math.sqrt(1.0 - 4.0 / damper))

    def exact(t: float) -> Motion:
        y = math.exp(-rate * t)
        return Motion(y * SLOW, -rate * y * SLOW, np.zeros(2), np.zeros(0))

    return _problem("damped", Crossed(slow=damper, damper=damper), exact, span)


def spinning(spin: float, span: float) -> Problem:
    """Springs of the size of a gyroscopic force: a slow circle of frequency near 1, the fast one near ``spin`` at rest."""
    w = 2.0 / (1.0 + math.sqrt(1.0 + 4.0 / spin))

    def exact(t: float) -> Motion:
        c, s = math.cos(w * t), math.sin(w * t)
        return Motion(c * SLOW - s * FAST, -w * (s * SLOW + c * FAST), np.zeros(2), np.zeros(0))

    return _problem("spinning", Crossed(slow=spin, fast=spin, spin=spin), exact, span)


def pushed(push: float, begin: float, span: float) -> Problem:
    """A force that jumps right after ``begin``: half of it moves, half of it the constraints take up."""

    def exact(t: float) -> Motion:
        s = max(t - begin, 0.0)
        y, rate = math.cos(t) + push * (1 - math.cos(s)), -math.sin(t) + push * math.sin(s)
        return Motion(y * SLOW, rate * SLOW, np.array([push if t > begin else 0.0, 0.0]), np.zeros(0))

    return _problem("pushed", Crossed(push=push, begin=begin), exact, span, 1.0 + push)


def leaning(rows: Any, span: float) -> Problem:
    """Constraints ``rows`` (m, 4) that span FIRST and SECOND, however nearly dependent they are; y = cos t along SLOW."""

    def exact(t: float) -> Motion:
        return Motion(math.cos(t) * SLOW, -math.sin(t) * SLOW, np.zeros(len(rows)), np.zeros(0))

    return _problem("leaning", Crossed(rows=np.asarray(rows)), exact, span)


def _problem(name: str, system: System, exact: Any, span: float, size: float = 1.0) -> Problem:
    start = exact(0.0)
    scales = Scales(q=size, v=size, lam=size)
    return Problem(name=name, system=system, t_span=(0.0, span), q0=start.q, v0=start.v, exact=exact, scales=scales)


class Oscillator(System):
    """``q'' = -stiffness q - damping v``: one coordinate, no constraint."""

    stiffness: Any = parameter(1.0, doc="[1/s^2]")
    damping: Any = parameter(0.0, doc="[1/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Spring and damper."""
        return -self.stiffness * q - self.damping * v


def oscillator(frequency: float, steps: int) -> Problem:
    """From rest position with unit speed, over ``steps`` [s]."""
    system = Oscillator(stiffness=frequency**2)
    return Problem(name="oscillator", system=system, t_span=(0.0, float(steps)), q0=np.zeros(1), v0=np.ones(1))


class OneSided(System):
    """A mass that meets a spring at 0, guided along a line."""

    stiffness: Any = parameter(1e4, doc="[1/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """The spring while it is pressed."""
        return self.stiffness * jnp.maximum(-q[0], 0.0) * jnp.array([1.0, 0.0])

    def constraint(self, t: Any, q: Any) -> Any:
        """The line."""
        return q[1:]


def bouncing(stiffness: float, span: float) -> Problem:
    """From 1 with speed -1: it arrives at t = 1 and leaves half a period of the spring later with speed 1."""
    w = math.sqrt(stiffness)

    def exact(t: float) -> Motion:
        s = w * (t - 1.0)
        if s <= 0.0:
            x, rate = 1.0 - t, -1.0
        elif s < math.pi:
            x, rate = -math.sin(s) / w, -math.cos(s)
        else:
            x, rate = t - 1.0 - math.pi / w, 1.0
        return Motion(np.array([x, 0.0]), np.array([rate, 0.0]), np.zeros(1), np.zeros(0))

    start = exact(0.0)
    return Problem(
        name="bouncing", system=OneSided(stiffness=stiffness), t_span=(0.0, span), q0=start.q, v0=start.v, exact=exact
    )


class Sliding(System):
    """A mass on a line with a friction of 1 m/s^2 that changes its sign within the speed ``width``."""

    width: Any = parameter(1e-2, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Friction."""
        return -jnp.tanh(v[0] / self.width) * jnp.array([1.0, 0.0])

    def constraint(self, t: Any, q: Any) -> Any:
        """The line."""
        return q[1:]


def sliding(width: float, span: float) -> Problem:
    """From the speed 1; it has come to rest at t = 1."""
    return Problem(name="sliding", system=Sliding(width=width), t_span=(0.0, span), q0=np.zeros(2), v0=np.array([1.0, 0.0]))


def sliding_speed(width: float, t: float) -> float:
    """sinh(v / width) = sinh(1 / width) e^(-t / width) [m/s]."""
    start = 1.0 / width
    level = start + math.log1p(-math.exp(-2.0 * start)) - math.log(2.0) - t / width  # logarithm of that
    return width * (
        level + math.log1p(math.sqrt(1.0 + math.exp(-2.0 * level))) if level > 0 else math.asinh(math.exp(level))
    )


class Parallelogram(System):
    """Two unit masses on equal rods, joined by a third one as long as the way between the pivots: a closed chain."""

    radius: Any = parameter(RADIUS, doc="of the rods [m]")
    gravity: Any = parameter(GRAVITY, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weights."""
        return -self.gravity * jnp.array([0.0, 1.0, 0.0, 1.0])

    def constraint(self, t: Any, q: Any) -> Any:
        """Rods and coupler."""
        first, second = q[:2], q[2:] - jnp.array([1.0, 0.0])
        coupler = q[2:] - q[:2]
        return jnp.stack([first @ first - self.radius**2, second @ second - self.radius**2, coupler @ coupler - 1.0]) / 2


def parallelogram(span: float) -> Problem:
    """Released at rest: both rods swing as the pendulum of :func:`hhtbench.testing.scenes.swing`."""

    def exact(t: float) -> Motion:
        angle, rate = swing(t)
        place = RADIUS * np.array([np.sin(angle), -np.cos(angle)])
        across = RADIUS * np.array([np.cos(angle), np.sin(angle)])
        q = np.concatenate([place, place + np.array([1.0, 0.0])])
        return Motion(q, rate * np.concatenate([across, across]), np.full(3, np.nan), np.zeros(0))

    start = exact(0.0)
    fastest = math.sqrt(2 * GRAVITY * RADIUS)
    scales = Scales(q=RADIUS, v=fastest, lam=GRAVITY / RADIUS)
    return Problem(
        name="parallelogram",
        system=Parallelogram(),
        t_span=(0.0, span),
        q0=start.q,
        v0=start.v,
        exact=exact,
        scales=scales,
    )


def parallelogram_levels(t: float, q: Vector, v: Vector) -> Vector:
    """Both levels of the three constraints, (6,)."""
    parts = (q[:2], v[:2]), (q[2:] - [1.0, 0.0], v[2:]), (q[2:] - q[:2], v[2:] - v[:2])
    lengths = RADIUS**2, RADIUS**2, 1.0
    places = [(d @ d - length) / 2 for (d, _), length in zip(parts, lengths, strict=True)]
    return np.array([*places, *(d @ u for d, u in parts)])


class DoublePendulum(System):
    """Two masses on unit rods, q (4,): the upper one 1 kg, the lower one ``ratio``."""

    ratio: Any = parameter(1.0, doc="of the lower mass to the upper one")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Constant."""
        return jnp.diag(jnp.stack([1.0 + 0 * self.ratio, 1.0 + 0 * self.ratio, self.ratio, self.ratio]))

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weights."""
        return -GRAVITY * jnp.stack([0.0 * self.ratio, 1.0 + 0.0 * self.ratio, 0.0 * self.ratio, self.ratio])

    def constraint(self, t: Any, q: Any) -> Any:
        """Both rods."""
        d = q[2:] - q[:2]
        return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2.0, (d @ d - 1.0) / 2.0])

    @staticmethod
    def bent(upper: float, lower: float) -> tuple[np.ndarray, np.ndarray]:
        """The rods at these angles [rad] from below, at rest."""
        first, second = (np.array([np.sin(x), -np.cos(x)]) for x in (upper, lower))
        return np.concatenate([first, first + second]), np.zeros(4)

    @staticmethod
    def straight(angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Both rods at ``angle`` [rad] from below, at rest."""
        return DoublePendulum.bent(angle, angle)


def double_pendulum(ratio: float, span: float) -> Problem:
    """Straight at 0.5 rad, at rest."""
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
