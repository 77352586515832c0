"""Small scenes that the tests of this folder share: each is compiled or called by several of them."""

from collections import Counter

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.lowering.caching import Cache
from hhtbench.protocol.system import NumpySystem, System, parameter
from solvers.hht.run import engine_pool, functions

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


def forget_engines(monkeypatch):
    """Systems are prepared anew from here on, and what is prepared is forgotten after the test."""
    monkeypatch.setattr(functions, "_known", Cache(16))
    monkeypatch.setattr(engine_pool, "_pool", [])


STIFFNESS = np.array([[3e4, 1e4], [-2e4, 5e4]])  # not symmetric, so that its transpose is another matrix [1/s^2]
DAMPING = np.array([[3.0, 1.0], [-2.0, 5.0]])  # [1/s]
REST = np.array([0.6, -0.9])


def stiff_force(t, q, v):
    stretch = q - REST
    return -STIFFNESS @ (stretch + stretch**3) - DAMPING @ v


def wrong_jacobians(t, q, v):
    return STIFFNESS, np.zeros((2, 2))


class Shadow(System):
    """A pendulum and a coordinate without mass that follows it; its row of g_q changes its size along the motion."""

    mass_matrix: object = parameter((1.0, 1.0, 0.0))

    def force(self, t, q, v):
        return jnp.stack([0.0 * t, -GRAVITY + 0.0 * t, 0.0 * t])

    def constraint(self, t, q):
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2.0, q[2] - 3.0 * q[0] ** 2])


class Bead(System):
    """A particle on a turning ring, with a mass that depends on the place and a force that depends on time."""

    def mass_matrix(self, t, q):
        return jnp.eye(2) * (1.0 + 0.1 * q[0] ** 2)

    def force(self, t, q, v):
        return jnp.stack([jnp.sin(3.0 * t), -GRAVITY * (1.0 + 0.1 * q[0] ** 2)])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


class Ball(System):
    """A ball above a stiff floor, [m] and [1/s^2]."""

    k: object = parameter(1e8, doc="stiffness over mass [1/s^2]")

    def force(self, t, q, v):
        return -9.81 + self.k * jnp.maximum(-q, 0.0)

    def energy(self, t, q, v):
        return 9.81 * q[0] + v[0] ** 2 / 2 + self.k * jnp.maximum(-q[0], 0.0) ** 2 / 2


STEPPED = {
    "numpy": (SYSTEMS["numpy"], Q0, V0),
    "jax": (JAX_PENDULUM, Q0, V0),
    "variable mass": (Bead(), Q0, V0),
    "singular mass": (Shadow(), [*Q0, 3.0 * Q0[0] ** 2], [*V0, 6.0 * Q0[0] * V0[0]]),
    "wrong jacobian": (pendulum(force=stiff_force, force_jacobians=wrong_jacobians), Q0, V0),
}


def bits(state):
    return [np.asarray(x).tobytes() for x in (state.t, state.q, state.v, state.a, state.f, state.lam, state.mu, state.vdot)]
