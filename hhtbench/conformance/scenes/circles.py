"""Mechanisms of the extremes, with closed solutions up to the largest parameters.

Directions are the rows of a matrix whose entries are halves, so that no coordinate is a direction by itself. What moves
along SLOW and FAST moves on circles that bend towards FIRST and SECOND. Forces are given by the length of the arc,
whose equation is that of a straight line, while the constraints turn the motion and take up a push along the normals:
nothing is right without them.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad

from hhtbench.conformance.scenes.scene import on_motion
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter

BASIS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]) / 2
SLOW, FAST, FIRST, SECOND = BASIS
PRESS = 1.0  # force against the circles [m/s^2]


class Arc(NamedTuple):
    """A state on a circle that touches the direction ``along`` at the origin and bends towards ``across``."""

    length: Any  #: from the origin [m]
    rate: Any  #: [m/s]
    tangent: Any  #: (n,)
    normal: Any  #: (n,), away from the centre


def arc(q: Any, v: Any, along: Any, across: Any, radius: Any) -> Arc:
    """Return arc length, rate, tangent and normal of the state on a circle, from which forces are made."""
    angle = jnp.arctan2(along @ q, radius - across @ q)
    s, c = jnp.sin(angle), jnp.cos(angle)
    tangent = c * along + s * across
    return Arc(radius * angle, tangent @ v, tangent, s * along - c * across)


def off_circle(q: Any, along: Any, across: Any, radius: Any) -> Any:
    """Distance from the circle [m] to first order; its gradient is the normal."""
    x, y = along @ q, across @ q
    return (x * x + y * y) / (2 * radius) - y


def on_circle(length: float, rate: float, along: Vector, across: Vector, radius: float) -> tuple[Vector, Vector]:
    """Return q and v (n,) of a point on the circle at the arc ``length`` with the ``rate``."""
    angle = length / radius
    s, c, depth = math.sin(angle), math.cos(angle), 2 * math.sin(angle / 2) ** 2
    return radius * (s * along + depth * across), rate * (c * along + s * across)


class Crossed(System):
    """Four coordinates on two circles, with springs, a damper, a gyroscopic coupling and pushes along the arcs."""

    slow: Any = parameter(1.0, doc="spring along SLOW [1/s^2]")
    fast: Any = parameter(1.0, doc="spring along FAST [1/s^2]")
    damper: Any = parameter(0.0, doc="along SLOW [1/s]")
    lead: Any = parameter(0.0, doc="times sin t: where the spring along SLOW is at rest, and its damper [m]")
    spin: Any = parameter(0.0, doc="gyroscopic [1/s]")
    push: Any = parameter(0.0, doc="of a force along SLOW and one against its circle, after `begin` [m/s^2]")
    begin: Any = parameter(0.0, doc="[s]")
    rows: Any = parameter(np.eye(2), doc="(m, 2) of the constraints, in the two circles")
    radius: Any = parameter(1.0, doc="of both circles [m]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: along each arc by itself."""
        y = arc(q, v, SLOW, FIRST, self.radius)
        z = arc(q, v, FAST, SECOND, self.radius)
        pushed = jnp.where(t > self.begin, self.push, 0.0)
        led, led_rate = self.lead * jnp.sin(t), self.lead * jnp.cos(t)
        along = pushed - led - self.slow * (y.length - led) - self.damper * (y.rate - led_rate) - self.spin * z.rate
        across = -self.fast * z.length + self.spin * y.rate
        return along * y.tangent + across * z.tangent + (PRESS + pushed) * y.normal + PRESS * z.normal

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the rows."""
        return self.rows @ jnp.stack([off_circle(q, SLOW, FIRST, self.radius), off_circle(q, FAST, SECOND, self.radius)])


class Lengths(NamedTuple):
    """Arc lengths and rates on both circles, and the push against the first circle."""

    y: float
    z: float
    y_rate: float
    z_rate: float
    pushed: float = 0.0


def _crossed(name: str, known: Any, span: float, size: float = 1.0, **given: Any) -> Problem:
    """Make a problem of :class:`Crossed` from ``known``, which maps t to :class:`Lengths`."""
    system = Crossed(**given)
    radius, rows = float(system.radius), np.asarray(system.rows)

    def exact(t: float) -> Motion:
        x = known(t)
        (q, v), (p, u) = (
            on_circle(x.y, x.y_rate, SLOW, FIRST, radius),
            on_circle(x.z, x.z_rate, FAST, SECOND, radius),
        )
        normal = np.array([PRESS + x.pushed + x.y_rate**2 / radius, PRESS + x.z_rate**2 / radius])
        return Motion(q + p, v + u, np.linalg.lstsq(rows.T, normal, rcond=None)[0], np.zeros(0))

    return on_motion(name, system, exact, span, Scales(q=size, v=size, lam=size))


def crossed_levels(t: float, q: Vector, v: Vector) -> Vector:
    """Violations of both constraint levels of the two circles of radius 1, (4,)."""
    pairs = (SLOW, FIRST), (FAST, SECOND)
    places = [float(off_circle(q, u, n, 1.0)) for u, n in pairs]
    return np.array([*places, *((u @ q) * (u @ v) + (n @ q - 1.0) * (n @ v) for u, n in pairs)])


def _waves(y: tuple[complex, complex], z: tuple[complex, complex] = (0.0, 0.0)) -> Callable[[float], Lengths]:
    """Return arc lengths that are real parts of amplitude times exp(exponent t)."""

    def known(t: float) -> Lengths:
        (y_now, y_rate), (z_now, z_rate) = ((x := a * cmath.exp(s * t), s * x) for a, s in (y, z))
        return Lengths(y_now.real, z_now.real, y_rate.real, z_rate.real)

    return known


def stiff(stiffness: float, span: float) -> Problem:
    """Problem with y = cos t along SLOW, and a vibration of amplitude 1 / stiffness along FAST."""
    return _crossed("stiff", _waves((1.0, 1j), (1.0 / stiffness, 1j * math.sqrt(stiffness))), span, fast=stiffness)


def damped(damper: float, span: float) -> Problem:
    """Problem y'' = -damper (y' + y) on its slow motion, about e^-t; ``damper`` above 4."""
    rate = 2.0 / (1.0 + math.sqrt(1.0 - 4.0 / damper))
    return _crossed("damped", _waves((1.0, -rate)), span, slow=damper, damper=damper)


def led(stiffness: float, damper: float, span: float) -> Problem:
    """Problem with y = sin t along SLOW, led by a spring and damper whose rest position moves so."""
    return _crossed("led", _waves((-1j, 1j)), span, slow=stiffness, damper=damper, lead=1.0)


def spinning(spin: float, span: float) -> Problem:
    """Problem with springs of the size of a gyroscopic force: a slow circle of frequency near 1, the fast one at rest."""
    w = 2.0 / (1.0 + math.sqrt(1.0 + 4.0 / spin))
    return _crossed("spinning", _waves((1.0, 1j * w), (1j, 1j * w)), span, slow=spin, fast=spin, spin=spin)


def pushed(push: float, begin: float, span: float) -> Problem:
    """Problem with a force that jumps at ``begin``: half of it moves the point, half is taken by the constraints."""

    def known(t: float) -> Lengths:
        s = max(t - begin, 0.0)
        y, rate = math.cos(t) + push * (1 - math.cos(s)), -math.sin(t) + push * math.sin(s)
        return Lengths(y, 0.0, rate, 0.0, push if t > begin else 0.0)

    size = 1.0 + push
    return _crossed("pushed", known, span, size, push=push, begin=begin, radius=2.0 * size)


def leaning(rows: Any, span: float) -> Problem:
    """Problem with constraint ``rows`` (m, 2) of the two circles, possibly nearly dependent; y = cos t along SLOW."""
    return _crossed("leaning", _waves((1.0, 1j)), span, rows=np.asarray(rows))


class Oscillator(System):
    """``q'' = -stiffness q - damping v``: one coordinate, no constraint."""

    stiffness: Any = parameter(1.0, doc="[1/s^2]")
    damping: Any = parameter(0.0, doc="[1/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: spring and damper."""
        return -self.stiffness * q - self.damping * v


AHEAD, ASIDE = np.eye(2)
BEND = 2.0  # radius of the circle on which masses slide and bounce [m]


class Guided(System):
    """A mass on a circle of radius ``BEND``."""

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the circle."""
        return off_circle(q, AHEAD, ASIDE, BEND)[None]


class OneSided(Guided):
    """A mass that meets a spring at 0, guided along a circle."""

    stiffness: Any = parameter(1e4, doc="[1/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: the spring while it is pressed."""
        x = arc(q, v, AHEAD, ASIDE, BEND)
        return self.stiffness * jnp.maximum(-x.length, 0.0) * x.tangent + PRESS * x.normal


def bouncing(stiffness: float, span: float) -> Problem:
    """Problem from 1 m with speed -1 m/s: it meets the spring at t = 1 and leaves half its period later with speed 1."""
    w = math.sqrt(stiffness)

    def exact(t: float) -> Motion:
        s = w * (t - 1.0)
        if s <= 0.0:
            x, rate = 1.0 - t, -1.0
        elif s < math.pi:
            x, rate = -math.sin(s) / w, -math.cos(s)
        else:
            x, rate = t - 1.0 - math.pi / w, 1.0
        return Motion(*on_circle(x, rate, AHEAD, ASIDE, BEND), np.array([PRESS + rate**2 / BEND]), np.zeros(0))

    return on_motion("bouncing", OneSided(stiffness=stiffness), exact, span)


class Sliding(Guided):
    """A mass on a circle with a friction of 1 m/s^2 that changes its sign within the speed ``width``."""

    width: Any = parameter(1e-2, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: friction, and what presses the mass to the circle."""
        x = arc(q, v, AHEAD, ASIDE, BEND)
        return -jnp.tanh(x.rate / self.width) * x.tangent + PRESS * x.normal


class Rubbing(Guided):
    """A mass on a circle with friction as large as the multiplier, which is 1 m/s^2 at every speed."""

    width: Any = parameter(1e-2, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: what presses."""
        x = arc(q, v, AHEAD, ASIDE, BEND)
        return (1.0 - x.rate**2 / BEND) * x.normal

    def reaction(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        """Reaction force: along the normal, and friction against the motion."""
        x = arc(q, v, AHEAD, ASIDE, BEND)
        normal = (q[0] * AHEAD + (q[1] - BEND) * ASIDE) / BEND
        return -lam[0] * normal - jnp.abs(lam[0]) * jnp.tanh(x.rate / self.width) * x.tangent


def sliding(width: float, span: float, system: type[System] = Sliding) -> Problem:
    """Problem that starts at 1 m/s and comes to rest at t = 1; ``system``: friction as a force or in the reaction."""

    def exact(t: float) -> Motion:
        rate = sliding_speed(width, t)
        lam = 1.0 if system is Rubbing else PRESS + rate**2 / BEND
        return Motion(*on_circle(slid(width, t), rate, AHEAD, ASIDE, BEND), np.array([lam]), np.zeros(0))

    given: Any = system(width=width)
    return on_motion(system.__name__.lower(), given, exact, span)


def sliding_speed(width: float, t: float) -> float:
    """Speed v(t) [m/s] with sinh(v / width) = sinh(1 / width) e^(-t / width)."""
    start = 1.0 / width
    level = start + math.log1p(-math.exp(-2.0 * start)) - math.log(2.0) - t / width  # logarithm of that
    return width * (
        level + math.log1p(math.sqrt(1.0 + math.exp(-2.0 * level))) if level > 0 else math.asinh(math.exp(level))
    )


def slid(width: float, t: float) -> float:
    """Path until ``t`` [m]: the integral of v coth(v / width) from :func:`sliding_speed` to 1, its straight part closed."""
    rate = sliding_speed(width, t)
    rest, _ = quad(lambda u: u / math.expm1(u) if u else 1.0, min(2 * rate / width, 100.0), min(2 / width, 100.0))
    return (1.0 - rate**2) / 2 + width**2 / 2 * rest
