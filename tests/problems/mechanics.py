"""Mechanics written a second time, for judging the problems: accelerations, reactions, differences in time."""

from functools import cache, partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.system import declared


@partial(jax.jit, static_argnums=0)
def whole(function, system, *arguments):
    """``function(system, *arguments)`` compiled as a whole, once for all parameters: not operation by operation."""
    return function(system, *arguments)


def _nothing(*_):
    return jnp.zeros(0)


def _g(system):
    return declared(system, "constraint") or _nothing


def _k(system):
    return declared(system, "velocity_constraint") or _nothing


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
        self.g = declared(system, "constraint") or (lambda *_: np.zeros(0))
        self.k = declared(system, "velocity_constraint") or (lambda *_: np.zeros(0))

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
        own = declared(self.system, "reaction")
        position = own(t, q, lam) if own else -self.position_rows(t, q).T @ lam
        return np.asarray(position) - self.velocity_rows(t, q, v).T @ mu

    def accelerations(self, t, q, v, *, redundant=False):
        """(vdot, lam, mu) of the default reaction from the KKT system; the shortest multipliers of ``redundant`` rows."""
        rows, bias, force = self._of(_acceleration_level, t, q, v)
        n, m = len(q), len(self.g(t, q))
        zero = np.zeros((len(rows), len(rows)))
        matrix = np.block([[self.mass(t, q), rows.T], [rows, zero]])
        right = np.concatenate([force, -bias])
        x = np.linalg.lstsq(matrix, right, rcond=1e-13)[0] if redundant else np.linalg.solve(matrix, right)
        np.testing.assert_allclose(matrix @ x, right, rtol=0, atol=1e-11 * (np.abs(right).max() + np.abs(x).max()))
        return x[:n], x[n : n + m], x[n + m :]


@cache
def _function(name):
    return lambda system, *arguments: getattr(system, name)(*arguments)


def compiled(system):
    """The same physics with each function compiled as a whole."""
    names = ("force", "constraint", "velocity_constraint", "mass_matrix", "reaction", "energy", "power", "invariants")
    parts = {name: part for name in names if (part := declared(system, name)) is not None}
    parts = {name: partial(whole, _function(name), system) if callable(f) else f for name, f in parts.items()}
    return SimpleNamespace(whole=system, **parts)


def measured(system):
    """(q, v) -> (vdot, lam, g, g_q v, g_q) at t = 0, to set beside those in minimal coordinates."""
    known = Mechanics(compiled(system))
    levels = lambda q, v: (known.g(0.0, q), known.position_rate(0.0, q, v), known.position_rows(0.0, q))  # noqa: E731
    return lambda q, v: [np.asarray(x) for x in (*known.accelerations(0.0, q, v)[:2], *levels(q, v))]


def shortest(rows, right, rank=None):
    """The shortest x with ``rows x = right``, rows beyond ``rank`` dependent but for roundoff and distance."""
    U, sizes, V = np.linalg.svd(rows, full_matrices=False)
    return V[:rank].T @ (U[:, :rank].T @ right / sizes[:rank])


def consistent_state(problem, system, seed, rank=None):
    """Random time, place near the start on the constraints and velocity that they admit."""
    random, n = np.random.default_rng(seed), problem.q0.size
    t = random.uniform(*problem.t_span)
    q = problem.q0 + 0.05 * problem.scales.q * random.standard_normal(n)
    for _ in range(9):  # Gauss-Newton onto the position constraints
        q = q - shortest(system.position_rows(t, q), np.asarray(system.g(t, q)), rank)
    v = problem.v0 + problem.scales.v * random.standard_normal(n)
    rows = np.vstack([system.position_rows(t, q), system.velocity_rows(t, q, v)])
    drift = np.concatenate([system.position_rate(t, q, v).ravel(), np.asarray(system.k(t, q, v)).ravel()])
    return t, q, v - shortest(rows, drift, rank)  # the constraints are linear in v


def time_derivative(f, t, h):
    """Central difference of order 8."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (f(t + i * h) - f(t - i * h)) for i, w in enumerate(weights, start=1)) / h
