"""Repelling points on a sphere, the clamped bar, the stiff pair and the nonlinear chain."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from tests.problems.mechanics import compiled, consistent_state


def test_fekete_multipliers_are_closed_on_every_state(make, mechanics):
    problem = make("fekete", n_points=5)
    system = mechanics(compiled(problem.system))
    _, q, v = consistent_state(problem, system, 7)
    lam = system.accelerations(0.0, q, v)[1]
    np.testing.assert_allclose(lam, -(4 / 2 + np.sum(v.reshape(5, 3) ** 2, axis=1)) / 2, rtol=1e-11)
    assert problem.observables["multiplier_error"](0.0, q, v, lam) < 1e-11
    assert problem.observables["multiplier_error"](0.0, q, v, lam + 0.5) == pytest.approx(0.5)


def test_fekete_points_start_on_the_rings_of_the_source(make):
    pi, expected = np.pi, []
    for count, offset, latitude, first in ((3, 13, 3 / 8, 1), (7, 29, 1 / 8, 1), (6, 7, -2 / 15, 1), (4, 17, -3 / 10, 0)):
        for i in range(first, first + count):
            a, b = 2 * pi * i / count + pi / offset, pi * latitude
            expected.append([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])
    np.testing.assert_allclose(make("fekete").q0.reshape(20, 3), expected, rtol=0, atol=1e-15)


def test_four_repelling_points_come_to_rest_in_a_regular_tetrahedron(make):
    problem = make("fekete", n_points=4)
    force = jax.jit(lambda t, q, v: problem.system.force(t, q, v))

    def rate(t, y):
        p, u = y.reshape(2, 4, 3)
        push = np.asarray(force(t, y[:12], y[12:])).reshape(4, 3)
        return np.concatenate([y[12:], (push - np.sum(p * push + u * u, axis=1, keepdims=True) * p).ravel()])

    start = np.concatenate([problem.q0, problem.v0])
    p = solve_ivp(rate, (0.0, 80.0), start, rtol=1e-8, atol=1e-9).y[:12, -1].reshape(4, 3)
    np.testing.assert_allclose(p @ p.T, np.eye(4) * 4 / 3 - 1 / 3, rtol=0, atol=1e-4)


def test_bar_has_the_frequencies_of_its_matrices(make):
    from problems.clamped_bar_impact import modes

    problem = make("clamped_bar_impact")
    stiffness = -np.asarray(jax.jacfwd(problem.system.force, 1)(0.0, problem.q0, problem.v0))[1:, 1:]
    squares = eigh(stiffness, np.asarray(problem.system.mass_matrix)[1:, 1:], eigvals_only=True)
    np.testing.assert_allclose(modes(10).frequencies, np.sqrt(squares), rtol=1e-11)
    assert 0.98 * np.sqrt(12) < modes(10).frequencies[-1] / 10 < np.sqrt(12)


def test_wall_turns_the_momentum_of_the_bar_around_while_the_shock_runs_there_and_back(make):
    """Continuous bar: the wall pushes with 1 for 2 s; the mesh adds vibrations that cancel in the mean.

    Node 0 is at rest, so h / 2 of the momentum is missing from the start.
    """
    exact = make("clamped_bar_impact", n_elements=200).exact
    push = [-exact(t).lam[0] for t in np.linspace(0.0, 2.0, 4001)]
    np.testing.assert_allclose(np.mean(push), 1.0, rtol=0, atol=0.01)
    np.testing.assert_allclose(np.mean(push[:3600]), 1.0, rtol=0, atol=0.0025)
    assert np.std(push[:3600]) > 0.005


def test_stiff_pair_moves_at_the_two_frequencies_known_for_large_stiffness():
    from problems.hf_linear_constrained import modes

    K = 1e10
    np.testing.assert_allclose(modes(K, 1e-3).squares, [1 / 3, 1.5 * K], rtol=1e-9)


def test_fput_forces_are_those_of_single_springs(make):
    problem = make("fput_chain", n_masses=5, alpha=0.3, beta=0.7, k=2.0)
    q = np.array([0.2, -0.1, 0.5, 0.3, -0.4])
    ends = [0.0, *q, 0.0]
    pull = [2.0 * d + 0.3 * d**2 + 0.7 * d**3 for d in (ends[i + 1] - ends[i] for i in range(6))]
    np.testing.assert_allclose(problem.system.force(0.0, q, 0 * q), [pull[i + 1] - pull[i] for i in range(5)], rtol=1e-13)


def test_fput_linear_modes_share_the_energy_of_the_linear_chain(make):
    problem = make("fput_chain", n_masses=4, alpha=0.0, beta=0.0, k=3.0, m=2.0)
    q, v = np.random.default_rng(1).standard_normal((2, 4))
    parts = [f(0.0, q, v, None) for f in problem.observables.values()]
    np.testing.assert_allclose(sum(parts), problem.system.energy(0.0, q, v), rtol=1e-13)
    first, *rest = (f(0.0, problem.q0, problem.v0, None) for f in problem.observables.values())
    np.testing.assert_allclose(rest, 0.0, atol=1e-14 * first)


def test_fput_energy_comes_back_to_the_first_mode_as_in_los_alamos(make):
    """LA-1940, figure 1: 32 springs, alpha = 1/4, leapfrog with dt^2 = 1/8; back within a few percent near step 29000."""
    problem = make("fput_chain", n_masses=31, alpha=0.25, beta=0.0)
    system, dt = problem.system, np.sqrt(1 / 8)

    @jax.jit
    def shares(q, v):
        def step(state, _):
            q, v = state
            v = v + dt / 2 * system.force(0.0, q, v)
            q = q + dt * v
            v = v + dt / 2 * system.force(0.0, q, v)
            return (q, v), (q, v)

        return jax.lax.scan(step, (q, v), None, length=31000)[1]

    q, v = (np.asarray(x) for x in shares(problem.q0, problem.v0))
    measure = problem.observables["mode_1_energy"]
    first = np.array([measure(0.0, a, b, None) for a, b in zip(q[::50], v[::50], strict=True)])
    first /= problem.system.energy(0.0, problem.q0, problem.v0)
    assert first.min() < 0.1
    assert first[:440].argmin() > 0
    assert first[500:].max() > 0.95
    assert first[100:500].max() < 0.9
