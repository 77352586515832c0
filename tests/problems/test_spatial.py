"""Claims on the spatial problems: unit quaternions, a top, closed loops, rolling on a turning table."""

import jax
import numpy as np
import pytest

from hhtbench.mechanics.space import body_rate, quaternion_rate, rotation, space_rate, split
from tests.problems.cases import CHANGED, RANKS
from tests.problems.mechanics import Mechanics, compiled, consistent_state

every_problem = pytest.mark.parametrize("name", RANKS)


def accelerations(problem, q, v):
    """(vdot, lam, mu); the shortest multipliers where they are not unique."""
    return Mechanics(compiled(problem.system)).accelerations(0.0, q, v, redundant="redundant" in problem.tags)


def consistent_states(problem, number=2):
    """Random states near the start that satisfy the constraints on both levels."""
    system = Mechanics(compiled(problem.system))
    return [consistent_state(problem, system, seed, RANKS[problem.name])[1:] for seed in range(number)]


def test_rotation_turns_with_the_rates_of_the_quaternion():
    """R is a rotation and R' = R w~ = (R w)~ R, for a stack of bodies as for one (Nikravesh 1988, chapter 6)."""
    p, rate = np.random.default_rng(1).standard_normal((2, 5, 4))
    p /= np.linalg.norm(p, axis=1)[:, None]
    pdot = np.asarray(quaternion_rate(p, rate[:, :3]))
    R, Rdot = map(np.asarray, jax.jvp(rotation, (p,), (pdot,)))
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(space_rate(p, pdot), rate[:, :3], atol=1e-14)
    for column in range(3):
        expected = np.cross(rate[:, :3], R[:, :, column])
        np.testing.assert_allclose(Rdot[:, :, column], expected, atol=1e-14)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", R, body_rate(p, pdot)), rate[:, :3], atol=1e-14)
    np.testing.assert_allclose(rotation(p)[3], rotation(p[3]), atol=1e-15)


@pytest.mark.parametrize(
    ("name", "parameters"), [*((name, {}) for name in RANKS), *((name, CHANGED[name]) for name in RANKS)]
)
def test_rows_have_the_stated_rank_at_the_start_and_elsewhere(make, name, parameters):
    problem = make(name, **parameters)
    system = Mechanics(compiled(problem.system))
    for q, v in ((problem.q0, problem.v0), *consistent_states(problem, 1)):
        rows = np.vstack([system.position_rows(0.0, q), system.velocity_rows(0.0, q, v)])
        assert np.linalg.matrix_rank(rows, tol=1e-9) == RANKS[name]
        assert ("redundant" in problem.tags) == (RANKS[name] < len(rows))


def test_norm_inertia_of_the_top_changes_the_multiplier_of_the_norm_alone(make):
    regular, singular = make("heavy_top"), make("heavy_top", j0=0.0)
    assert "singular" in singular.tags
    q, v = consistent_states(regular)[0]
    (a1, lam1, _), (a0, lam0, _) = (accelerations(p, q, v) for p in (regular, singular))
    np.testing.assert_allclose(a1, a0, rtol=0, atol=1e-10 * np.abs(a0).max())
    np.testing.assert_allclose(lam1[1:], lam0[1:], rtol=1e-9)
    np.testing.assert_allclose(lam1[0] - lam0[0], 2 * regular.system.j0[0] * (v[3:] @ v[3:]), rtol=1e-9)


