"""What a system's functions may return and change (rows C6 to C8 of the acceptance matrix)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System
from solvers.hht import HHT
from tests.hht.scenes import PENDULUM, Q0, V0, circle, circle_jacobian, gravity, pendulum, same_bits, unit_mass

WITH_MASS = {**PENDULUM, "mass_matrix": unit_mass}


def solve(system, span=(0.0, 0.1)):
    return HHT(system).solve(span, Q0, V0, step=0.01)


WRONG_RETURNS = {
    "scalar": 1.0,
    "none": None,
    "column": np.zeros((2, 1)),
    "row": np.zeros((1, 2)),
    "longer": np.zeros(3),
    "shorter": np.zeros(1),
    "string": "ab",
    "complex": np.zeros(2, complex),
    "object": np.array([object(), object()]),
    "bool": np.array([True, False]),
    "masked": np.ma.masked_array([1.0, 2.0], [True, False]),
}


# the length of a constraint is read, not prescribed, and (1, 2) is the shape of the pendulum's constraint_jacobian
RIGHT_AFTER_ALL = {("constraint", "longer"), ("constraint", "shorter"), ("constraint_jacobian", "row")}
NAMES = ("force", "constraint", "constraint_jacobian", "mass_matrix")


@pytest.mark.parametrize(("name", "kind"), sorted({(n, k) for n in NAMES for k in WRONG_RETURNS} - RIGHT_AFTER_ALL))
def test_a_result_of_the_wrong_kind_is_refused_by_name_and_never_broadcast(name, kind):
    with pytest.raises((TypeError, ValueError), match=name):
        solve(NumpySystem(**{**WITH_MASS, name: lambda *arguments: WRONG_RETURNS[kind]}))


def test_a_constraint_that_changes_its_length_is_refused():
    growing = pendulum(constraint=lambda t, q: np.resize(circle(t, q), 1 if t < 0.05 else 2))
    with pytest.raises(ValueError, match=r"constraint must return shape \(1,\).*\(2,\)"):
        solve(growing)


@pytest.mark.parametrize("value", [None, 1.0, np.zeros((2, 2)), (np.zeros((2, 2)),), "ab"])
def test_force_jacobians_that_are_no_pair_are_refused(value):
    with pytest.raises((TypeError, ValueError), match=r"force_jacobians.* must return"):
        solve(pendulum(force_jacobians=lambda t, q, v: value))


class Returns(System):
    """A force of the wrong kind, chosen by a static field."""

    value: object

    def force(self, t, q, v):
        return self.value


@pytest.mark.parametrize(
    "value", [None, 1.0, "ab", np.zeros(3), np.zeros((2, 1)), np.zeros(2, complex), (0.0, 0.0)], ids=repr
)
def test_a_jax_force_of_the_wrong_kind_is_refused_by_name(value):
    with pytest.raises((TypeError, ValueError), match="force"):
        solve(Returns(value))


CONVERSIONS = {
    "float32": lambda x: np.asarray(x, dtype=np.float32),
    "list": lambda x: np.asarray(x).tolist(),
    "tuple": lambda x: tuple(np.asarray(x).tolist()),
    "jax": jnp.asarray,
    "int": lambda x: np.asarray(np.rint(x), dtype=int),
    "fortran": np.asfortranarray,
    "read-only": lambda x: np.broadcast_to(np.asarray(x), np.shape(x)),
    "longdouble": lambda x: np.asarray(x, dtype=np.longdouble),
}


@pytest.mark.parametrize("kind", CONVERSIONS)
def test_a_result_of_any_real_kind_is_converted(kind):
    convert = CONVERSIONS[kind]
    force = np.array([0.0, -10.0])  # exact in every kind
    expected = solve(pendulum(force=lambda t, q, v: force))
    assert same_bits(solve(pendulum(force=lambda t, q, v: convert(force))), expected)
    if kind not in ("int", "float32"):
        jacobian = lambda t, q: convert(circle_jacobian(t, q))  # noqa: E731
        constraint = lambda t, q: convert(circle(t, q))  # noqa: E731
        system = pendulum(force=lambda t, q, v: force, constraint=constraint, constraint_jacobian=jacobian)
        assert same_bits(solve(system), expected)


def spoil_q(t, q, v):
    q[0] = 7.0
    return gravity(t, q, v)


def spoil_v(t, q, v):
    v *= 2.0
    return gravity(t, q, v)


def spoil_constraint(t, q):
    q += 1.0
    return circle(t, q)


@pytest.mark.parametrize("changes", [{"force": spoil_q}, {"force": spoil_v}, {"constraint": spoil_constraint}])
def test_arguments_are_read_only(changes):
    with pytest.raises(ValueError, match="read-only"):
        solve(pendulum(**changes))
