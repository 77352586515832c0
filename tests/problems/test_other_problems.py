"""Claims particular to the rolling disk, the knife edge and the chain."""

import jax
import numpy as np
import pytest

from tests.problems.mechanics import compiled


@pytest.mark.parametrize("j0", [0.02, 1.0])
def test_norm_inertia_changes_the_multiplier_of_the_norm_alone(make, mechanics, j0):
    """j0 acts along the quaternion: accelerations, contact force and friction stay, on a state of general rates."""
    singular, regular = (mechanics(compiled(make("rolling_disk3d_steady", j0=x).system)) for x in (0.0, j0))
    problem = make("rolling_disk3d_steady")
    q = problem.exact(0.7).q
    rows = np.vstack([singular.position_rows(0.0, q), singular.velocity_rows(0.0, q, problem.v0)])
    v = np.linalg.svd(rows)[2][4:].T @ np.array([1.0, -2.0, 0.5])  # any velocity the constraints admit
    (a0, lam0, mu0), (a1, lam1, mu1) = (s.accelerations(0.0, q, v) for s in (singular, regular))
    np.testing.assert_allclose(a1, a0, rtol=0, atol=1e-12 * np.abs(a0).max())
    np.testing.assert_allclose(lam1[1], lam0[1], rtol=1e-12)
    np.testing.assert_allclose(mu1, mu0, rtol=0, atol=1e-12 * np.abs(mu0).max())
    np.testing.assert_allclose(lam1[0] - lam0[0], 2 * j0 * (v[3:] @ v[3:]), rtol=1e-10)


def test_mass_matrix_is_singular_without_norm_inertia_while_the_kkt_matrix_is_regular(make, mechanics):
    problem = make("rolling_disk3d_steady", j0=0.0)
    system, q = mechanics(problem.system), problem.q0
    rows = np.vstack([system.position_rows(0.0, q), system.velocity_rows(0.0, q, problem.v0)])
    mass = system.mass(0.0, q)
    assert np.linalg.matrix_rank(mass) == 6
    assert np.linalg.matrix_rank(np.block([[mass, rows.T], [rows, np.zeros((4, 4))]])) == 11
    assert "singular" in problem.tags
    assert np.linalg.matrix_rank(mechanics(make("rolling_disk3d_steady").system).mass(0.0, q)) == 7


def test_disk_rolls_on_the_circle_of_the_reference(make):
    """Radius |R w3 / Om| = 0.377874528944461389 about (-r, 0), axial rate -2.26724717366676833."""
    problem = make("rolling_disk3d_steady")
    for t in (0.0, 0.8, 3.3):
        motion = problem.exact(t)
        r = 0.377874528944461389
        np.testing.assert_allclose(np.hypot(motion.q[0] + r, motion.q[1]), r, rtol=1e-14)
        np.testing.assert_allclose(problem.system.invariants(t, *motion[:2])["axial_rate"], -2.26724717366676833, rtol=1e-14)


def test_contact_point_of_the_disk_touches_the_table(make):
    """The lowest point of the drawn rim lies at height 0 (24 points on the rim: 1 % of the radius)."""
    problem = make("rolling_disk3d_steady")
    rim = problem.sketch(problem.exact(1.3).q)["lines"][1:, 0]
    assert abs(rim[:, 2].min()) < 0.01 * 0.5


def test_knife_edge_moves_level_on_average(make):
    """After whole turns the skate is back at its height and has moved by G t / (2 Om) across (Bloch 2003)."""
    problem = make("knife_edge")
    motion = problem.exact(np.pi)
    np.testing.assert_allclose(motion.q[:2], [0.0, 9.81 * np.sin(0.5) * np.pi / 4], atol=1e-14)


@pytest.mark.parametrize("n", [2, 8, 31])
def test_chain_moves_in_its_slowest_and_fastest_eigenmodes(make, n):
    """Frequencies and shapes against the eigenvalues of the stiffness matrix that the force implies."""
    from problems.oscillator_chain import frequency, mode

    problem = make("oscillator_chain", n_masses=n, m=2.0, k=300.0)
    stiffness = -jax.jacfwd(problem.system.force, 1)(0.0, problem.q0, problem.v0)
    squares, shapes = np.linalg.eigh(np.asarray(stiffness) / 2.0)
    for j, column in ((1, 0), (n, n - 1)):
        np.testing.assert_allclose(frequency(n, j, 2.0, 300.0), np.sqrt(squares[column]), rtol=1e-10)
        cosine = shapes[:, column] @ mode(n, j) / np.linalg.norm(mode(n, j))
        np.testing.assert_allclose(abs(cosine), 1.0, rtol=1e-12)


def test_chain_of_many_masses_is_tagged_large(make):
    assert "large" in make("oscillator_chain", n_masses=100).tags
    assert "large" not in make("oscillator_chain").tags
