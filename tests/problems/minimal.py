"""Chains and mechanisms as mass points moved by minimal coordinates."""

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

ROD = np.array([1.0, 4.0, 1.0]) / 6  # a uniform rod moves like these shares of its mass at begin, middle and end


@dataclass(frozen=True, eq=False)
class Minimal:
    """A mechanism as mass points moved by minimal coordinates s: nothing of the declared system is used."""

    embed: Any  #: s -> q
    points: Any  #: s -> (P, d) [m]
    masses: Any  #: (P,) [kg]
    g: float
    spring: Any = lambda s: 0.0  #: s -> potential [J]

    def accelerations(self, s, u):
        """s'' by Lagrange's equations."""
        rows = jax.jacfwd(self.points)(s)
        bias = second_along(self.points, s, u)
        mass = jnp.einsum("pdi,p,pdj->ij", rows, self.masses, rows)
        height = lambda s: self.g * self.masses @ self.points(s)[:, 1] + self.spring(s)  # noqa: E731
        right = -jax.grad(height)(s) - jnp.einsum("pdi,p,pd->i", rows, self.masses, bias)
        return jnp.linalg.solve(mass, right)


def second_along(f, s, u):
    return jax.jvp(lambda x: jax.jvp(f, (x,), (u,))[1], (s,), (u,))[1]


def direction(angle):
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


def on_rods(begins, ends):
    return jnp.concatenate([begins, (begins + ends) / 2, ends])


def rod_masses(masses):
    return jnp.outer(ROD, jnp.asarray(masses)).ravel()


def planar_chain(n, m, L, g):
    def ends(s):
        return jnp.cumsum(L / n * direction(s), axis=0)

    def begins(s):
        return ends(s) - L / n * direction(s)

    embed = lambda s: jnp.column_stack([(begins(s) + ends(s)) / 2, s]).ravel()  # noqa: E731
    return Minimal(embed, lambda s: on_rods(begins(s), ends(s)), rod_masses([m / n] * n), g)


def bead_chain(n, m, L, g):
    """s: elevations, then azimuths of the links."""

    def beads(s):
        up, around = s[:n], s[n:]
        links = jnp.stack([jnp.cos(up) * jnp.cos(around), jnp.sin(up), jnp.cos(up) * jnp.sin(around)], axis=1)
        return jnp.cumsum(L / n * links, axis=0)

    return Minimal(lambda s: beads(s).ravel(), beads, jnp.full(n, m / n), g)


def stiff_spring_pendulum(k, m, l, g):  # noqa: E741
    """s: both angles, and the length of the spring where there is one."""

    def points(s):
        first = (l[0] if k == math.inf else s[2]) * direction(s[0])
        return jnp.stack([first, first + l[1] * direction(s[1])])

    spring = (lambda s: 0.0) if k == math.inf else (lambda s: k * (s[2] - l[0]) ** 2 / 2)
    return Minimal(lambda s: points(s).ravel(), points, jnp.asarray(m), g, spring)


def slider_crank(m, m_slider, l, g):  # noqa: E741
    def points(s):
        joint, slider = l * direction(s), 2 * l * direction(s) * jnp.array([1.0, 0.0])
        return jnp.concatenate([on_rods(jnp.zeros((1, 2)), joint), on_rods(joint, slider), slider])

    embed = lambda s: jnp.concatenate([s, -s, 2 * l * jnp.cos(s)])  # noqa: E731
    return Minimal(embed, points, jnp.append(jnp.tile(ROD * m, 2), m_slider), g)


def four_bars(n, m, l, g):  # noqa: E741
    ground = l * jnp.column_stack([jnp.arange(n + 1.0), jnp.zeros(n + 1)])

    def bars(s):
        top = ground + l * jnp.stack([jnp.sin(s[0]), jnp.cos(s[0])])
        return jnp.concatenate([ground, top[:-1]]), jnp.concatenate([top, top[1:]])

    def embed(s):
        angles = jnp.concatenate([jnp.full(n + 1, math.pi / 2) - s[0], jnp.zeros(n)])
        return jnp.column_stack([sum(bars(s)) / 2, angles]).ravel()

    return Minimal(embed, lambda s: on_rods(*bars(s)), rod_masses([m] * (2 * n + 1)), g)


def measured(system):
    """(q, v) -> (vdot, lam, g, g_q v, g_q) from the KKT system of the acceleration level; one compilation."""
    g = lambda q: system.constraint(0.0, q)  # noqa: E731

    @jax.jit
    def measure(q, v):
        mass, rows = system.mass_matrix, jax.jacfwd(g)(q)
        mass = mass(0.0, q) if callable(mass) else jnp.diag(mass)
        matrix = jnp.block([[mass, rows.T], [rows, jnp.zeros((len(rows), len(rows)))]])
        x = jnp.linalg.solve(matrix, jnp.concatenate([system.force(0.0, q, v), -second_along(g, q, v)]))
        return x[: q.size], x[q.size :], g(q), rows @ v, rows

    return lambda q, v: [np.asarray(x) for x in measure(jnp.asarray(q, float), jnp.asarray(v, float))]
