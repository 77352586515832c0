"""Mechanics written a second time, for judging the problems: accelerations, reactions, differences in time."""

from types import SimpleNamespace

import jax
import numpy as np


class Mechanics:
    """Functions of a System by automatic differentiation, in NumPy; nothing of the solvers is used."""

    def __init__(self, system):
        self.system = system
        n_zero = lambda *a: np.zeros(0)  # noqa: E731
        self.g = getattr(system, "constraint", n_zero)
        self.k = getattr(system, "velocity_constraint", n_zero)

    def mass(self, t, q):
        mass = getattr(self.system, "mass_matrix", 1.0)
        mass = np.asarray(mass(t, q) if callable(mass) else mass)
        return mass if mass.ndim == 2 else np.eye(len(q)) * mass

    def position_rows(self, t, q):
        return np.asarray(jax.jacfwd(self.g, 1)(t, q)).reshape(-1, len(q))

    def velocity_rows(self, t, q, v):
        return np.asarray(jax.jacfwd(self.k, 2)(t, q, v)).reshape(-1, len(q))

    def position_rate(self, t, q, v):
        """g_t + g_q v."""
        return np.asarray(jax.jvp(self.g, (t, q), (1.0, v))[1])

    def reaction(self, t, q, v, lam, mu):
        declared = getattr(self.system, "reaction", None)
        position = declared(t, q, lam) if declared else -self.position_rows(t, q).T @ lam
        return np.asarray(position) - self.velocity_rows(t, q, v).T @ mu

    def accelerations(self, t, q, v):
        """(vdot, lam, mu) of the default reaction from the KKT system of the acceleration level."""
        n, m = len(q), len(self.g(t, q))
        rate = lambda s: jax.jvp(self.g, (t + s, q + s * v), (1.0, v))[1]  # noqa: E731
        velocity = lambda s: self.k(t + s, q + s * v, v)  # noqa: E731
        rows = np.vstack([self.position_rows(t, q), self.velocity_rows(t, q, v)])
        bias = [np.asarray(jax.jvp(f, (0.0,), (1.0,))[1]).ravel() for f in (rate, velocity)]
        zero = np.zeros((len(rows), len(rows)))
        matrix = np.block([[self.mass(t, q), rows.T], [rows, zero]])
        x = np.linalg.solve(matrix, np.concatenate([self.system.force(t, q, v), -np.concatenate(bias)]))
        return x[:n], x[n : n + m], x[n + m :]


def compiled(system):
    """The same physics with each function compiled as a whole: quicker than operation by operation."""
    names = ("force", "constraint", "velocity_constraint", "mass_matrix", "reaction", "energy", "power", "invariants")
    parts = {name: getattr(system, name) for name in names if hasattr(system, name)}
    return SimpleNamespace(**{k: jax.jit(lambda *a, f=f: f(*a)) if callable(f) else f for k, f in parts.items()})


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
