"""Minimal coordinates of the problems: as many as degrees of freedom, with the map to the problem's own coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.problem import MinimalCoordinates
from hhtbench.protocol.system import System

ROD = np.array([1.0, 4.0, 1.0]) / 6  # a uniform rod moves like these shares of its mass at begin, middle and end


@dataclass(frozen=True, eq=False)
class Minimal:
    """A mechanism as mass points moved by minimal coordinates s; independent of the functions of the problem's System."""

    embed: Any  #: s -> q
    points: Any  #: s -> (P, d) [m]
    masses: Any  #: (P,) [kg]
    g: float
    spring: Any = lambda s: 0.0  #: s -> potential [J]

    def accelerations(self, s: Any, u: Any) -> Any:
        """Accelerations s'' from Lagrange's equations."""
        rows = jax.jacfwd(self.points)(s)
        bias = second_along(self.points, s, u)
        mass = jnp.einsum("pdi,p,pdj->ij", rows, self.masses, rows)
        height = lambda s: self.g * self.masses @ self.points(s)[:, 1] + self.spring(s)  # noqa: E731
        right = -jax.grad(height)(s) - jnp.einsum("pdi,p,pd->i", rows, self.masses, bias)
        return jnp.linalg.solve(mass, right)


def second_along(f: Any, s: Any, u: Any) -> Any:
    """Second directional derivative of ``f`` at ``s`` along ``u``."""
    return jax.jvp(lambda x: jax.jvp(f, (x,), (u,))[1], (s,), (u,))[1]


def direction(angle: Any) -> Any:
    """Unit vectors (k, 2) at the angles ``angle`` (k,) [rad]."""
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


def on_rods(begins: Any, ends: Any) -> Any:
    """Positions of the mass points that are equivalent to uniform rods from ``begins`` to ``ends``."""
    return jnp.concatenate([begins, (begins + ends) / 2, ends])


def rod_masses(masses: Any) -> Any:
    """Masses [kg] of the mass points that are equivalent to uniform rods."""
    return jnp.outer(ROD, jnp.asarray(masses)).ravel()


def planar_chain(n: int, m: float, L: float, g: float) -> Minimal:
    """Planar chain in the angles s of its rods [rad]."""

    def ends(s: Any) -> Any:
        return jnp.cumsum(L / n * direction(s), axis=0)

    def begins(s: Any) -> Any:
        return ends(s) - L / n * direction(s)

    embed = lambda s: jnp.column_stack([(begins(s) + ends(s)) / 2, s]).ravel()  # noqa: E731
    return Minimal(embed, lambda s: on_rods(begins(s), ends(s)), rod_masses([m / n] * n), g)


def bead_chain(n: int, m: float, L: float, g: float) -> Minimal:
    """Bead chain in the elevations, then azimuths of its links."""

    def beads(s: Any) -> Any:
        up, around = s[:n], s[n:]
        links = jnp.stack([jnp.cos(up) * jnp.cos(around), jnp.sin(up), jnp.cos(up) * jnp.sin(around)], axis=1)
        return jnp.cumsum(L / n * links, axis=0)

    return Minimal(lambda s: beads(s).ravel(), beads, jnp.full(n, m / n), g)


def stiff_spring_pendulum(k: float, m: Any, l: Any, g: float) -> Minimal:  # noqa: E741
    """Stiff spring pendulum in both angles and, with a spring, its length."""

    def points(s: Any) -> Any:
        first = (l[0] if k == math.inf else s[2]) * direction(s[0])
        return jnp.stack([first, first + l[1] * direction(s[1])])

    spring = (lambda s: 0.0) if k == math.inf else (lambda s: k * (s[2] - l[0]) ** 2 / 2)
    return Minimal(lambda s: points(s).ravel(), points, jnp.asarray(m), g, spring)


