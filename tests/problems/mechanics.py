"""Mechanics written a second time, for judging the problems: accelerations, reactions, differences in time."""

from functools import cache, partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from tests.lowering.xla import quickly


@partial(quickly, static_argnums=0)
def whole(function, system, *arguments):
    """``function(system, *arguments)`` compiled as a whole, once for all parameters: not operation by operation."""
    return function(system, *arguments)


def _nothing(*_):
    return jnp.zeros(0)


def _g(system):
    return getattr(system, "constraint", _nothing)


def _k(system):
    return getattr(system, "velocity_constraint", _nothing)


def _position_rows(system, t, q):
    return jax.jacfwd(_g(system), 1)(t, q).reshape(-1, q.size)


def _velocity_rows(system, t, q, v):
    return jax.jacfwd(_k(system), 2)(t, q, v).reshape(-1, q.size)


def _position_rate(system, t, q, v):
    return jax.jvp(_g(system), (t, q), (jnp.ones_like(t), v))[1]


def _bias(system, t, q, v):
    """What the second derivative of g and the first of k hold beside the accelerations."""
    rate = lambda s: _position_rate(system, t + s, q + s * v, v)  # noqa: E731
    velocity = lambda s: _k(system)(t + s, q + s * v, v)  # noqa: E731
    return jnp.concatenate([jax.jvp(f, (0.0,), (1.0,))[1].ravel() for f in (rate, velocity)])


def _acceleration_level(system, t, q, v):
    rows = jnp.vstack([_position_rows(system, t, q), _velocity_rows(system, t, q, v)])
    return rows, _bias(system, t, q, v), system.force(t, q, v)


class Mechanics:
    """Functions of a System by automatic differentiation, in NumPy; nothing of the solvers is used."""

    def __init__(self, system):
        self.system = system
        self.whole = getattr(system, "whole", system)
        self.g = getattr(system, "constraint", lambda *_: np.zeros(0))
        self.k = getattr(system, "velocity_constraint", lambda *_: np.zeros(0))

    def _of(self, function, t, *state):
        return jax.tree.map(np.asarray, whole(function, self.whole, np.float64(t), *map(np.asarray, state)))

    def mass(self, t, q):
        mass = getattr(self.system, "mass_matrix", 1.0)
        mass = np.asarray(mass(t, q) if callable(mass) else mass)
        return mass if mass.ndim == 2 else np.eye(len(q)) * mass

    def position_rows(self, t, q):
        return self._of(_position_rows, t, q)

    def velocity_rows(self, t, q, v):
        return self._of(_velocity_rows, t, q, v)

    def position_rate(self, t, q, v):
        """g_t + g_q v."""
        return self._of(_position_rate, t, q, v)

    def reaction(self, t, q, v, lam, mu):
        declared = getattr(self.system, "reaction", None)
        position = declared(t, q, lam) if declared else -self.position_rows(t, q).T @ lam
        return np.asarray(position) - self.velocity_rows(t, q, v).T @ mu

    def accelerations(self, t, q, v):
        """(vdot, lam, mu) of the default reaction from the KKT system of the acceleration level."""
        rows, bias, force = self._of(_acceleration_level, t, q, v)
        n, m = len(q), len(self.g(t, q))
        zero = np.zeros((len(rows), len(rows)))
        matrix = np.block([[self.mass(t, q), rows.T], [rows, zero]])
        x = np.linalg.solve(matrix, np.concatenate([force, -bias]))
        return x[:n], x[n : n + m], x[n + m :]


@cache
def _function(name):
    return lambda system, *arguments: getattr(system, name)(*arguments)


def compiled(system):
    """The same physics with each function compiled as a whole."""
    names = ("force", "constraint", "velocity_constraint", "mass_matrix", "reaction", "energy", "power", "invariants")
    parts = {name: getattr(system, name) for name in names if hasattr(system, name)}
    parts = {name: partial(whole, _function(name), system) if callable(f) else f for name, f in parts.items()}
    return SimpleNamespace(whole=system, **parts)


def random_state(problem, system, t):
    """A state near the start that satisfies the position constraints of both levels at ``t``."""
    random, n = np.random.default_rng(7), problem.q0.size
    q = problem.q0 + 0.05 * problem.scales.q * random.standard_normal(n)
    for _ in range(8):
        q = q - np.linalg.lstsq(system.position_rows(t, q), np.asarray(system.g(t, q)), rcond=None)[0]
    v = problem.v0 + 0.3 * problem.scales.v * random.standard_normal(n)
    return q, v - np.linalg.lstsq(system.position_rows(t, q), system.position_rate(t, q, v), rcond=None)[0]


def time_derivative(f, t, h):
    """Central difference of order 8."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (f(t + i * h) - f(t - i * h)) for i, w in enumerate(weights, start=1)) / h
