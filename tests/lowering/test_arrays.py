"""Arrays of nodes that are made at once, and the dependencies that are read off them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import arrays, pattern_along, store
from hhtbench.lowering.scalar_compiler.lower import lower
from tests.lowering.native import Nothing, native_value

SIZE = 3 * store.FEW
X = np.linspace(-2.0, 2.0, SIZE)
SOME = np.resize([0.0, 1.0, -1.0, 3.0, 0.25, -0.0], SIZE)  # what rules look at


def ruled(x):
    """Every rule of sums, products, quotients, signs and choices."""
    minus, masked = -x, jnp.where(SOME == 0.0, x, SOME)
    parts = [
        masked + x,
        masked - x,
        x - masked,
        masked * x,
        x / masked,
        masked / (x + 5.0),
        minus + x[::-1],
        x - minus[::-1],
    ]
    parts += [minus + minus[::-1], minus - x[::-1], minus * x[::-1], minus * minus[::-1], minus / (x[::-1] + 5.0), -minus]
    parts += [x[::-1] / (minus - 5.0), x**3, x**-2, jnp.where(x > 0.0, minus, masked), jnp.where(~(x > 0.0), x, 1.0)]
    return jnp.concatenate([*parts, jnp.abs(minus), jnp.maximum(x, masked), jnp.square(minus), jnp.sin(masked) * jnp.cos(x)])


def nodes_of(function):
    flat = flat_function(lambda d, x: function(x), Nothing())
    return lower("test", jitted(flat), np.zeros(0, dtype=np.int8), ((SIZE,),), 10**6).graph


def test_nodes_made_at_once_are_those_made_one_by_one(monkeypatch):
    at_once = nodes_of(ruled)
    for module in (arrays, store):
        monkeypatch.setattr(module, "FEW", 10**9)
    alone = nodes_of(ruled)
    assert len(at_once.code) == len(alone.code)
    assert np.array_equal(np.bincount(at_once.column("code")), np.bincount(alone.column("code")))


def test_values_of_nodes_made_at_once_are_those_of_jax():
    value, _ = native_value(lambda d, x: ruled(x), X)
    np.testing.assert_allclose(value, jax.jit(ruled)(X), rtol=1e-14)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jnp.where(SOME == 0.0, 0.0 * x, SOME * x) / (x[::-1] + 9.0),
        lambda x: jnp.floor(jnp.roll(x, 3)) * x + jnp.where(jnp.roll(x, 5) > 0.0, x, jnp.roll(x, 1)),  # jumps carry nothing
        lambda x: jnp.linalg.solve(x[:4].reshape(2, 2) + 3.0 * jnp.eye(2), x[4:6]),
        lambda x: jnp.zeros(SIZE).at[np.arange(SIZE) // 3].add(jnp.sin(x)),
        lambda x: jnp.cumsum(x[:20]),
    ],
)
def test_entries_of_a_derivative_are_where_it_depends(function):
    """Against the derivative by JAX at so many places that every entry differs from zero at one of them."""
    flat = flat_function(lambda d, x: function(x), Nothing())
    shape, rows, columns = pattern_along(flat, ((SIZE,),))
    found = np.zeros(shape, dtype=bool)
    found[rows, columns] = True
    places = np.random.default_rng(1).normal(size=(40, SIZE))
    expected = np.any(np.asarray(jax.vmap(jax.jacfwd(function))(places)) != 0.0, axis=0)
    np.testing.assert_array_equal(found, expected)
    assert np.all(np.diff(rows * shape[1] + columns) > 0)
