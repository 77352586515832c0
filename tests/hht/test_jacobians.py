"""Wrong derivatives of the user's never give a wrong result in silence (rows J1 to J3 of the acceptance matrix)."""

import warnings

import numpy as np
import pytest

from solvers.hht import HHT
from tests.hht.scenes import (
    DAMPING,
    Q0,
    REST,
    STIFFNESS,
    V0,
    Spring,
    circle_jacobian,
    pendulum,
    pendulum_at,
    stiff_force,
    tension_at,
)


def stiff_jacobians(t, q, v):
    return -STIFFNESS * (1.0 + 3.0 * (q - REST) ** 2), -DAMPING


@pytest.mark.filterwarnings("ignore:Newton's iteration failed with the declared")
@pytest.mark.parametrize("claim", [0.9, 1.1, 2.0, -1.0, 0.0])
def test_a_wrong_jacobian_of_a_jax_system_changes_nothing_either(claim):
    start = (np.array([0.1, -0.2]), np.array([1.0, 2.0]))
    right = HHT(Spring(), alpha=-0.3).solve((0.0, 0.1), *start, step=0.005)
    wrong = HHT(Spring(claim=claim), alpha=-0.3).solve((0.0, 0.1), *start, step=0.005)
    assert wrong.success, wrong.message
    assert np.max(np.abs(wrong.q - right.q)) < 1e-9
    assert wrong.counters.newton_iterations > right.counters.newton_iterations


@pytest.mark.parametrize("factor", [0.9, 1.1, 2.0, -1.0, 0.0])
def test_a_wrong_constraint_jacobian_is_replaced_with_a_warning(factor):
    """It enters the equations, so it is compared at the start."""
    wrong = pendulum(constraint_jacobian=lambda t, q: factor * circle_jacobian(t, q))
    with pytest.warns(UserWarning, match="declared constraint_jacobian disagrees"):
        solution = HHT(wrong).solve((0.0, 0.5), Q0, V0, step=0.005)
    assert solution.success, solution.message
    q, _ = pendulum_at(solution.t)
    right = HHT(pendulum()).solve((0.0, 0.5), Q0, V0, step=0.005)
    assert np.max(np.abs(solution.q - right.q)) < 1e-9
    assert np.max(np.abs(solution.q - q)) < 1e-4
    assert np.max(np.abs(solution.lam[:, 0] - tension_at(solution.q, solution.v))) < 1e-7


@pytest.mark.parametrize("factor", [0.9, 2.0, -1.0, 0.0])
def test_a_wrong_reaction_jacobian_is_replaced_with_a_warning(factor):
    """The multipliers are solved for with its second part."""

    def reaction_jacobians(t, q, lam):
        return -lam[0] * np.eye(2), -factor * circle_jacobian(t, q).T

    with pytest.warns(UserWarning, match="declared reaction_jacobians disagrees"):
        solution = HHT(pendulum(reaction_jacobians=reaction_jacobians)).solve((0.0, 0.1), Q0, V0, step=0.01)
    assert solution.success
    assert np.max(np.abs(solution.lam[:, 0] - tension_at(solution.q, solution.v))) < 1e-7


def test_right_derivatives_bring_no_warning():
    right = pendulum(
        reaction_jacobians=lambda t, q, lam: (-lam[0] * np.eye(2), -circle_jacobian(t, q).T),
        constraint_time_derivative=lambda t, q: np.zeros(1),
        constraint_acceleration=lambda t, q, v: np.array([v @ v]),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert HHT(right).solve((0.0, 0.1), Q0, V0, step=0.01).success
        stiff = pendulum(force=stiff_force, force_jacobians=stiff_jacobians)
        assert HHT(stiff, alpha=-0.3).solve((0.0, 0.1), Q0, V0, step=0.005).success
