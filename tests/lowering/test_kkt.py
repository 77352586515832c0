"""Accelerations and multipliers; rank of constraints; augmented mass."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

from hhtbench.lowering import (
    AccelerationLevel,
    ConstraintLevels,
    augment,
    constraint_rank,
    derive,
    mass_is_singular,
    minimum_norm,
)
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem, System
from tests.lowering.systems import (
    MASSLESS_NUMPY,
    PENDULUM_NUMPY,
    RICH_NUMPY,
    WHEEL_NUMPY,
    Massless,
    MasslessWheel,
    Rich,
)

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])


@pytest.mark.parametrize("size", [1e-100, 1.0, 1e20, 1e100])
def test_rows_far_larger_than_the_mass_do_not_look_singular(size):
    """Lengths in other units: a mass of 1 beside rows of 1e20 decides what is free all the same."""
    rod = NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81 * size]),
        constraint=lambda t, q: np.array([(q @ q - size**2) / 2]),
        constraint_jacobian=lambda t, q: q[None, :],
    )
    q, v = np.array([0.6, -0.8]), np.array([2.4, 1.8])
    found = AccelerationLevel(derive(rod, 0.0, size * q, size * v)).solve(0.0, size * q, size * v)
    assert not found.singular
    assert found.lam[0] == pytest.approx(9.0 + 9.81 * 0.8, rel=1e-13)
    assert found.vdot / size == pytest.approx(np.array([0.0, -9.81]) - found.lam[0] * q, rel=1e-13)


@pytest.mark.parametrize("factor", [1.0, 3.7, 1e-8])
def test_dependent_constraints_make_a_singular_kkt_matrix(factor):
    def constraint(t, q):
        row = 0.1 * q[0] + 0.3 * q[1] + 0.7 * q[2]
        return np.array([row, factor * row])

    dynamics = derive(NumpySystem(force=lambda t, q, v: -q, constraint=constraint), 0.0, np.zeros(3), np.zeros(3))
    assert AccelerationLevel(dynamics).solve(0.0, np.zeros(3), np.zeros(3)).singular


class Quadratic(System):
    """Reaction quadratic in lam (first test problem of Jay and Negrut): 2 lam + lam^2 = 3 at the start."""

    def force(self, t, q, v):
        return jnp.stack([q[0] * v[1] + 2 * q[1] * v[0], -q[0] * q[1] * v[0] - 2 * q[0] * v[0] * q[1] * v[1]])

    def constraint(self, t, q):
        return jnp.stack([q[0] ** 2 * q[1] - 1])

    def reaction(self, t, q, lam):
        return jnp.stack([jnp.exp(-t) * q[0] * lam[0], q[1] * lam[0] ** 2])


QUADRATIC = AccelerationLevel(derive(Quadratic(), 0.0, np.ones(2), np.array([1.0, -2.0])))


@pytest.mark.parametrize(("guess", "root"), [(0.7, 1.0), (1.5, 1.0), (-2.0, -3.0), (-5.0, -3.0)])
def test_a_reaction_nonlinear_in_lam_gets_the_root_of_its_guess(guess, root):
    found = QUADRATIC.solve(0.0, np.ones(2), np.array([1.0, -2.0]), np.array([guess]))
    assert found.converged
    assert found.lam[0] == pytest.approx(root, rel=1e-12)


def test_a_chain_that_hangs_at_rest_has_tensions_though_its_accelerations_are_roundoff():
    """With a declared reaction, whose root is iterated for: each rod carries what hangs below it (statics)."""
    masses, length = np.array([1 / 3, 0.7, 0.9, 1.3]), 0.3
    links = np.stack([np.kron(row, np.eye(2)) for row in np.eye(4) - np.eye(4, k=-1)])
    jacobian = lambda t, q: ((links @ q)[:, :, None] * links).sum(axis=1)  # noqa: E731
    chain = NumpySystem(
        mass_matrix=np.diag(masses.repeat(2)),
        force=lambda t, q, v: np.outer(masses, [0.0, -9.81]).ravel(),
        constraint=lambda t, q: ((links @ q) ** 2).sum(axis=1) / 2 - length**2 / 2,
        constraint_jacobian=jacobian,
        reaction=lambda t, q, lam: -jacobian(t, q).T @ lam,
    )
    q = np.outer(np.arange(1.0, 5.0), [0.0, -length]).ravel()
    found = AccelerationLevel(derive(chain, 0.0, q, 0.0 * q)).solve(0.0, q, 0.0 * q)
    assert found.converged
    np.testing.assert_allclose(found.lam, np.cumsum(masses[::-1])[::-1] * 9.81 / length, rtol=1e-12)
    np.testing.assert_allclose(found.vdot, 0.0, atol=1e-12)


def test_a_light_body_beside_a_heavy_one_loosens_nothing_of_its_rows():
    """Of 1e-8 kg on a rod, pushed by 1 N, which alone is 1e8 m/s^2, beside one of 1 kg on a rod."""
    rods = lambda t, q: np.array([[q[0], q[1], 0.0, 0.0], [0.0, 0.0, q[2], q[3]]])  # noqa: E731
    bodies = NumpySystem(
        mass_matrix=np.diag([1.0, 1.0, 1e-8, 1e-8]),
        force=lambda t, q, v: np.array([0.0, -9.81, 0.0, -1.0]),
        constraint=lambda t, q: np.array([q[:2] @ q[:2] - 1.0, q[2:] @ q[2:] - 1.0]) / 2.0,
        constraint_jacobian=rods,
        reaction=lambda t, q, lam: -rods(t, q).T @ lam,
    )
    q, v = np.array([0.0, -1.0, 0.0, -1.0]), np.zeros(4)
    level = AccelerationLevel(derive(bodies, 0.0, q, v))
    found = level.solve(0.0, q, v)
    x = np.concatenate([found.vdot, found.lam])
    off = 1e-7 * np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0])  # forces stay in balance, the heavy one leaves its circle
    assert level._in_balance(0.0, q, v, x)
    assert not level._in_balance(0.0, q, v, x + off)


def test_an_acceleration_level_without_root_says_so():
    class Rootless(Quadratic):
        def reaction(self, t, q, lam):
            return jnp.stack([0.0 * lam[0], -(lam[0] ** 2) - 10.0 + 0.0 * q[0]])

    level = AccelerationLevel(derive(Rootless(), 0.0, np.ones(2), np.array([1.0, -2.0])))
    found = level.solve(0.0, np.ones(2), np.array([1.0, -2.0]), np.array([1.0]))
    assert not found.converged


@pytest.mark.parametrize(
    "system",
    [Rich(), RICH_NUMPY, Massless(), MASSLESS_NUMPY, MasslessWheel()],
    ids=["jax", "numpy", "massless", "massless, numpy", "massless by a velocity row"],
)
def test_the_whole_acceleration_level_holds_at_the_solution(system):
    """Variable mass, rheonomic, nonlinear reaction, both kinds of constraints; a singular mass: (H16) row by row."""
    dynamics = derive(system, 0.3, Q3, V3)
    assert mass_is_singular(np.asarray(dynamics.mass(0.3, Q3))) == (dynamics.structure.mass == "constant")
    found = AccelerationLevel(dynamics).solve(0.3, Q3, V3, np.ones(dynamics.structure.m))
    assert not found.singular
    forces = -dynamics.residual(0.3, Q3, V3, 0.0, found.lam, found.mu)
    np.testing.assert_allclose(dynamics.mass(0.3, Q3) @ found.vdot, forces, atol=1e-9)
    ahead, back = ((0.3 + e, Q3 + e * V3 + e * e / 2 * found.vdot, V3 + e * found.vdot) for e in (1e-5, -1e-5))
    rates = [dynamics.constraint_velocity] * bool(dynamics.structure.m)
    for rate in rates + [dynamics.velocity_constraint] * bool(dynamics.structure.p):
        np.testing.assert_allclose((rate(*ahead) - rate(*back)) / 2e-5, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("position", "velocity", "rank", "redundant"),
    [
        ([[1, 0, 0], [0, 1, 0]], [[0, 0, 1]], 3, 0),
        ([[1, 0, 0], [0, 1, 0], [3.7e-8, 0, 0]], np.zeros((0, 3)), 2, {0, 2}),
        ([[1, 0, 0]], [[0, 1, 0], [1, 1, 0]], 2, {0, 1, 2}),
        ([[0, 0, 0], [0, 1, 0]], np.zeros((0, 3)), 1, {0}),
        ([[1e-12, 0, 0], [0, 1e6, 0]], np.zeros((0, 3)), 2, 0),
    ],
    ids=["independent", "a row times 3.7e-8", "a velocity row made of two", "a row of zeros", "units apart by 1e18"],
)
@pytest.mark.parametrize("made", [np.array, sp.csr_array], ids=["full", "sparse"])
def test_redundant_rows_are_counted_and_named(position, velocity, rank, redundant, made):
    found = constraint_rank(made(np.concatenate([position, velocity]).astype(float)))
    assert found.rank == rank
    assert len(found.redundant) == found.rows - rank
    if redundant:
        assert set(found.redundant) <= redundant
        kept = [row for i, row in enumerate([*position, *velocity]) if i not in found.redundant]
        assert np.linalg.matrix_rank(np.array(kept)) == rank
        assert all(str(i) in found.text for i in found.redundant)


def dependent_rows(seed, rows=240, n=300, weak=1e-5, sparse=0.03):
    """Rows of random entries of which one row in ten is made of others, and one differs from another by ``weak``."""
    draw = np.random.default_rng(seed)
    matrix = np.where(draw.random((rows, n)) < sparse, draw.normal(size=(rows, n)), 0.0) + np.eye(rows, n)
    matrix[0] = matrix[1] + weak * matrix[0]
    dependent = draw.choice(np.arange(3, rows), rows // 10, replace=False)
    for i in dependent:
        others = draw.choice(np.setdiff1d(np.arange(3, rows), dependent), 3, replace=False)
        matrix[i] = draw.normal(size=3) @ matrix[others]
    return matrix * np.exp(3.0 * draw.normal(size=rows))[:, None], dependent.size


@pytest.mark.parametrize("seed", range(5))
def test_sparse_rows_have_the_rank_of_full_ones(seed):
    matrix, dependent = dependent_rows(seed)
    full, sparse = (constraint_rank(rows) for rows in (matrix, sp.csr_array(matrix)))
    assert full.rank == sparse.rank == len(matrix) - dependent
    kept = np.setdiff1d(np.arange(len(matrix)), sparse.redundant)
    assert np.linalg.matrix_rank(matrix[kept] / np.linalg.norm(matrix[kept], axis=1)[:, None]) == sparse.rank


@pytest.mark.parametrize("made", [np.array, sp.csr_array], ids=["full", "sparse"])
def test_the_smallest_multipliers_are_those_of_the_pseudo_inverse(made):
    matrix, _ = dependent_rows(0, weak=1.0)
    multipliers = np.random.default_rng(1).normal(size=len(matrix)) / np.linalg.norm(matrix, axis=1)
    rows = made(matrix)
    found = minimum_norm(rows, multipliers, constraint_rank(rows).redundant)
    wanted = np.linalg.lstsq(matrix.T, matrix.T @ multipliers, rcond=1e-13)[0]
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max())


def test_of_equal_sparse_rows_the_last_is_named():
    assert constraint_rank(sp.csr_array(np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, 0.0]]))).redundant == (2,)


def test_levels_are_the_constraints_and_their_rates():
    dynamics = derive(Rich(), 0.3, Q3, V3)
    levels = ConstraintLevels(dynamics).at(0.3, Q3, V3)
    np.testing.assert_allclose(levels.position, dynamics.constraint(0.3, Q3), rtol=1e-14)
    rate = (dynamics.constraint(0.3 + 1e-6, Q3 + 1e-6 * V3) - dynamics.constraint(0.3 - 1e-6, Q3 - 1e-6 * V3)) / 2e-6
    np.testing.assert_allclose(levels.velocity_drift, [rate[0], levels.velocity[0]], rtol=1e-8)
    np.testing.assert_allclose(levels.time_derivative, dynamics.constraint_time_derivative(0.3, Q3), rtol=1e-14)


# augmented mass


@pytest.mark.parametrize(
    ("system", "tolerance"),
    [(Massless(), 1e-11), (MASSLESS_NUMPY, 1e-6), (MasslessWheel(), 1e-11), (WHEEL_NUMPY, 1e-6)],
    ids=["position", "position, numpy", "velocity", "velocity, numpy"],
)
def test_an_augmented_mass_is_regular_and_changes_no_solution(system, tolerance):
    dynamics = derive(system, 0.2, Q3, V3)
    augmented = augment(dynamics, 0.2, Q3)
    assert mass_is_singular(np.asarray(dynamics.mass(0.2, Q3)))
    assert not mass_is_singular(np.asarray(augmented.mass(0.2, Q3)))
    plain, other = (AccelerationLevel(d).solve(0.2, Q3, V3) for d in (dynamics, augmented))
    for name in ("vdot", "lam", "mu"):
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("factor", [1e-9, 1e6])
def test_scales_of_rows_leave_the_augmented_mass_alone(factor):
    def mass(scale):
        rows = lambda t, q: np.array([q[2] - q[0] * q[1], scale * (q[0] ** 2 + q[1] ** 2 - 1.0)])  # noqa: E731
        system = NumpySystem(mass_matrix=MASSLESS_NUMPY.mass_matrix, force=MASSLESS_NUMPY.force, constraint=rows)
        return augment(derive(system, 0.2, Q3, V3), 0.2, Q3).mass(0.2, Q3)

    np.testing.assert_allclose(mass(factor), mass(1.0), rtol=1e-6, atol=1e-9)


class MixedNonlinear(Massless):
    """Beside the position constraints a velocity constraint nonlinear in v whose declared reaction does not use v."""

    def constraint(self, t, q):
        return jnp.stack([q[2] - q[0] * q[1]])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[0] + 0.5 * v[1] ** 2 - t])

    def velocity_reaction(self, t, q, v, mu):
        return jnp.stack([mu[0], 0.3 * mu[0], 0.0 * mu[0]])


def test_velocity_constraints_nonlinear_in_v_stay_out_of_the_augmented_mass():
    """With k_v of another velocity in the mass the accelerations would be wrong, and nothing would show it."""
    dynamics = derive(MixedNonlinear(), 0.2, Q3, V3)
    plain, other = (AccelerationLevel(d).solve(0.2, Q3, V3) for d in (dynamics, augment(dynamics, 0.2, Q3)))
    np.testing.assert_allclose(other.vdot, plain.vdot, rtol=1e-11)


@pytest.mark.parametrize("route", ["jax", "numpy"])
def test_augmentation_without_a_usable_constraint_is_refused(route):
    class Curved(MasslessWheel):
        def velocity_constraint(self, t, q, v):
            return jnp.stack([v[2] + v[2] ** 3 - v[0]])

    numpy_system = NumpySystem(
        mass_matrix=np.array([1.0, 2.0, 0.0]),
        force=lambda t, q, v: -q,
        velocity_constraint=lambda t, q, v: np.array([v[2] + v[2] ** 3 - v[0]]),
    )
    with pytest.raises(ProblemError, match="nonlinear in v"):
        augment(derive(Curved() if route == "jax" else numpy_system, 0.0, Q3, V3), 0.0, Q3)


def test_the_augmented_force_jacobians_are_derivatives_on_both_routes():
    """Differences of a force that holds differences itself: still four digits for Newton's matrix."""
    pairs = [
        augment(derive(system, 0.2, Q3, V3), 0.2, Q3).force_jacobians(0.2, Q3, V3) for system in (Massless(), MASSLESS_NUMPY)
    ]
    for exact, differences in zip(*pairs, strict=True):
        np.testing.assert_allclose(differences, exact, rtol=1e-4, atol=1e-4 * np.abs(exact).max())


def test_undeclared_parts_are_never_called():
    """An unconstrained NumPy system is asked for its force alone, a pendulum for force and constraint."""
    for system, expected in (
        (NumpySystem(force=lambda t, q, v: -q, energy=lambda t, q, v: 0.0), {"force"}),
        (PENDULUM_NUMPY, {"force", "constraint"}),
    ):
        calls = []
        dynamics = dataclasses.replace(derive(system, 0.0, Q3[:2], V3[:2]), on_call=calls.append)
        AccelerationLevel(dynamics).solve(0.0, Q3[:2], V3[:2])
        ConstraintLevels(dynamics).at(0.0, Q3[:2], V3[:2])
        assert set(calls) == expected
