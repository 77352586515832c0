"""One compilation serves all systems of one kind; what a system does not declare is not traced."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from hhtbench.lowering import AccelerationLevel, ConstraintLevels, compile_function, derive
from hhtbench.protocol.system import System, parameter

Q, V = np.array([1.0, 2.0]), np.array([0.5, -0.5])
TRACED = []  # names of methods, once per trace
pytestmark = pytest.mark.usefixtures("empty_cache")  # code of an earlier run is not traced at all


class Oscillator(System):
    k: Array = parameter(1.0, doc="stiffness [N/m]")
    power: int = eqx.field(default=1, static=True)

    def force(self, t, q, v):
        TRACED.append("force")
        return -self.k * q**self.power

    def energy(self, t, q, v):
        TRACED.append("energy")
        return self.k * jnp.sum(q**2) / 2

    def invariants(self, t, q, v):
        TRACED.append("invariants")
        return {"none": 0.0}


def force_of(dynamics, factor, t, q, v):
    return factor * dynamics.force(t, q, v)


def evaluate(system, factor=1.0):
    """The compiled force at one point, and how often the Python function ran for it and for its derivation."""
    TRACED.clear()
    dynamics = derive(system, 0.0, Q, V)
    value = compile_function(force_of, dynamics, factor)(0.0, Q, V)
    return value, len(TRACED)


def test_systems_of_one_class_share_a_compilation_whatever_their_parameters():
    class Own(Oscillator):  # that no other test has traced
        pass

    first, traces = evaluate(Own(k=2.0))
    second, more = evaluate(Own(k=5.0))
    np.testing.assert_array_equal(first, -2.0 * Q)
    np.testing.assert_array_equal(second, -5.0 * Q)
    assert (traces, more) == (1, 0)


def test_static_fields_are_traced_anew_and_options_are_not():
    evaluate(Oscillator(k=3.0))
    squared, traces = evaluate(Oscillator(k=3.0, power=2))
    doubled, more = evaluate(Oscillator(k=3.0), factor=2.0)
    np.testing.assert_array_equal(squared, -3.0 * Q**2)
    np.testing.assert_array_equal(doubled, -6.0 * Q)
    assert (traces, more) == (1, 0)


def test_a_whole_number_as_parameter_is_a_parameter_like_any_other():
    evaluate(Oscillator(k=2.0))
    value, traces = evaluate(Oscillator(k=7))
    np.testing.assert_array_equal(value, -7.0 * Q)
    assert traces == 0


class Plain(System):
    """Fields that are not parameters(): a Python float and a NumPy array of whole numbers."""

    k: float
    count: np.ndarray

    def force(self, t, q, v):
        return -self.k * q * self.count.sum()


def test_plain_fields_are_never_mixed_up_between_systems():
    for k, count in ((2.0, [1, 2]), (3.0, [1, 2]), (3.0, [2, 2])):
        value, _ = evaluate(Plain(k, np.array(count)))
        np.testing.assert_allclose(value, -k * sum(count) * Q, rtol=1e-15)


def test_energy_and_invariants_are_not_traced_by_anything_a_solver_uses():
    class Own(Oscillator):  # that no other test has traced
        pass

    TRACED.clear()
    dynamics = derive(Own(k=4.0), 0.0, Q, V)
    found = AccelerationLevel(dynamics).solve(0.0, Q, V)
    ConstraintLevels(dynamics).at(0.0, Q, V)
    np.testing.assert_allclose(found.vdot, -4.0 * Q, rtol=1e-14)
    assert set(TRACED) == {"force"}


def test_a_system_is_derived_once():
    system = Oscillator(k=9.0)
    derive(system, 0.0, Q, V)
    TRACED.clear()
    assert derive(system, 1.0, 2 * Q, V) is derive(system, 0.0, Q, V)
    assert TRACED == []
