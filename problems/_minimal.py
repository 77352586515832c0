"""Problems in minimal coordinates: as many as a mechanism has freedoms, and where they lie in the problem's own.

Mechanisms are mass points moved by minimal coordinates s; nothing of the declared systems is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.system import MinimalCoordinates, System

ROD = np.array([1.0, 4.0, 1.0]) / 6  # a uniform rod moves like these shares of its mass at begin, middle and end


@dataclass(frozen=True, eq=False)
class Minimal:
    """A mechanism as mass points moved by minimal coordinates s: nothing of the declared system is used."""

    embed: Any  #: s -> q
    points: Any  #: s -> (P, d) [m]
    masses: Any  #: (P,) [kg]
    g: float
    spring: Any = lambda s: 0.0  #: s -> potential [J]

    def accelerations(self, s: Any, u: Any) -> Any:
        """s'' by Lagrange's equations."""
        rows = jax.jacfwd(self.points)(s)
        bias = second_along(self.points, s, u)
        mass = jnp.einsum("pdi,p,pdj->ij", rows, self.masses, rows)
        height = lambda s: self.g * self.masses @ self.points(s)[:, 1] + self.spring(s)  # noqa: E731
        right = -jax.grad(height)(s) - jnp.einsum("pdi,p,pd->i", rows, self.masses, bias)
        return jnp.linalg.solve(mass, right)


def second_along(f: Any, s: Any, u: Any) -> Any:
    """The second derivative of ``f`` along ``u``."""
    return jax.jvp(lambda x: jax.jvp(f, (x,), (u,))[1], (s,), (u,))[1]


def direction(angle: Any) -> Any:
    """Unit vectors, (k, 2)."""
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


def on_rods(begins: Any, ends: Any) -> Any:
    """The points that stand for uniform rods."""
    return jnp.concatenate([begins, (begins + ends) / 2, ends])


def rod_masses(masses: Any) -> Any:
    """Masses of these points [kg]."""
    return jnp.outer(ROD, jnp.asarray(masses)).ravel()


def planar_chain(n: int, m: float, L: float, g: float) -> Minimal:
    """s: angles of the rods [rad]."""

    def ends(s: Any) -> Any:
        return jnp.cumsum(L / n * direction(s), axis=0)

    def begins(s: Any) -> Any:
        return ends(s) - L / n * direction(s)

    embed = lambda s: jnp.column_stack([(begins(s) + ends(s)) / 2, s]).ravel()  # noqa: E731
    return Minimal(embed, lambda s: on_rods(begins(s), ends(s)), rod_masses([m / n] * n), g)


def bead_chain(n: int, m: float, L: float, g: float) -> Minimal:
    """s: elevations, then azimuths of the links."""

    def beads(s: Any) -> Any:
        up, around = s[:n], s[n:]
        links = jnp.stack([jnp.cos(up) * jnp.cos(around), jnp.sin(up), jnp.cos(up) * jnp.sin(around)], axis=1)
        return jnp.cumsum(L / n * links, axis=0)

    return Minimal(lambda s: beads(s).ravel(), beads, jnp.full(n, m / n), g)


def stiff_spring_pendulum(k: float, m: Any, l: Any, g: float) -> Minimal:  # noqa: E741
    """s: both angles, and the length of the spring where there is one."""

    def points(s: Any) -> Any:
        first = (l[0] if k == math.inf else s[2]) * direction(s[0])
        return jnp.stack([first, first + l[1] * direction(s[1])])

    spring = (lambda s: 0.0) if k == math.inf else (lambda s: k * (s[2] - l[0]) ** 2 / 2)
    return Minimal(lambda s: points(s).ravel(), points, jnp.asarray(m), g, spring)


def slider_crank(m: float, m_slider: float, l: float, g: float) -> Minimal:  # noqa: E741
    """s: the crank's angle [rad]."""

    def points(s: Any) -> Any:
        joint, slider = l * direction(s), 2 * l * direction(s) * jnp.array([1.0, 0.0])
        return jnp.concatenate([on_rods(jnp.zeros((1, 2)), joint), on_rods(joint, slider), slider])

    embed = lambda s: jnp.concatenate([s, -s, 2 * l * jnp.cos(s)])  # noqa: E731
    return Minimal(embed, points, jnp.append(jnp.tile(ROD * m, 2), m_slider), g)


