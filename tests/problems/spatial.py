"""Constraint rows, accelerations and consistent states of the spatial problems, by automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np

from tests.lowering.xla import quickly

NAMES = ("heavy_top", "rolling_sphere_table", "bricard", "flyball_governor")


RANKS = {"heavy_top": 4, "rolling_sphere_table": 3, "bricard": 34, "flyball_governor": 24}


def velocity_constraint(system, q, v):
    """Values of k, (p,); p may be 0."""
    return system.velocity_constraint(0.0, q, v) if hasattr(system, "velocity_constraint") else jnp.zeros(0)


def _rows_and_values(system, q, v):
    """Constraint rows (m + p, n) and values of g, of g_q v and of k."""
    g = lambda q: system.constraint(0.0, q)  # noqa: E731
    rows = [jax.jacfwd(g)(q), jax.jacfwd(velocity_constraint, 2)(system, q, v)]
    return jnp.concatenate(rows), g(q), rows[0] @ v, velocity_constraint(system, q, v)


rows_and_values = quickly(_rows_and_values)


@quickly
def acceleration_level(system, q, v):
    """Matrix and right side for (vdot, lam, mu), and mass."""
    mass = system.mass_matrix
    mass = mass(0.0, q) if callable(mass) else jnp.diag(mass)

    def rates(q):
        return jnp.concatenate(
            [jax.jvp(lambda x: system.constraint(0.0, x), (q,), (v,))[1], velocity_constraint(system, q, v)]
        )

    rows = _rows_and_values(system, q, v)[0]
    matrix = jnp.block([[mass, rows.T], [rows, jnp.zeros((len(rows), len(rows)))]])
    return matrix, jnp.concatenate([system.force(0.0, q, v), -jax.jvp(rates, (q,), (v,))[1]]), mass


def accelerations(problem, q, v):
    """(vdot, lam, mu); the shortest multipliers where they are not unique."""
    matrix, right, _ = map(np.asarray, acceleration_level(problem.system, q, v))
    x = np.linalg.lstsq(matrix, right, rcond=1e-13)[0] if "redundant" in problem.tags else np.linalg.solve(matrix, right)
    np.testing.assert_allclose(matrix @ x, right, rtol=0, atol=1e-11 * (np.abs(right).max() + np.abs(x).max()))
    n, m = q.size, problem.system.constraint(0.0, q).size
    return x[:n], x[n : n + m], x[n + m :]


def shortest(rows, right, rank):
    """The shortest x with ``rows x = right``, rows beyond ``rank`` dependent but for roundoff and distance."""
    U, sizes, V = np.linalg.svd(rows, full_matrices=False)
    return V[:rank].T @ (U[:, :rank].T @ right / sizes[:rank])


def consistent_states(problem, number=2):
    """Random states near the start that satisfy the constraints on both levels."""
    random, rank = np.random.default_rng(5), RANKS[problem.name]
    for _ in range(number):
        q = problem.q0 + 0.1 * random.standard_normal(problem.q0.size)
        for _ in range(8):
            rows, g, _, _ = map(np.asarray, rows_and_values(problem.system, q, problem.v0))
            q = q - shortest(rows[: g.size], g, min(rank, g.size))
        v = problem.v0 + random.standard_normal(q.size)
        rows, g, gdot, k = map(np.asarray, rows_and_values(problem.system, q, v))
        assert np.abs(g).max() < 1e-14
        yield q, v - shortest(rows, np.concatenate([gdot, k]), rank)
