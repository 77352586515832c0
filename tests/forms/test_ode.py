"""The underlying ODE: against closed solutions, against automatic differentiation of the whole, and where it is singular."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench
from hhtbench.lowering import AccelerationLevel, derive
from hhtbench.protocol.system import NumpySystem
from solvers.forms import make_form, rhs_function
from solvers.forms.layout import Layout, jacobian_function, residual_function
from tests.forms.scenes import C, Linear
from tests.lowering.systems import (
    MASSLESS_NUMPY,
    PENDULUM_NUMPY,
    RUBBING_NUMPY,
    WHEEL_NUMPY,
    MasslessWheel,
    Pendulum,
    Rich,
    Rubbing,
)

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])


@pytest.mark.parametrize(("name", "t_end"), [("knife_edge", 5.0), ("oscillator_chain", 0.2), ("jay_negrut_pendulum", 0.3)])
def test_the_ode_form_integrated_by_dop853_reaches_the_closed_solution(name, t_end):
    problem = hhtbench.load_problem(name)
    form = make_form("ode", derive(problem.system, 0.0, problem.q0, problem.v0))
    start = np.concatenate([problem.q0, problem.v0])
    found = solve_ivp(form.rhs, (0.0, t_end), start, "DOP853", rtol=1e-12, atol=1e-12)
    state, exact = form.state(found.y[:, -1]), problem.exact(t_end)
    for value, expected, scale in ((state.q, exact.q, problem.scales.q), (state.v, exact.v, problem.scales.v)):
        assert np.max(np.abs(value - expected) / scale) < 1e-9


def test_the_traced_right_hand_side_has_the_jacobian_of_the_form():
    """What an implicit diffrax method differentiates, for mixed constraints and a variable mass."""
    dynamics = derive(Linear(), 0.2, Q3, V3)
    y = jnp.concatenate([jnp.asarray(Q3), jnp.asarray(V3)])
    traced = jax.jit(jax.jacfwd(rhs_function, 2))(dynamics, 0.2, y)
    form = make_form("ode", dynamics)
    np.testing.assert_allclose(form.rhs_jacobian(0.2, np.asarray(y)), traced, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(form.rhs(0.2, np.asarray(y)), rhs_function(dynamics, 0.2, y), rtol=1e-12, atol=1e-12)


def test_the_jacobian_of_a_dae_form_is_that_of_the_whole_residual_differentiated_at_once():
    """Put together from blocks, so that declared derivatives and zeros are used; GGL holds all rows but (F5), (F7)."""
    dynamics = derive(Rich(), 0.2, Q3, V3)
    layout = Layout("ggl", dynamics.structure)
    y, yp = jnp.linspace(0.3, 0.9, layout.size), jnp.linspace(0.2, 0.7, layout.size)

    def both(y, yp):
        by_y, by_yp = jax.jacfwd(residual_function, (3, 4))(dynamics, layout, 0.2, y, yp)
        return jacobian_function(dynamics, layout, 0.2, y, yp, C), by_y + C * by_yp

    blocks, whole = jax.jit(both)(y, yp)
    np.testing.assert_allclose(blocks, whole, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("system", "tolerance"),
    [(MASSLESS_NUMPY, 1e-7), (MasslessWheel(), 1e-11), (WHEEL_NUMPY, 1e-9)],
    ids=["position, numpy", "velocity, jax", "velocity, numpy"],
)
def test_a_singular_mass_with_a_regular_kkt_matrix_has_an_ode(system, tolerance):
    dynamics = derive(system, 0.2, Q3, V3)
    found = make_form("ode", dynamics).rhs(0.2, np.concatenate([Q3, V3]))
    expected = AccelerationLevel(dynamics).solve(0.2, Q3, V3)
    np.testing.assert_allclose(found, np.concatenate([V3, expected.vdot]), rtol=tolerance, atol=tolerance)


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
