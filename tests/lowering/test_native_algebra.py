"""The native route: solves, inverses and factors against JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering.compile.banded import solve_banded
from hhtbench.lowering.compile.inverse import inverse
from tests.lowering.native import agree, native_value

X = np.array([0.3, -1.2, 2.0, 0.7])


def spread(x):
    """A regular matrix with a zero in the first pivot's place."""
    return jnp.outer(x, jnp.cos(x)) + jnp.diag(x**2) * (1 - np.eye(4)[0]) + jnp.eye(4)[::-1]


ALGEBRA = {
    "solve": lambda x: jnp.linalg.solve(spread(x), x),
    "solve for many": lambda x: jnp.linalg.solve(spread(x), jnp.stack([x, jnp.ones(4)], axis=1)),
    "inv": lambda x: jnp.linalg.inv(spread(x)),
    "inverse": lambda x: inverse(spread(x)),
    "batch of inverses": lambda x: inverse(jnp.stack([spread(x), jnp.diag(x)])),
    "derivative of the inverse": lambda x: jax.jacfwd(lambda y: inverse(spread(y)) @ y)(x),
    "derivative of the solve": lambda x: jax.jacfwd(lambda y: jnp.linalg.solve(spread(y), y))(x),
    "reverse": lambda x: jax.grad(lambda y: jnp.linalg.solve(spread(y), y).sum() + inverse(spread(y)).sum())(x),
}


@pytest.mark.parametrize("family", [list(ALGEBRA)[:5], list(ALGEBRA)[5:]], ids=["values", "derivatives"])
def test_linear_algebra_is_that_of_jax(family):
    agree(lambda x: jnp.concatenate([ALGEBRA[name](x).ravel() for name in family]), X, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev, jax.vmap, lambda f: jax.vmap(f, in_axes=2, out_axes=1)])
def test_the_inverse_is_that_of_jax_under_every_transformation(transform):
    batch = jnp.stack([spread(jnp.asarray(X)) + i * jnp.eye(4) for i in range(4)], axis=2)
    batch = batch[:, :, 0] if transform in (jax.jacfwd, jax.jacrev) else batch
    np.testing.assert_allclose(transform(inverse)(batch), transform(jnp.linalg.inv)(batch), rtol=1e-9, atol=1e-11)


def test_the_inverse_of_a_singular_matrix_is_not_finite():
    value, _ = native_value(lambda d, x: inverse(jnp.outer(x, x)), np.array([1.0, 2.0]))
    assert not np.isfinite(value).all()
    value, _ = native_value(lambda d, x: inverse(jnp.diag(x)), np.array([1.0, 0.0]))
    assert not np.isfinite(value).all()
    value, _ = native_value(lambda d, x: inverse(x.reshape(2, 2)), np.array([np.nan, 1.0, 2.0, 1.0]))
    assert np.isnan(value).all()


def test_the_inverse_has_large_pivots():
    """Without exchange of rows the first entry, 1e-20, would leave no digit."""
    value, _ = native_value(lambda d, x: inverse(x), np.array([[1e-20, 1.0], [1.0, 1.0]]))
    np.testing.assert_allclose(value, [[-1.0, 1.0], [1.0, 0.0]], atol=1e-15)


def test_the_inverse_of_bodies_that_do_not_meet_is_taken_body_by_body():
    lots = np.random.default_rng(0)
    order, parts = lots.permutation(6), [lots.standard_normal((k, k)) + 3 * np.eye(k) for k in (3, 2, 1)]
    at = [order[:3], order[3:5], order[5:]]

    def scattered(dynamics, *blocks):
        full = jnp.zeros((6, 6))
        for place, block in zip(at, blocks, strict=True):
            full = full.at[np.ix_(place, place)].set(block)
        return inverse(full)

    value, code = native_value(scattered, *parts)
    full = np.zeros((6, 6))
    for place, block in zip(at, parts, strict=True):
        full[np.ix_(place, place)] = block
    np.testing.assert_allclose(value, np.linalg.inv(full), rtol=1e-12, atol=1e-13)
    assert code.varying.size == 9 + 4 + 1  # the others are zero by structure
    np.testing.assert_array_equal(value[np.abs(np.linalg.inv(full)) < 1e-14], 0.0)
    assert code.operations < 6 * 6 * 2  # one matrix of six


LOWER = np.tril(np.cos(np.arange(25.0)).reshape(5, 5)) + 2.0 * np.eye(5)


def rows_of(lower, width):
    padded = np.hstack([np.zeros((len(lower), width)), lower])
    rows = np.array([padded[i, i : i + width + 1] for i in range(len(lower))])
    rows[:, -1] = 1.0 / rows[:, -1]
    return rows


@pytest.mark.parametrize("width", [0, 1, 2, 3, 7])
def test_a_solve_with_a_band_is_that_with_the_full_matrix(width):
    lower = np.tril(np.triu(LOWER, -width))
    right = np.array([0.3, -1.2, 2.0, 0.7, 5.0])
    code = agree(solve_banded, rows_of(lower, width), right, rtol=1e-13)
    value = native_value(lambda d, *x: solve_banded(*x), rows_of(lower, width), right)[0]
    np.testing.assert_allclose(value, np.linalg.solve(lower @ lower.T, right), rtol=1e-12)
    assert code.varying.size == 5


def test_derivative_and_batches_of_a_solve_with_a_band_are_those_of_the_full_matrix():
    rows, matrix = jnp.asarray(rows_of(LOWER, 4)), LOWER @ LOWER.T
    by_right = jax.jacfwd(lambda x: solve_banded(rows, x))(jnp.ones(5))
    np.testing.assert_allclose(by_right, np.linalg.inv(matrix), rtol=1e-12, atol=1e-14)
    batch = jax.vmap(lambda x: solve_banded(rows, x), in_axes=1, out_axes=1)(jnp.asarray(LOWER))
    np.testing.assert_allclose(batch, np.linalg.solve(matrix, LOWER), rtol=1e-12, atol=1e-14)
