"""Native code and XLA side by side, for functions of plain arrays."""

from unittest import mock

import equinox as eqx
import jax
import numpy as np

from hhtbench.lowering import flattening, native
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.scalar_compiler import compiler, native_call


class Nothing(eqx.Module):
    """A dynamics without parameters."""


class Holding(eqx.Module):
    """A dynamics with one array of parameters."""

    values: jax.Array


def native_pieces():
    """How many functions this process has as machine code, or knows it cannot have."""
    return len(compiler._memory.values())


def compiled_pieces():
    """How many pieces of code this process has compiled or loaded: it stays the same where nothing new is compiled."""
    return native_pieces() + sum(jitted._cache_size() for jitted in flattening._jitted.values())


def shapes_of(arrays):
    return tuple(np.shape(array) for array in arrays)


def native_value(function, *arrays, dynamics=Nothing()):  # noqa: B008 - it holds nothing
    """``function(dynamics, *arrays)`` by machine code, and the code; in loops it gives the same bits."""
    shapes = shapes_of(arrays)
    code = native(function, dynamics, shapes=shapes)
    value = native_call(code, shapes)(*arrays)
    np.testing.assert_array_equal(native_call(in_loops(function, dynamics, shapes=shapes), shapes)(*arrays), value)
    return value, code


def in_loops(function, dynamics, *static, **how):
    """Machine code in loops, however few the operations are."""
    with mock.patch.multiple(compiler, IN_LOOPS=-1, _memory=Cache(1)):
        return native(function, dynamics, *static, **how)


def agree(function, *arrays, rtol=1e-14, atol=0.0):
    """Machine code and XLA give the same numbers, NaN and infinities included."""
    arrays = [np.asarray(array, dtype=float) for array in arrays]
    value, code = native_value(lambda dynamics, *x: function(*x), *arrays)
    expected = np.asarray(jax.jit(function)(*arrays))
    assert value.shape == expected.shape
    np.testing.assert_allclose(value, expected, rtol=rtol, atol=atol)
    return code