def four_bars(n: int, m: float, l: float, g: float) -> Minimal:  # noqa: E741
    """s: the cranks' angle from upright [rad]."""
    ground = l * jnp.column_stack([jnp.arange(n + 1.0), jnp.zeros(n + 1)])

    def bars(s: Any) -> Any:
        top = ground + l * jnp.stack([jnp.sin(s[0]), jnp.cos(s[0])])
        return jnp.concatenate([ground, top[:-1]]), jnp.concatenate([top, top[1:]])

    def embed(s: Any) -> Any:
        angles = jnp.concatenate([jnp.full(n + 1, math.pi / 2) - s[0], jnp.zeros(n)])
        return jnp.column_stack([sum(bars(s)) / 2, angles]).ravel()

    return Minimal(embed, lambda s: on_rods(*bars(s)), rod_masses([m] * (2 * n + 1)), g)


@dataclass(frozen=True, eq=False)
class PaperPendulum:
    """The paper's pendulum by its angle from the x axis [rad]."""

    m: float
    L: float
    k: float
    c: float
    g: float

    def embed(self, s: Any) -> Any:
        """Centre of mass and angle."""
        return jnp.stack([self.L * jnp.cos(s[0]), self.L * jnp.sin(s[0]), s[0]])

    def accelerations(self, s: Any, u: Any) -> Any:
        """From the moments about the pivot."""
        moment = self.c * u + self.k * (s - 1.5 * math.pi) + self.m * self.g * self.L * jnp.cos(s)
        return -moment / (4 * self.m * self.L**2 / 3)


class Free(System):
    """``s'' = accelerations(s, s')``: no constraints, unit mass."""

    mechanism: Any = eqx.field(static=True)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Accelerations, at unit mass."""
        return self.mechanism.accelerations(q, v)


def coordinates(mechanism: Any, s0: Any, u0: Any) -> MinimalCoordinates:
    """``mechanism`` from the start ``s0``, ``u0``."""
    return MinimalCoordinates(system=Free(mechanism=mechanism), embed=mechanism.embed, s0=s0, u0=u0)


def hanging_point(m: float, L: float, g: float, amplitude: float) -> MinimalCoordinates:
    """A point on a rod, let go at rest ``amplitude`` [rad] from hanging."""

    def place(s: Any) -> Any:
        return L * direction(s)

    mechanism = Minimal(lambda s: place(s).ravel(), place, jnp.asarray([m]), g)
    return coordinates(mechanism, [amplitude - math.pi / 2], [0.0])


def paper_pendulum(values: dict[str, float], angle: float, rate: float) -> MinimalCoordinates:
    """With the parameters ``m, L, k, c, g``, from its angle [rad] and rate [rad/s]."""
    return coordinates(PaperPendulum(**values), [angle], [rate])


def level_chain(n: int, m: float, L: float, g: float) -> MinimalCoordinates:
    """Rods from rest along the x axis."""
    return coordinates(planar_chain(n, m, L, g), np.zeros(n), np.zeros(n))


def level_beads(n: int, m: float, L: float, g: float, w: float) -> MinimalCoordinates:
    """Beads along the x axis, the last one moving along z with ``w`` [m/s]."""
    return coordinates(bead_chain(n, m, L, g), np.zeros(2 * n), np.append(np.zeros(n), np.full(n, w / L)))


def level_spring(k: float, m: Any, l: Any, g: float) -> MinimalCoordinates:  # noqa: E741
    """Both points on the x axis at rest."""
    s0 = [0.0, 0.0] if k == math.inf else [0.0, 0.0, l[0]]
    return coordinates(stiff_spring_pendulum(k, m, l, g), s0, np.zeros(len(s0)))


def turning_crank(m: float, m_slider: float, l: float, g: float, angle: float, rate: float) -> MinimalCoordinates:  # noqa: E741
    """From its angle [rad] and rate [rad/s]."""
    return coordinates(slider_crank(m, m_slider, l, g), [angle], [rate])


def upright_bars(n: int, m: float, l: float, g: float, speed: float) -> MinimalCoordinates:  # noqa: E741
    """Upright, B0 moving along x with ``speed`` [m/s]."""
    return coordinates(four_bars(n, m, l, g), [0.0], [speed / l])