def test_top_obeys_eulers_equations_about_its_tip(make):
    """I w' + w x I w = X x R^T weight with I about the tip, and the tip carries the rest of the forces on the centre."""
    problem = make("heavy_top")
    for q, v in consistent_states(problem):
        vdot, lam, _ = accelerations(problem, q, v)
        w, wdot = map(np.asarray, jax.jvp(body_rate, (q[3:], v[3:]), (v[3:], vdot[3:])))
        about_tip = np.array([0.234375 + 15.0, 0.46875, 0.234375 + 15.0])
        weight = np.array([0.0, 0.0, -15.0 * 9.81])
        moment = np.cross([0.0, 1.0, 0.0], np.asarray(rotation(q[3:])).T @ weight)
        left = about_tip * wdot + np.cross(w, about_tip * w)
        np.testing.assert_allclose(left, moment, rtol=0, atol=1e-10 * np.abs(about_tip * wdot).max())
        np.testing.assert_allclose(lam[1:], weight - 15.0 * vdot[:3], rtol=1e-10)


def test_sphere_turns_in_a_circle_with_two_sevenths_of_the_table(make):
    """x'' = -k y', y'' = k x' with k = 2/7 Om; friction mu and norm multiplier follow (Neimark and Fufaev 1972)."""
    problem = make("rolling_sphere_table")
    k = 6.0 / 7.0
    for q, v in [(problem.q0, problem.v0), *consistent_states(problem)]:
        vdot, lam, mu = accelerations(problem, q, v)
        np.testing.assert_allclose(vdot[:2], [-k * v[1], k * v[0]], rtol=0, atol=1e-11)
        np.testing.assert_allclose(mu, [2.0 * k * v[1], -2.0 * k * v[0]], rtol=0, atol=1e-11)
        np.testing.assert_allclose(lam, 2 * 0.4 * 2.0 * 0.25**2 * (v[2:] @ v[2:]), rtol=1e-11)


def test_middle_of_bricards_loop_stays_on_the_curve_of_the_source(make):
    """z = -(1 - x^2) / 2, y = -sqrt(1 - z^2); its velocity is along the curve and everything else follows from it."""
    problem = make("bricard")
    P3 = problem.observables["P3"]
    for q, v in consistent_states(problem, 4):
        x, y, z = P3(0.0, q, v, np.zeros(35))
        assert abs(z) > 1e-3
        np.testing.assert_allclose([z, y], [-(1 - x**2) / 2, -np.sqrt(1 - z**2)], rtol=0, atol=1e-9)
        h = 1e-5
        xdot, ydot, zdot = (P3(0.0, q + h * v, v, None) - P3(0.0, q - h * v, v, None)) / (2 * h)
        np.testing.assert_allclose([zdot, ydot], [x * xdot, -z * zdot / y], rtol=0, atol=1e-8)


def test_bricards_loop_starts_with_the_energy_of_the_source_and_can_fall(make):
    """-29.43 J (IFToMM library, A04); the one motion left by the hinges is not at rest in the weight."""
    problem = make("bricard")
    np.testing.assert_allclose(problem.system.energy(0.0, problem.q0, problem.v0), -29.43, rtol=1e-14)
    vdot, _, _ = accelerations(problem, problem.q0, problem.v0)
    assert np.abs(vdot).max() > 1.0


def test_joints_of_the_drawn_loop_are_the_corners_of_a_cube(make):
    corners = [[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]]
    problem = make("bricard")
    np.testing.assert_allclose(problem.sketch(problem.q0)["points"], corners, atol=1e-15)
    assert split(problem.q0)[0].shape == (5, 3)


@every_problem
def test_sketch_moves_with_the_bodies_and_keeps_their_shape(make, name):
    problem = make(name)
    drawings = [problem.sketch(q) for q in (problem.q0, consistent_states(problem)[0][0])]
    for drawing in drawings:
        assert drawing["points"].shape[1:] == (3,)
        assert drawing["lines"].shape[1:] == (2, 3)
    lengths = [np.linalg.norm(d["lines"][:, 0] - d["lines"][:, 1], axis=1) for d in drawings]
    rigid = slice(0, 16) if name == "flyball_governor" else slice(None)  # the rest are its springs
    np.testing.assert_allclose(lengths[1][rigid], lengths[0][rigid], atol=1e-12)
    assert np.abs(drawings[1]["points"] - drawings[0]["points"]).max() > 1e-3
