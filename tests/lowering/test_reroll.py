"""Loop rerolling: what is one loop, and values from every kind of place.  Every other test of machine code runs it too."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from hhtbench.lowering import derive
from hhtbench.lowering.dynamics.foreign import foreign
from hhtbench.lowering.dynamics.kkt_rows import kkt_terms
from hhtbench.lowering.scalar_compiler import native_call
from tests.hht.scenes import Q0, V0, pendulum
from tests.lowering.native import Nothing, agree, in_loops, native_value

X = np.linspace(-1.0, 2.0, 30)


def operations(function, size):
    return in_loops(lambda d, x: function(x), Nothing(), shapes=((size,),)).operations


def chain(x):
    """Springs between neighbours: an expression for the inner ones and one for each end."""
    stretch = jnp.diff(x)
    tension = jnp.sin(stretch) * stretch
    return jnp.concatenate([tension, jnp.zeros(1)]) - jnp.concatenate([jnp.zeros(1), tension])


def test_the_code_of_a_thousand_bodies_is_that_of_ten():
    assert operations(chain, 1000) == operations(chain, 10)
    assert operations(chain, 1000) < 12


@pytest.mark.parametrize(
    "function",
    [
        chain,
        lambda x: x * np.arange(30.0) ** 2,  # constants that differ from turn to turn
        lambda x: x[np.arange(30) ** 3 % 29] + x[::-1],  # places from a table
        lambda x: jnp.where(x > 0.5, x, 1.0) * jnp.where(x > 0.5, 2.0, x) + jnp.where(~(x > 0.5), x, 3.0),  # a shared truth
        lambda x: jnp.cumsum(jnp.sin(x)),  # each waits for the one before
        lambda x: jnp.concatenate([x, x, jnp.array([1.0, 0.0])]),  # one number in two places, and constants
        lambda x: lax.fori_loop(0, 5, lambda i, y: jnp.cos(y) * x, x),
        lambda x: jnp.full(3, x.sum()),
    ],
)
def test_numbers_come_from_where_they_are(function):
    agree(function, X, rtol=1e-13, atol=1e-15)


def test_every_body_solves_its_own_equations():
    """Six systems of equations with two right-hand sides are the turns of one loop."""
    matrices = X[:24].reshape(6, 2, 2) + 3.0 * np.eye(2)
    rights = np.cos(np.arange(24.0)).reshape(6, 2, 2)
    value, _ = native_value(lambda d, a, b: jnp.linalg.solve(a, b), matrices, rights)
    np.testing.assert_allclose(value, np.linalg.solve(matrices, rights), rtol=1e-13)


def test_functions_in_python_are_called_from_loops_too():
    dynamics = derive(pendulum(), 0.0, Q0, V0)
    shapes, arguments = ((), (2,), (2,), (3,)), (0.5, Q0 + 0.1, V0, np.ones(3))
    looped = native_call(in_loops(kkt_terms, foreign(dynamics), shapes=shapes), shapes)
    np.testing.assert_allclose(looped(*arguments), kkt_terms(dynamics, *arguments), rtol=1e-14)
