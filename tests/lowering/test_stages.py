"""Code in two stages, and parts of a result that share the first."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import native
from hhtbench.lowering.scalar_compiler import native_call
from tests.lowering.native import Nothing, native_value

SHAPES = (3,), (2,), (4,)
X, Y, KNOWN = np.array([0.3, -1.2, 2.0]), np.array([0.7, -0.4]), np.array([1.5, -0.2, 0.8, 2.5])
NOTHING = Nothing()


def whole(dynamics, x, y, known):
    """What ``known`` alone gives is costly; x and y come many times."""
    costly = jnp.sin(known) / (1.0 + known**2)
    return jnp.concatenate([x * costly[:3], y + jnp.exp(costly[2:]), costly, x[:2] * y])


def stage(name, *arrays, rows=None):
    """The value of a stage, and its code; a late one takes the early one's result as its last argument."""
    code = native(whole, NOTHING, shapes=SHAPES, stage=name, rows=rows)
    return native_call(code, tuple(array.shape for array in arrays))(*arrays), code


def test_what_the_last_argument_gives_is_computed_before_and_needs_no_other():
    expected, one = native_value(whole, X, Y, KNOWN)
    early, first = stage("early", np.full(3, np.nan), np.full(2, np.nan), KNOWN)
    assert np.isfinite(early).all()
    late, second = stage("late", X, Y, np.full(4, np.nan), early)
    np.testing.assert_array_equal(late, expected)
    assert second.operations == 3 + 2 + 2  # the products and sums with x and y
    assert first.operations + second.operations == one.operations


@pytest.mark.parametrize("rows", [(0, 3), (3, 9), (9, 11)])
def test_parts_of_a_result_share_what_was_computed_before(rows):
    expected, _ = native_value(whole, X, Y, KNOWN)
    early, _ = stage("early", X, Y, KNOWN)
    late, code = stage("late", X, Y, KNOWN, early, rows=rows)
    np.testing.assert_array_equal(late, expected[slice(*rows)])
    assert code.size == rows[1] - rows[0]
    assert code.operations < 7
