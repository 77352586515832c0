"""What every implementation of Dynamics keeps."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import AccelerationLevel, Dynamics, augment, derive, mass_is_singular, reduce_redundant
from hhtbench.lowering.dynamics.dynamics import arguments_of
from hhtbench.lowering.dynamics.products import matrix_free
from hhtbench.protocol.system import SIGNATURES, WITH_VELOCITY, NumpySystem
from tests.lowering.systems import MASSLESS_NUMPY, Massless, Pendulum

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])
Q2, V2 = np.array([0.6, -0.8]), np.array([0.8, 0.6])


def test_solvers_call_what_users_declare_with_the_same_arguments():
    for name, signature in (SIGNATURES | WITH_VELOCITY).items():
        member = "mass" if name == "mass_matrix" else name
        assert not hasattr(Dynamics, member) or arguments_of(member) == signature.arguments, name


class Twice(Pendulum):
    """The rod's row, twice."""

    def constraint(self, t, q):
        return jnp.concatenate([super().constraint(t, q)] * 2)


def pendulum(cls):
    return derive(cls(mass_matrix=2.0), 0.2, Q2, V2)


@pytest.mark.parametrize(
    ("solved", "asked", "q", "v"),
    [
        (pendulum(Pendulum), pendulum(Pendulum), Q2, V2),
        (pendulum(Pendulum), matrix_free(pendulum(Pendulum)), Q2, V2),
        (reduce_redundant(pendulum(Twice), (1,)), reduce_redundant(pendulum(Twice), (1,)), Q2, V2),
        (derive(Massless(), 0.2, Q3, V3), augment(derive(Massless(), 0.2, Q3, V3), 0.2, Q3), Q3, V3),
        (derive(MASSLESS_NUMPY, 0.2, Q3, V3), augment(derive(MASSLESS_NUMPY, 0.2, Q3, V3), 0.2, Q3), Q3, V3),
    ],
    ids=["plain", "matrix free", "reduced", "augmented", "augmented, numpy"],
)
def test_accelerations_of_the_acceleration_level_leave_no_residual(solved, asked, q, v):
    """With the mass and the forces of the dynamics that is asked, not with those of the one inside it."""
    at = AccelerationLevel(solved).solve(0.2, q, v)
    inertia = np.asarray(asked.mass(0.2, q)) @ at.vdot
    left = asked.residual(0.2, q, v, inertia, at.lam, at.mu)
    assert np.max(np.abs(left)) <= 1e-7 * np.max(np.abs(inertia))  # differences of the NumPy system


def test_a_constant_mass_has_an_inverse_exactly_where_it_is_not_singular():
    for apart in (2e-12, 7e-14, 3e-14):  # conditions 1e12, 3e13 and 7e13
        mass = np.array([[1.0, 1.0 - apart], [1.0 - apart, 1.0]])
        dynamics = derive(NumpySystem(force=lambda t, q, v: -q, mass_matrix=mass), 0.0, Q2, V2)
        assert (dynamics.inverse_mass is None) == mass_is_singular(mass)
