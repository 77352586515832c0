"""The native route: every primitive against JAX, and what the scalar graph leaves out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from hhtbench.lowering import NotNative, native
from hhtbench.lowering.scalar_compiler import compiler
from tests.lowering.native import Holding, Nothing, agree, native_value

NAN, INF = np.nan, np.inf
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.3, -0.7, 0.5, 1.5, -2.5, 3.0, 40.0, -40.0, 1e10, 1e200, -1e200, INF, -INF, NAN])
X = np.array([0.3, -1.2, 2.0, 0.7])
A = np.random.default_rng(0).normal(size=(4, 3))
UNARY = (
    *(jnp.abs, jnp.negative, jnp.sign, jnp.sqrt, lax.rsqrt, lax.cbrt, jnp.square, jnp.exp, jnp.exp2, jnp.expm1),
    *(jnp.log, jnp.log1p, jnp.sin, jnp.cos, jnp.tan, jnp.arcsin, jnp.arccos, jnp.arctan, jnp.sinh, jnp.cosh, jnp.tanh),
    *(jnp.arcsinh, jnp.arccosh, jnp.arctanh, lax.erf, lax.erfc, lax.logistic, jnp.floor, jnp.ceil, jnp.round, lax.round),
    *(jnp.trunc, jnp.reciprocal, jax.nn.relu, jax.nn.softplus, jax.nn.sigmoid, jnp.nan_to_num, jnp.sinc, jnp.deg2rad),
    *(lambda x: x**2, lambda x: x**3, lambda x: x**-2, lambda x: x**7, lambda x: x**0, lambda x: x**0.5, lambda x: x / 8),
    *(lambda x: jnp.clip(x, -1.0, 2.0), lambda x: jnp.where(jnp.isfinite(x), x, 7.0), lambda x: lax.stop_gradient(x) * 2),
)
BINARY = (
    *(jnp.add, jnp.subtract, jnp.multiply, jnp.divide, jnp.maximum, jnp.minimum, jnp.arctan2, jnp.hypot, lax.rem, jnp.mod),
    *(lambda x, y: jnp.where(x < y, x, y), lambda x, y: jnp.where(x <= y, x, y), lambda x, y: jnp.where(x > y, x, y)),
    *(lambda x, y: jnp.where(x >= y, 1.0, y), lambda x, y: jnp.where(x == y, x, 2.0)),
    *(lambda x, y: jnp.where(x != y, x, 2.0),),
    *(lambda x, y: jnp.where((x > 0) & (y > 0), x, y), lambda x, y: jnp.where((x > 0) | ~(y > 0), x, y)),
    *(lambda x, y: jnp.where((x > 0) ^ (y > 0), x, y), lambda x, y: (x > y) * 2.0, lambda x, y: jnp.heaviside(x, y)),
    *(lambda x, y: jnp.where((x > 0) == (y > 0), x, y), lambda x, y: jnp.logaddexp(x, y), jnp.power),
)


def test_every_function_of_one_number_has_jax_values():
    agree(lambda x: jnp.stack([f(x) for f in UNARY]), SPECIAL, rtol=2e-15 * 8, atol=1e-300)
    agree(lambda x: jnp.stack([f(x) for f in UNARY]), np.random.default_rng(0).normal(size=40), rtol=2e-15 * 8, atol=1e-16)


def test_every_function_of_two_numbers_has_jax_values():
    few = np.array([0.0, -0.0, 1.0, -1.0, 0.3, 2.0, -2.5, 3.0, 1e200, INF, -INF, NAN])
    x, y = (grid.ravel() for grid in np.meshgrid(few, few))
    agree(lambda x, y: jnp.stack([f(x, y) for f in BINARY]), x, y, rtol=2e-14, atol=1e-300)


@pytest.mark.filterwarnings("error")
def test_known_values_are_folded_to_those_of_jax_without_a_warning():
    code = agree(lambda x: jnp.concatenate([jnp.stack([f(jnp.asarray(SPECIAL)) for f in UNARY]).ravel(), x]), X, rtol=2e-14)
    assert code.operations == 0
    assert code.varying.size == X.size


MOVES = {
    "transpose": lambda a: a.T,
    "reshape": lambda a: a.reshape(2, 6) * 2,
    "slices": lambda a: a[1:4:2, ::-1],
    "negative index": lambda a: a[-1],
    "new axes": lambda a: a[:, None, :] + a[None, :, :],
    "fancy": lambda a: a[np.array([2, 0, 2]), np.array([1, -1, 0])],
    "mask": lambda a: a[np.array([True, False, True, True])],
    "fill": lambda a: a.at[np.array([0, 9])].get(mode="fill"),
    "fill value": lambda a: a.at[np.array([0, 9])].get(mode="fill", fill_value=3.0),
    "clip": lambda a: a.at[np.array([0, 9])].get(mode="clip"),
    "set": lambda a: a.at[1].set(5.0).at[:, 2].set(a[:, 0]),
    "add": lambda a: a.at[np.array([0, 0, 3])].add(a[:3]),
    "multiply": lambda a: a.at[np.array([0, 0]), np.array([1, 2])].multiply(2.0),
    "least": lambda a: a.at[1:3].min(0.1).at[0].max(0.2),
    "dropped": lambda a: a.at[np.array([0, 9])].set(1.0, mode="drop"),
    "pad": lambda a: lax.pad(a, 0.5, ((1, -1, 0), (-1, 2, 1))),
    "join": lambda a: jnp.concatenate([a, jnp.ones((2, 3)), a[:1]]),
    "stack": lambda a: jnp.stack([a, 2 * a], axis=1),
    "split": lambda a: jnp.split(a, [1, 3])[1],
    "tile": lambda a: jnp.tile(a, (2, 3)),
    "repeat": lambda a: jnp.repeat(a, 2, axis=1),
    "roll": lambda a: jnp.roll(a, 1, axis=0),
    "triangle": lambda a: jnp.tril(a) + jnp.triu(a, 1),
    "diagonal": lambda a: jnp.diag(a[:, 0]) @ a,
    "block": lambda a: jnp.block([[a, jnp.zeros((4, 1))], [jnp.ones((1, 4))]]),
    "dynamic slice": lambda a: lax.dynamic_slice(a, (3, 1), (2, 2)),
    "dynamic update": lambda a: lax.dynamic_update_slice(a, a[:2, :2], (3, 2)),
    "iota": lambda a: a * jnp.arange(3) + lax.broadcasted_iota(float, (4, 3), 0),
    "choice by index": lambda a: jnp.select([np.arange(3) < 1, np.arange(3) < 2], [a, 2 * a], 0.0),
    "moved": lambda a: jnp.moveaxis(a.reshape(2, 2, 3), 2, 0),
}


@pytest.mark.parametrize("family", [sorted(MOVES)[::2], sorted(MOVES)[1::2]], ids=["one half", "other half"])
def test_entries_are_moved_as_by_jax(family):
    agree(lambda a: jnp.concatenate([MOVES[name](a).ravel() for name in family]), A)


def test_shapes_are_kept():
    for name in ("new axes", "pad", "transpose"):
        agree(MOVES[name], A)


SUMS = {
    "product": lambda a: a.T @ a,
    "vector": lambda a: a @ a[0],
    "batch": lambda a: jnp.einsum("ij,ik->ijk", a, a),
    "three": lambda a: jnp.einsum("ij,kj,k->i", a, a, a[:, 0]),
    "batched product": lambda a: a.reshape(2, 2, 3) @ jnp.ones((2, 3, 2)),
    "sum": lambda a: jnp.stack([a.sum(), a.prod(), a.max(), a.min(), a.mean(), jnp.linalg.norm(a), a.var()]),
    "over one axis": lambda a: jnp.concatenate([a.sum(0), a.prod(1), a.max(0), a.min(1)]),
    "all": lambda a: jnp.where((a > 0).all(0) | (a < 0).any(0), a[0], a[1]),
    "running": lambda a: jnp.stack([jnp.cumsum(a, 0), jnp.cumprod(a, 1), lax.cummax(a, 0), lax.cummin(a, 1, reverse=True)]),
    "cross": lambda a: jnp.cross(a, a[::-1]),
    "empty": lambda a: a[:0].sum(0) + a[:, :0].prod(1)[0],
    "outer": lambda a: jnp.kron(a[:2], a[2:]),
}


def test_sums_and_products_are_those_of_jax():
    agree(lambda a: jnp.concatenate([f(a).ravel() for f in SUMS.values()]), A, rtol=1e-13, atol=1e-15)


def test_maxima_with_nan_are_nan():
    a = A.copy()
    a[2, 1] = NAN
    agree(SUMS["over one axis"], a)


def rolled(x):
    def turn(carry, row):
        state, count = carry
        state = state + row * jnp.sin(state)
        return (state, count + 1), state * count

    (last, _), rows = lax.scan(turn, (x, 0), jnp.stack([x, 2 * x, 3 * x]))
    return jnp.concatenate([last, rows.ravel(), lax.scan(turn, (x, 1), jnp.stack([x, 3 * x]), reverse=True)[1].ravel()])


@jax.custom_vjp
def tripled(x):
    return 3 * x


tripled.defvjp(lambda x: (tripled(x), None), lambda _, g: (3 * g,))
CONTROL = {
    "scan": rolled,
    "loop": lambda x: lax.fori_loop(0, 3, lambda i, y: y * x[i] + i, x),
    "cond": lambda x: lax.cond(x[0] > x[1], lambda y: y / (y[0] - 0.3), lambda y: y + 1, x),
    "known cond": lambda x: lax.cond(True, lambda y: 2 * y, lambda y: y, x),
    "known switch": lambda x: lax.switch(2, [lambda y: y, lambda y: 2 * y, lambda y: 3 * y], x),
    "custom": lambda x: tripled(x) + jax.grad(lambda y: jax.nn.silu(tripled(y)).sum())(x),
    "checkpoint": lambda x: jax.grad(lambda y: jax.checkpoint(jnp.sin)(y).sum())(x),
    "jit": lambda x: jax.jit(jnp.outer)(x, x),
    "vmap": lambda x: jax.vmap(lambda a, b: a @ jnp.stack([b, b]), in_axes=(0, None))(jnp.stack([x[:2], x[2:]]), x[0]),
    "jacobian": lambda x: jax.jacfwd(lambda y: jnp.sin(y) * y[::-1])(x),
    "reverse": lambda x: jax.jacrev(lambda y: jnp.exp(-y) * y.sum() + jnp.linalg.norm(y))(x),
    "second": lambda x: jax.hessian(lambda y: jnp.prod(jnp.cos(y)) + (y @ y) ** 1.5)(x),
    "root": lambda x: jax.jvp(lambda y: jnp.abs(y) ** 1.3 + jnp.maximum(y, 0.5), (x,), (x,))[1],
    "many cases": lambda x: jnp.select([x < 0, x < 1], [-x, x**2], x + 1),
    "pieces": lambda x: jax.vmap(lambda y: jnp.piecewise(y, [y < 0, y > 1], [jnp.sin, jnp.cos, jnp.tan]))(x),
    "switch": lambda x: lax.switch(jnp.floor(x[2]).astype(int), [lambda y: y, lambda y: 2 * y, lambda y: 3 * y], x),
    "table": lambda x: jnp.interp(x, jnp.array([-1.0, 0.0, 0.5, 3.0]), jnp.array([1.0, 2.0, 0.0, 5.0])),
    "place": lambda x: jnp.stack([x[jnp.argmax(x)], x[jnp.argmin(x)], x[(10 * x[0]).astype(int) // 2], x[jnp.int32(x[1])]]),
    "places": lambda x: jnp.stack([x, 2 * x])[:, jnp.clip(jnp.trunc(x).astype(int), 0, 9)].at[0].add(jnp.sum(x > 0)),
}


@pytest.mark.parametrize("family", [list(CONTROL)[:7], list(CONTROL)[7:]], ids=["calls", "derivatives"])
def test_calls_loops_and_derivatives_are_those_of_jax(family):
    agree(lambda x: jnp.concatenate([CONTROL[name](x).ravel() for name in family]), X, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (lambda d, x: lax.while_loop(lambda y: y[0] < 9, lambda y: 2 * y, x), "while"),
        (lambda d, x: jnp.sort(x), "sort"),
        (lambda d, x: x.at[jnp.argmax(x)].set(1.0), "a place that depends"),
        (lambda d, x: x * (x[0].astype(int) << 2), "shift_left"),
        (lambda d, x: x.astype(jnp.float32), "float32"),
        (lambda d, x: lax.fori_loop(0, 5000, lambda i, y: y * 1.01, x), "5000 turns"),
        (lambda d, x: jax.pure_callback(np.sin, x, x), "effect|pure_callback"),
        (lambda d, x: jnp.linalg.eigh(jnp.outer(x, x))[0], "eigh"),
        (lambda d, x: jnp.linalg.cholesky(jnp.outer(x, x) + jnp.eye(4)), "cholesky"),
        (lambda d, x: x * jax.random.normal(jax.random.key(0), (4,)), "erf_inv"),
        (lambda d, x: (x, x), "2 arrays"),
    ],
)
def test_what_has_no_machine_code_says_why_and_where(function, reason):
    with pytest.raises(NotNative, match=reason) as caught:
        native(function, Nothing(), shapes=((4,),))
    if "arrays" not in reason:
        assert "test_native.py" in caught.value.reason


def test_what_is_not_needed_does_no_harm():
    value, _ = native_value(lambda d, x: (x * 2, jnp.sort(x))[0], X)
    np.testing.assert_array_equal(value, 2 * X)


def test_too_many_operations_are_counted_and_declined(monkeypatch):
    monkeypatch.setattr(compiler, "MOST_OPERATIONS", 5000)
    with pytest.raises(NotNative, match=r"\d+ scalar operations"):
        native(
            lambda d, x: lax.fori_loop(0, 100, lambda i, y: sum(jnp.sin(k * y) for k in range(1, 31)), x),
            Nothing(),
            shapes=((),),
        )


def operations(function, *arrays, dynamics=None):
    return native_value(lambda d, *x: function(*x), *arrays, dynamics=dynamics or Nothing())[1].operations


def test_equal_operations_are_done_once():
    assert operations(lambda x: jnp.stack([jnp.sin(x[0]) * 2, jnp.sin(x[0]) * 2 + 1, 3 - jnp.sin(x[0])]), X) == 4
    assert operations(lambda x: jnp.stack([x[0] * x[1], x[1] * x[0], -x[0] * x[1]]), X) == 2, "signs and order do not count"


def test_trivial_operations_vanish():
    trivial = [
        *(lambda x: x * 1.0, lambda x: x + 0.0, lambda x: x * 0.0, lambda x: 0.0 / x, lambda x: x - 0.0),
        *(lambda x: x / 1.0, lambda x: x**1, lambda x: jnp.where(True, x, 1 / x), lambda x: jnp.where(x > 0, x, x)),
        *(lambda x: 0.0 * jnp.sin(x), lambda x: jnp.sin(2.0) * 0.0 + x, lambda x: jnp.maximum(x, x), lambda x: x**0),
        *(lambda x: jnp.negative(-x), lambda x: x * -0.0, lambda x: x - 1 * x * 0),
    ]
    for i, function in enumerate(trivial):
        assert operations(function, X) == 0, i


def test_a_zero_in_a_derivative_is_known_and_exact():
    code = agree(lambda x: jax.jacfwd(lambda y: jnp.stack([y[0] ** 2, y[1] * y[2], y[3]]))(x), X)
    np.testing.assert_array_equal(code.varying, [0, 5, 6])
    np.testing.assert_array_equal(code.constants, np.eye(12)[11])
    assert code.shape == (3, 4)
    assert code.size == 12


def test_compact_code_writes_only_what_varies():
    from hhtbench.lowering.scalar_compiler.machine import caller

    function = lambda d, x: jnp.stack([x[0], 2.0, x[1] + 1, 0.0])  # noqa: E731
    code = native(function, Nothing(), shapes=((4,),), compact=True)
    out = np.full(4, 9.0)
    pointers = np.array([array.ctypes.data for array in (out, code.parameters, X)])
    caller(code.block_address)(pointers.ctypes.data)
    np.testing.assert_array_equal(code.varying, [0, 2])
    np.testing.assert_array_equal(code.constants, [0.0, 2.0, 0.0, 0.0])
    np.testing.assert_array_equal(out, [X[0], X[1] + 1, 9.0, 9.0])


def scaled(dynamics, x):
    return dynamics.values @ x


def test_new_parameter_values_need_no_new_code():
    first, one = native_value(scaled, X, dynamics=Holding(jnp.asarray(A.T)))
    second, other = native_value(scaled, X, dynamics=Holding(jnp.asarray(2 * A.T)))
    np.testing.assert_allclose(second, 2 * first, rtol=1e-14)
    assert one.address == other.address


def test_parameters_that_are_zero_or_one_cost_nothing():
    diagonal = np.diag([2.0, 3.0, 4.0, 5.0])
    value, code = native_value(scaled, X, dynamics=Holding(jnp.asarray(diagonal)))
    np.testing.assert_array_equal(value, diagonal @ X)
    assert code.operations == 4
    unit, code = native_value(scaled, X, dynamics=Holding(jnp.asarray(np.diag([1.0, -1.0, 1.0, 1.0]))))
    np.testing.assert_array_equal(unit, [X[0], -X[1], X[2], X[3]])
    assert code.operations == 1
    full, code = native_value(scaled, X, dynamics=Holding(jnp.asarray(diagonal + 7)))
    np.testing.assert_allclose(full, (diagonal + 7) @ X, rtol=1e-14)
    assert code.operations == 16 + 12


def test_a_negative_zero_is_a_parameter_like_any_other():
    value, _ = native_value(lambda d, x: 1 / (d.values * x), X[:1], dynamics=Holding(jnp.asarray([-0.0])))
    assert value[0] == -np.inf
