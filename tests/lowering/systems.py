"""Small systems written once for both routes: every formula takes the array namespace as its first argument."""

import functools

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.system import NumpySystem, System, parameter


def rich_mass(xp, t, q):
    off = 0.3 * xp.sin(q[2])
    return xp.array(
        [[2 + xp.cos(q[1]), off, 0.0 * t], [off, 3 + 0.0 * t, 0.2 + 0.0 * t], [0.0 * t, 0.2 + 0.0 * t, 2.5 + 0.1 * t]]
    )


def rich_force(xp, t, q, v, stiffness=2.0):
    return xp.stack(
        [-stiffness * q[0] + 0.1 * v[1] * v[2] + xp.sin(t), -(q[1] ** 3) - 0.2 * v[1], -0.5 * q[2] - 0.1 * v[0] * v[2]]
    )


def rich_constraint(xp, t, q):
    return xp.stack([q[0] ** 2 + q[1] + 0.3 * xp.sin(q[2]) - 0.2 * xp.sin(3 * t) * q[0]])


def rich_velocity_constraint(xp, t, q, v):
    return xp.stack([v[2] + 0.2 * v[0] * v[1] - 0.5 * xp.cos(q[0] + t)])


def rich_reaction(xp, t, q, lam):
    return -xp.stack([2 * q[0] * lam[0] + 0.1 * lam[0] ** 2, (1 + 0.1 * q[1]) * lam[0], 0.3 * xp.cos(q[2]) * lam[0]])


class Rich(System):
    """Variable mass, rheonomic constraint, reaction nonlinear in lam, velocity constraint nonlinear in v; n = 3."""

    stiffness: Array = parameter(2.0, doc="stiffness [N/m]")

    def force(self, t, q, v):
        return rich_force(jnp, t, q, v, self.stiffness)

    def mass_matrix(self, t, q):
        return rich_mass(jnp, t, q)

    def constraint(self, t, q):
        return rich_constraint(jnp, t, q)

    def velocity_constraint(self, t, q, v):
        return rich_velocity_constraint(jnp, t, q, v)

    def reaction(self, t, q, lam):
        return rich_reaction(jnp, t, q, lam)


def on_numpy(function):
    """``function`` on NumPy arrays, which takes by name what it took after them."""
    return functools.partial(function, np)


RICH_NUMPY = NumpySystem(
    force=on_numpy(rich_force),
    mass_matrix=on_numpy(rich_mass),
    constraint=on_numpy(rich_constraint),
    velocity_constraint=on_numpy(rich_velocity_constraint),
    reaction=on_numpy(rich_reaction),
)


def circle(xp, t, q):
    return xp.stack([(q[0] ** 2 + q[1] ** 2 - 1) / 2])


def dry_friction(xp, t, q, v, lam):
    """Normal to the circle, and against v in proportion to the size of that: 0.3 of it, less where v is small."""
    return -q * lam[0] - 0.3 * xp.sqrt(lam[0] ** 2 + 1e-3) * v / xp.sqrt(v[0] ** 2 + v[1] ** 2 + 1e-2)


WEIGHT = np.array([0.0, -9.81])


class Pendulum(System):
    """Constant mass, constant force, scleronomic constraint, default reaction; n = 2, m = 1."""

    mass_matrix: Array = parameter(1.0, doc="mass [kg]")

    def force(self, t, q, v):
        return self.mass_matrix * jnp.asarray(WEIGHT)

    def constraint(self, t, q):
        return circle(jnp, t, q)


class Dragging(Pendulum):
    """The same with a reaction that depends on v and is linear in lam."""

    def reaction(self, t, q, v, lam):
        return -lam[0] * (q + 0.3 * v / jnp.sqrt(v @ v + 1e-2))


class Rubbing(Pendulum):
    """The same as a bead on a wire, with friction: a reaction that depends on v, and on lam not linearly."""

    def reaction(self, t, q, v, lam):
        return dry_friction(jnp, t, q, v, lam)


RUBBING_NUMPY = NumpySystem(
    mass_matrix=1.0, force=lambda t, q, v: WEIGHT, constraint=on_numpy(circle), reaction=on_numpy(dry_friction)
)
PENDULUM_NUMPY = NumpySystem(mass_matrix=1.0, force=lambda t, q, v: WEIGHT, constraint=on_numpy(circle))


def coupled_springs(xp, t, q, v):
    return xp.stack([-3 * q[0] + q[1] ** 2, q[0] - 2 * xp.sin(q[1])])


class Springs(System):
    """No constraints, unit mass, force of q alone; n = 2."""

    def force(self, t, q, v):
        return coupled_springs(jnp, t, q, v)


SPRINGS_NUMPY = NumpySystem(force=on_numpy(coupled_springs))


def slider(xp, t, q):
    """The third coordinate has no mass: it follows the other two."""
    return xp.stack([(q[0] ** 2 + q[1] ** 2 - 1) / 2, q[2] - q[0] * q[1]])


def slider_force(xp, t, q, v):
    return xp.stack([0.3 * v[1] + 0.0 * t, -9.81 - q[0], 2.0 - v[2]])


class Massless(System):
    """Singular mass, regular KKT matrix, position constraints; n = 3, m = 2."""

    mass_matrix: Array = parameter((1.0, 2.0, 0.0), doc="masses [kg]")

    def force(self, t, q, v):
        return slider_force(jnp, t, q, v)

    def constraint(self, t, q):
        return slider(jnp, t, q)


MASSLESS_NUMPY = NumpySystem(
    mass_matrix=np.array([1.0, 2.0, 0.0]), force=on_numpy(slider_force), constraint=on_numpy(slider)
)


def rolling(xp, t, q, v):
    return xp.stack([v[2] - xp.sin(q[0]) * v[0] - 0.5 * v[1] - t])


class MasslessWheel(System):
    """Singular mass made regular by a velocity constraint linear in v; n = 3, p = 1."""

    mass_matrix: Array = parameter((1.0, 2.0, 0.0), doc="masses [kg]")

    def force(self, t, q, v):
        return slider_force(jnp, t, q, v)

    def velocity_constraint(self, t, q, v):
        return rolling(jnp, t, q, v)


WHEEL_NUMPY = NumpySystem(
    mass_matrix=np.array([1.0, 2.0, 0.0]), force=on_numpy(slider_force), velocity_constraint=on_numpy(rolling)
)
