"""The underlying ODE: against closed solutions, against automatic differentiation of the whole, and where it is singular."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import AccelerationLevel, derive
from hhtbench.protocol.system import NumpySystem
from solvers.forms import make_form, rhs_function
from tests.forms.scenes import Linear
from tests.lowering.systems import (
    PENDULUM_NUMPY,
    RUBBING_NUMPY,
    Pendulum,
    Rubbing,
)

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])


def test_the_traced_right_hand_side_has_the_jacobian_of_the_form():
    """What an implicit diffrax method differentiates, for mixed constraints and a variable mass."""
    dynamics = derive(Linear(), 0.2, Q3, V3)
    y = jnp.concatenate([jnp.asarray(Q3), jnp.asarray(V3)])
    traced = jax.jit(jax.jacfwd(rhs_function, 2))(dynamics, 0.2, y)
    form = make_form("ode", dynamics)
    np.testing.assert_allclose(form.rhs_jacobian(0.2, np.asarray(y)), traced, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(form.rhs(0.2, np.asarray(y)), rhs_function(dynamics, 0.2, y), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("system", [Pendulum(), PENDULUM_NUMPY], ids=["jax", "numpy"])
def test_a_singular_kkt_matrix_gives_values_that_are_not_finite_and_no_exception(system):
    """At the pivot the rod has no direction."""
    form = make_form("ode", derive(system, 0.0, Q3[:2], V3[:2]))
    y = np.array([0.0, 0.0, 1.0, 2.0])
    assert not np.isfinite(form.rhs(0.0, y)[2:]).any()
    assert not np.isfinite(form.rhs_jacobian(0.0, y)[2:]).any()


@pytest.mark.parametrize("system", [Rubbing(), RUBBING_NUMPY], ids=["jax", "numpy"])
def test_friction_nonlinear_in_lam_has_an_ode_with_its_jacobian(system):
    """By Newton's iteration on the acceleration level; the Jacobian is that of its root, by implicit differentiation."""
    dynamics = derive(system, 0.2, Q3[:2], V3[:2])
    form, y = make_form("ode", dynamics), np.concatenate([Q3[:2], V3[:2]])
    found = AccelerationLevel(dynamics).solve(0.2, Q3[:2], V3[:2])
    np.testing.assert_allclose(form.rhs(0.2, y), np.concatenate([V3[:2], found.vdot]), rtol=1e-12)
    columns = [(form.rhs(0.2, y + e) - form.rhs(0.2, y - e)) / 2e-5 for e in 1e-5 * np.eye(4)]
    np.testing.assert_allclose(form.rhs_jacobian(0.2, y), np.transpose(columns), rtol=1e-4, atol=1e-4)


def test_the_mass_of_an_unconstrained_system_is_divided_out():
    """Diagonal mass (2, 4): an inverse known beforehand where it is constant, a solve where it varies."""
    force = lambda t, q, v: np.array([-q[0], -8 * q[1] - 4 * v[1]])  # noqa: E731
    expected = np.array([3.0, 4.0, -0.5, -2 * 2.0 - 4.0])
    for mass in (np.array([2.0, 4.0]), lambda t, q: np.diag([2.0, 4.0]) * q[0]):
        form = make_form("ode", derive(NumpySystem(force=force, mass_matrix=mass), 0.0, np.ones(2), np.ones(2)))
        np.testing.assert_allclose(form.rhs(0.0, np.array([1.0, 2.0, 3.0, 4.0])), expected, rtol=1e-15)
