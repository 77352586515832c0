"""Closed limits of the scenes with cables: hanging chain, line in equilibrium, slack net, belt without friction."""

import jax
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.special import jn_zeros

from tests.problems.mechanics import compiled, consistent_state
from tests.sample import slow


@pytest.mark.parametrize("dimension", [2, slow(3)])
def test_a_hanging_cable_that_hardly_resists_bending_swings_like_the_chain_of_bernoulli(make, dimension):
    """Frequencies ``j0_k / 2 sqrt(g / L)``, j0_k the zeros of the Bessel function J0 (Lamb, Hydrodynamics, section 189)."""
    n, EA = 16, 1e6
    problem = make("cable_pendulum", n_elements=n, dimension=dimension, EA=EA, EI=1e-4, length=1.3, mass=0.7)
    x = np.linspace(0.0, 1.3, n + 1)
    nodes = np.zeros((n + 1, 2, dimension))
    nodes[:, 0, 1] = -x - 0.7 * 9.81 / EA * (1.3 * x - x**2 / 2)
    nodes[:, 1, 1] = -1 - 0.7 * 9.81 / EA * (1.3 - x)
    force = lambda q: problem.system.force(0.0, q, 0 * q)  # noqa: E731
    rest, slope = jax.jit(lambda q: (force(q), jax.jacfwd(force)(q)))(nodes.ravel())
    np.testing.assert_allclose(rest[dimension:], 0.0, atol=1e-9 * 0.7 * 9.81 * EA / 1e3)
    rows = np.arange(dimension, nodes.size, dimension)  # across, along x, without the pin
    mass = np.asarray(problem.system.mass_matrix)[np.ix_(rows, rows)]
    squares = eigh(-np.asarray(slope)[np.ix_(rows, rows)], mass, eigvals_only=True)
    errors = np.abs(np.sqrt(squares[:2]) / (jn_zeros(0, 2) / 2 * np.sqrt(9.81 / 1.3)) - 1)
    assert np.all(
        errors < [1e-5, 1e-3]
    )  # EI adds 3e-6 and 4.6e-4, with 32 elements too; without it the free end has no slope


def test_the_mooring_line_starts_in_equilibrium_with_the_pulls_it_was_given(make, mechanics):
    problem = make("mooring_line", n_segments=8, pull_x=300.0, pull_z=900.0)
    force = np.asarray(compiled(problem.system).force(0.0, problem.q0, problem.v0)).reshape(-1, 3)
    noise = 1.29e8 / (55 / 8) * 60 * 1e-15 * 55  # of a tension from lengths in positions of up to 60 m
    np.testing.assert_allclose(force[1:-1], 0.0, atol=noise)
    buoyancy = (1025 * np.pi / 4 * 0.086**2 - 4.0) * 9.81 * 55
    np.testing.assert_allclose(force[0], [300.0, 0.0, 900.0 + buoyancy / 16], atol=noise)
    np.testing.assert_allclose(force.sum(axis=0), [0.0, 0.0, buoyancy], atol=noise)


def test_a_slack_net_falls_freely_and_pulls_at_no_corner(make, mechanics):
    problem = make("falling_net", n_side=4, width=1e-6, slack=1.2)
    vdot, lam, _ = mechanics(compiled(problem.system)).accelerations(0.0, problem.q0, problem.v0)
    corners = [0, 3, 12, 15]
    moving = np.delete(vdot.reshape(-1, 3), corners, axis=0)
    np.testing.assert_allclose(moving, [[0.0, 0.0, -9.81]] * 12, atol=1e-5)
    np.testing.assert_allclose(lam.reshape(4, 3), [[0.0, 0.0, -2.0 / 16 * 9.81]] * 4, atol=1e-5)


def test_a_belt_without_friction_turns_no_wheel(make, mechanics):
    problem = make("belt_drive", n_elements=8, mu=0.0, brake=0.3)
    system = mechanics(compiled(problem.system))
    t, q, v = consistent_state(problem, system, 3)
    vdot, lam, _ = system.accelerations(t, q, v)
    driven = 2 * np.pi * np.pi / 0.25 * np.sin(np.pi * t / 0.25) / 2
    np.testing.assert_allclose(vdot[-2:], [driven, -0.3 * v[-1] / 0.01], rtol=1e-9)
    np.testing.assert_allclose(lam, -0.01 * driven, rtol=1e-9)


def test_the_belt_starts_with_its_tension_carried_by_the_contact(make):
    """Contact carries ``EA stretch / R`` per length; elements, straight pieces and the onset leave a few percent."""
    problem = make("belt_drive", n_elements=64)
    system, q = problem.system, problem.q0
    gap = jax.jit(lambda q: system.gaps(q))(q)
    push = -np.asarray(system.contact_law(gap, 0 * gap))
    np.testing.assert_allclose(push.sum(), 2 * np.pi * 4000 * 0.005, rtol=0.03)
    np.testing.assert_allclose(jax.jit(lambda q: system.strains(q))(q)[:, :3], 0.005, rtol=1e-3, atol=1e-4)
