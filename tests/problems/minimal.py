"""Accelerations of a declared system, to set beside those in minimal coordinates."""

import jax
import jax.numpy as jnp
import numpy as np

from problems._minimal import second_along
from tests.lowering.xla import quickly


def measured(system):
    """(q, v) -> (vdot, lam, g, g_q v, g_q) from the KKT system of the acceleration level; one compilation."""
    g = lambda q: system.constraint(0.0, q)  # noqa: E731

    @quickly
    def measure(q, v):
        mass, rows = system.mass_matrix, jax.jacfwd(g)(q)
        mass = mass(0.0, q) if callable(mass) else jnp.diag(mass)
        matrix = jnp.block([[mass, rows.T], [rows, jnp.zeros((len(rows), len(rows)))]])
        x = jnp.linalg.solve(matrix, jnp.concatenate([system.force(0.0, q, v), -second_along(g, q, v)]))
        return x[: q.size], x[q.size :], g(q), rows @ v, rows

    return lambda q, v: [np.asarray(x) for x in measure(jnp.asarray(q, float), jnp.asarray(v, float))]
