"""The JAX and the NumPy route give the same derived functions, to the error of the difference scheme."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hhtbench.lowering import compile_function, derive
from hhtbench.lowering.dynamics.differences import derivative
from hhtbench.lowering.dynamics.dynamics import arguments_of
from hhtbench.protocol.system import NumpySystem
from tests.lowering.systems import (
    MASSLESS_NUMPY,
    PENDULUM_NUMPY,
    RICH_NUMPY,
    RUBBING_NUMPY,
    SPRINGS_NUMPY,
    WHEEL_NUMPY,
    Massless,
    MasslessWheel,
    Pendulum,
    Rich,
    Rubbing,
    Springs,
)

EXACT, FOURTH, FIRST = 1e-14, 1e-9, 1e-6  # as declared; differences that enter the equations; of Newton's matrix
POSITION = {
    "constraint": EXACT,
    "constraint_jacobian": FOURTH,
    "constraint_time_derivative": FOURTH,
    "constraint_velocity": FOURTH,
    "constraint_velocity_jacobian": FIRST,
    "constraint_acceleration": FOURTH,
    "reaction": FOURTH,
    "reaction_jacobians": FIRST,
}
VELOCITY = {
    "velocity_constraint": EXACT,
    "velocity_constraint_jacobian": FOURTH,
    "velocity_constraint_position_jacobian": FIRST,
    "velocity_constraint_acceleration": FOURTH,
    "velocity_reaction": FOURTH,
    "velocity_reaction_jacobians": FIRST,
}
PAIRS = {
    "rich": (Rich(), RICH_NUMPY, 3, 1, 1),
    "pendulum": (Pendulum(), PENDULUM_NUMPY, 2, 1, 0),
    "friction": (Rubbing(), RUBBING_NUMPY, 2, 1, 0),
    "springs": (Springs(), SPRINGS_NUMPY, 2, 0, 0),
    "wheel": (MasslessWheel(), WHEEL_NUMPY, 3, 0, 1),
    "massless": (Massless(), MASSLESS_NUMPY, 3, 2, 0),
}


def names_of(m, p):
    general = {"force": EXACT, "mass": EXACT, "force_jacobians": FIRST, "mass_product_jacobian": FIRST}
    return general | (POSITION if m else {}) | (VELOCITY if p else {})


def evaluate(dynamics, name, values):
    result = getattr(dynamics, name)(*(values[key] for key in arguments_of(name)))
    if not isinstance(result, tuple):
        return [result]
    n = dynamics.structure.n
    return [dynamics.xp.zeros((n, n)) if part is None else part for part in result]


def everything(dynamics, names, t, q, v, lam, mu, x):
    values = {"t": t, "q": q, "v": v, "lam": lam, "mu": mu, "x": x}
    return dynamics.xp.concatenate([part.ravel() for name in names for part in evaluate(dynamics, name, values)])


COMPILED = {}


def jax_values(pair, values):
    """Every derived function of the JAX system at one state, compiled once per system."""
    system, _, _, m, p = PAIRS[pair]
    names = tuple(names_of(m, p))
    if pair not in COMPILED:
        COMPILED[pair] = compile_function(everything, derive(system, values["t"], values["q"], values["v"]), names)
    return COMPILED[pair](*values.values())


def vectors(size):
    return arrays(np.float64, size, elements=st.floats(-1.5, 1.5, width=32))


@pytest.mark.parametrize("pair", PAIRS)
@settings(max_examples=12, deadline=None, derandomize=True)
@given(data=st.data())
def test_both_routes_give_the_same_derived_functions(pair, data):
    _, system, n, m, p = PAIRS[pair]
    values = {"t": data.draw(st.floats(0.0, 20.0))} | {
        key: data.draw(vectors(size)) for key, size in (("q", n), ("v", n), ("lam", m), ("mu", p), ("x", n))
    }
    wanted, at = jax_values(pair, values), 0
    dynamics = derive(system, values["t"], values["q"], values["v"])
    for name, tolerance in names_of(m, p).items():
        for part in evaluate(dynamics, name, values):
            expected = wanted[at : at + part.size].reshape(part.shape)
            at += part.size
            assert np.abs(part - expected).max(initial=0.0) <= tolerance * max(1.0, np.abs(expected).max(initial=0.0)), name
    assert at == wanted.size


@pytest.mark.parametrize("t", [1e6, 1e9])
def test_time_derivatives_keep_their_digits_at_late_times(t):
    """The step in time is no part of the time itself: at 1e9 s it would skip whole periods."""
    system = NumpySystem(
        force=lambda t, q, v: -q,
        constraint=lambda t, q: np.array([q[0] + 3.0 * (t - np.floor(t)) ** 2]),
        velocity_constraint=lambda t, q, v: np.array([v[1] + np.sin(t - np.floor(t))]),
    )
    q, v = np.array([1.0, 2.0]), np.array([0.5, -0.5])
    dynamics = derive(system, t + 0.5, q, v)
    assert dynamics.constraint_time_derivative(t + 0.5, q)[0] == pytest.approx(3.0, rel=1e-9)
    assert dynamics.constraint_acceleration(t + 0.5, q, v)[0] == pytest.approx(6.0, rel=1e-8)
    assert dynamics.velocity_constraint_acceleration(t + 0.5, q, v)[0] == pytest.approx(np.cos(0.5), rel=1e-9)


@pytest.mark.parametrize("speed", [1.0, 1e3])
def test_derivatives_along_the_motion_keep_their_digits_at_high_speed(speed):
    """A skate that spins fast: dk/dt - k_v vdot = speed (vx cos phi + vy sin phi)."""
    system = NumpySystem(
        force=lambda t, q, v: -q,
        velocity_constraint=lambda t, q, v: np.array([v[0] * np.sin(q[2]) - v[1] * np.cos(q[2])]),
    )
    q, v = np.array([0.0, 0.0, 0.3]), np.array([2.0, 1.0, speed])
    given_value = derive(system, 0.0, q, v).velocity_constraint_acceleration(0.0, q, v)[0]
    assert given_value == pytest.approx(speed * (2 * np.cos(0.3) + np.sin(0.3)), rel=1e-9)


@pytest.mark.parametrize("t", [0.0, 1.0])
def test_a_large_coordinate_does_not_stretch_the_step_of_the_others(t):
    """g = q1 - sin t beside q0 = 1e4: g'' = sin t."""
    system = NumpySystem(force=lambda t, q, v: -q, constraint=lambda t, q: np.array([q[1] - np.sin(t)]))
    q, v = np.array([1e4, np.sin(t)]), np.array([0.0, np.cos(t)])
    assert derive(system, t, q, v).constraint_acceleration(t, q, v)[0] == pytest.approx(np.sin(t), abs=1e-8)


TRIDIAGONAL = np.abs(np.subtract.outer(np.arange(12), np.arange(12))) <= 1


def chain_force(calls):
    def force(t, q, v):
        calls.append(1)
        stretch = np.diff(np.concatenate([[0.0], q, [0.0]]))
        return np.diff(stretch + stretch**3) - 0.1 * v

    return force


@pytest.mark.parametrize("order", [1, 2, 4])
def test_coloured_differences_equal_dense_ones_with_fewer_evaluations(order):
    calls = []
    force = chain_force(calls)
    q = np.sin(np.arange(12.0))
    dense = derivative(lambda x: force(0.0, x, 0 * x), q, order)
    dense_calls = len(calls)
    coloured = derivative(lambda x: force(0.0, x, 0 * x), q, order, TRIDIAGONAL)
    coloured_calls = len(calls) - dense_calls
    np.testing.assert_array_equal(coloured, np.where(TRIDIAGONAL, dense, 0.0))
    np.testing.assert_allclose(coloured, dense, atol=1e-7)
    points = {1: 1, 2: 2, 4: 4}[order]
    assert (dense_calls, coloured_calls) == (12 * points + (order == 1), 3 * points + (order == 1))