def slider_crank(m: float, m_slider: float, l: float, g: float) -> Minimal:  # noqa: E741
    """Slider crank in the angle of its crank [rad]."""

    def points(s: Any) -> Any:
        joint, slider = l * direction(s), 2 * l * direction(s) * jnp.array([1.0, 0.0])
        return jnp.concatenate([on_rods(jnp.zeros((1, 2)), joint), on_rods(joint, slider), slider])

    embed = lambda s: jnp.concatenate([s, -s, 2 * l * jnp.cos(s)])  # noqa: E731
    return Minimal(embed, points, jnp.append(jnp.tile(ROD * m, 2), m_slider), g)


def four_bars(n: int, m: float, l: float, g: float) -> Minimal:  # noqa: E741
    """Four-bar windows in the angle of the cranks from upright [rad]."""
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
    """The pendulum of Jay and Negrut in its angle from the x axis [rad]."""

    m: float
    L: float
    k: float
    c: float
    g: float

    def embed(self, s: Any) -> Any:
        """Coordinates (x, y, angle) of the problem from the angle."""
        return jnp.stack([self.L * jnp.cos(s[0]), self.L * jnp.sin(s[0]), s[0]])

    def accelerations(self, s: Any, u: Any) -> Any:
        """Angular acceleration from the moments about the pivot."""
        moment = self.c * u + self.k * (s - 1.5 * math.pi) + self.m * self.g * self.L * jnp.cos(s)
        return -moment / (4 * self.m * self.L**2 / 3)


class Free(System):
    """Unconstrained system ``s'' = accelerations(s, s')`` with unit mass."""

    mechanism: Any = eqx.field(static=True)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Accelerations, which are forces at unit mass."""
        return self.mechanism.accelerations(q, v)


def coordinates(mechanism: Any, s0: Any, u0: Any) -> MinimalCoordinates:
    """MinimalCoordinates of ``mechanism`` with the start ``s0``, ``u0``."""
    return MinimalCoordinates(system=Free(mechanism=mechanism), embed=mechanism.embed, s0=s0, u0=u0)


def hanging_point(m: float, L: float, g: float, amplitude: float) -> MinimalCoordinates:
    """Point on a rod, released at rest ``amplitude`` [rad] from hanging."""

    def place(s: Any) -> Any:
        return L * direction(s)

    mechanism = Minimal(lambda s: place(s).ravel(), place, jnp.asarray([m]), g)
    return coordinates(mechanism, [amplitude - math.pi / 2], [0.0])


def paper_pendulum(values: dict[str, float], angle: float, rate: float) -> MinimalCoordinates:
    """Pendulum of Jay and Negrut with parameters ``m, L, k, c, g``, started at ``angle`` [rad] with ``rate`` [rad/s]."""
    return coordinates(PaperPendulum(**values), [angle], [rate])


def level_chain(n: int, m: float, L: float, g: float) -> MinimalCoordinates:
    """Planar chain started at rest along the x axis."""
    return coordinates(planar_chain(n, m, L, g), np.zeros(n), np.zeros(n))


def level_beads(n: int, m: float, L: float, g: float, w: float) -> MinimalCoordinates:
    """Bead chain started along the x axis, the last bead moving along z with ``w`` [m/s]."""
    return coordinates(bead_chain(n, m, L, g), np.zeros(2 * n), np.append(np.zeros(n), np.full(n, w / L)))


def level_spring(k: float, m: Any, l: Any, g: float) -> MinimalCoordinates:  # noqa: E741
    """Stiff spring pendulum started at rest with both points on the x axis."""
    s0 = [0.0, 0.0] if k == math.inf else [0.0, 0.0, l[0]]
    return coordinates(stiff_spring_pendulum(k, m, l, g), s0, np.zeros(len(s0)))


def turning_crank(m: float, m_slider: float, l: float, g: float, angle: float, rate: float) -> MinimalCoordinates:  # noqa: E741
    """Slider crank started at the crank angle ``angle`` [rad] with ``rate`` [rad/s]."""
    return coordinates(slider_crank(m, m_slider, l, g), [angle], [rate])


def upright_bars(n: int, m: float, l: float, g: float, speed: float) -> MinimalCoordinates:  # noqa: E741
    """Four-bar windows started upright with B0 moving along x with ``speed`` [m/s]."""
    return coordinates(four_bars(n, m, l, g), [0.0], [speed / l])
