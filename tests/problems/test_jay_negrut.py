"""The two problems of Jay and Negrut (ETNA 26, 2007, section 5)."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp


@pytest.mark.parametrize("t", [0.0, 0.4, 1.0])
def test_multiplier_of_the_first_problem_has_two_roots_and_the_guess_is_on_the_right_one(make, mechanics, t):
    """g'' = 0 is quadratic in lam with roots e^t and -e^t - 2 e^-t; its slope at e^t is 4 cosh t."""
    problem = make("jay_negrut_test1")
    q, v, lam, _ = problem.exact(t)
    system = problem.system

    def second_derivative(lam):
        vdot = system.force(t, q, v) + system.reaction(t, q, lam)
        return jax.jvp(lambda q, v: jax.jvp(lambda x: system.constraint(t, x), (q,), (v,))[1], (q, v), (v, vdot))[1]

    roots = np.array([[np.exp(t)], [-np.exp(t) - 2 * np.exp(-t)]])
    for root in roots:
        np.testing.assert_allclose(second_derivative(root), 0.0, atol=1e-13 * root[0] ** 2)
    np.testing.assert_allclose(jax.jacfwd(second_derivative)(lam), [[4 * np.cosh(t)]], rtol=1e-14)
    if t == 0.0:
        assert abs(problem.lam_guess[0] - roots[0, 0]) < abs(problem.lam_guess[0] - roots[1, 0])


def test_pendulum_starts_with_the_accelerations_and_multipliers_of_the_balance_of_forces(make, mechanics):
    problem = make("jay_negrut_pendulum")
    vdot, lam, _ = mechanics(problem.system).accelerations(0.0, problem.q0, problem.v0)
    np.testing.assert_allclose(vdot, [-75.0, 200.0, -37.5], rtol=1e-13)
    np.testing.assert_allclose(lam, [375.0, -1049.05], rtol=1e-13)
    np.testing.assert_allclose(problem.exact(0.0).lam, lam, rtol=1e-12)


def test_pendulum_series_agrees_with_a_runge_kutta_solution_when_it_turns_over():
    """Other parameters than the paper's: a weak spring, several radians of swing."""
    from problems.jay_negrut_pendulum import REST_ANGLE, problem

    m, L, k, c, g, z3 = 1.5, 0.8, 6.0, 0.2, 9.81, 12.0
    times = np.linspace(0.0, 4.0, 9)

    def rate(t, y):
        return [y[1], -(k * (y[0] - REST_ANGLE) + c * y[1] + m * g * L * np.cos(y[0])) / (4 * m * L**2 / 3)]

    found = solve_ivp(rate, (0, 4), [REST_ANGLE, z3], method="DOP853", rtol=1e-13, atol=1e-13, t_eval=times).y.T
    exact = problem(m=m, L=L, k=k, c=c, g=g, z3=z3).exact
    assert np.ptp(found[:, 0]) > 3.0
    np.testing.assert_allclose([[exact(t).q[2], exact(t).v[2]] for t in times], found, rtol=1e-10, atol=1e-10)


def test_pendulum_loses_energy_only_to_its_damper(make):
    """Energy and power are compared with the motion in test_forces.py and test_closed_solutions.py."""
    assert not hasattr(make("jay_negrut_pendulum", c=0.0).system, "power")
    damped = make("jay_negrut_pendulum")
    assert (
        float(damped.system.power(0.0, damped.q0, damped.v0, None, None)) == -float(damped.system.c) * damped.v0[2] ** 2 < 0
    )
