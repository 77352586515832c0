"""Small scenes that the tests of this folder share: each is compiled or called by several of them."""

from collections import Counter

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.lowering import flattening
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.compile import compiling
from hhtbench.lowering.scalar_compiler import compiler
from hhtbench.protocol import NumpySystem, System, parameter
from solvers.hht.run import functions, idle

GRAVITY = 9.81
ANGLE, SPEED = 1.0, 0.5  # of the pendulum at the start [rad, rad/s], counted from the lowest point
Q0 = np.array([np.sin(ANGLE), -np.cos(ANGLE)])
V0 = SPEED * np.array([np.cos(ANGLE), np.sin(ANGLE)])
ALPHAS = (0.0, -0.3)


def gravity(t, q, v):
    return np.array([0.0, -GRAVITY])


def zero_jacobians(t, q, v):
    return np.zeros((2, 2)), np.zeros((2, 2))


def circle(t, q):
    return np.array([(q @ q - 1.0) / 2.0])


def circle_jacobian(t, q):
    return np.array([[q[0], q[1]]])


def unit_mass(t, q):
    return np.eye(2)


PENDULUM = {
    "force": gravity,
    "force_jacobians": zero_jacobians,
    "constraint": circle,
    "constraint_jacobian": circle_jacobian,
}


def pendulum(**changes):
    """The unit pendulum in Cartesian coordinates as plain callables, some of them replaced."""
    return NumpySystem(**{**PENDULUM, **changes})


class Pendulum(System):
    """The same in JAX."""

    def force(self, t, q, v):
        return jnp.array([0.0, -GRAVITY])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


JAX_PENDULUM = Pendulum()
SYSTEMS = {"numpy": pendulum(), "jax": JAX_PENDULUM}


class Spring(System):
    """A free particle on a spring whose declared Jacobian is scaled by ``claim``; [1/s^2], [1/s], [1]."""

    stiffness: object = parameter(1e5)
    damping: object = parameter(1.0)
    claim: object = parameter(1.0)

    def force(self, t, q, v):
        return -self.stiffness * jnp.sin(q) - self.damping * v

    def force_jacobians(self, t, q, v):
        eye = jnp.eye(q.size)
        return -self.claim * self.stiffness * jnp.cos(q) * eye, -self.claim * self.damping * eye


def pendulum_at(t, angle=ANGLE, speed=SPEED):
    """Position and velocity (k, 2) of the unit pendulum at times ``t`` (k,) from its angle's equation."""
    t = np.atleast_1d(t)
    rate = lambda _, y: [y[1], -GRAVITY * np.sin(y[0])]  # noqa: E731
    motion = solve_ivp(rate, (0.0, t[-1]), [angle, speed], "DOP853", t_eval=t, rtol=1e-13, atol=1e-13)
    phi, omega = motion.y
    return np.stack([np.sin(phi), -np.cos(phi)], 1), omega[:, None] * np.stack([np.cos(phi), np.sin(phi)], 1)


def tension_at(q, v):
    """Multiplier (k,) of the unit pendulum's constraint from the radial balance of forces."""
    return np.sum(v * v, axis=-1) - GRAVITY * q[..., 1]


class Calls:
    """Wraps the functions of a scene: counts them by name, keeps nothing of theirs."""

    def __init__(self):
        self.count = Counter()

    def wrap(self, functions):
        return {name: self._counted(name, function) for name, function in functions.items()}

    def _counted(self, name, function):
        def call(*arguments):
            self.count[name] += 1
            return function(*arguments)

        return call


def same_bits(first, second):
    """Whether two solutions hold the same numbers, bit by bit."""
    names = ("t", "q", "v", "lam", "mu")
    return all(getattr(first, name).tobytes() == getattr(second, name).tobytes() for name in names)


def forget_code(monkeypatch):
    """For a test that changes a formula: it is traced anew here, and what was made of it is forgotten afterwards."""
    kept = (
        (functions, "_known"),
        (compiling, "_callables"),
        (compiler, "_memory"),
        (compiler, "_last"),
        (flattening, "_jitted"),
    )
    for module, name in kept:
        monkeypatch.setattr(module, name, Cache(100))
    monkeypatch.setattr(idle, "_idle", [])
