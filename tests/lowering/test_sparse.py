"""Large systems: sparse derivatives by pattern and colour, products instead of Jacobians, nothing of size n x n."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from hhtbench import System, parameter
from hhtbench.lowering import AccelerationLevel, ConstraintLevels, derive
from hhtbench.lowering.compile.coloured import Coloured
from hhtbench.lowering.description import describe
from hhtbench.lowering.dynamics.band_mass import BandInverse, entries_at
from hhtbench.lowering.dynamics.mass import Diagonal, Sparse, compact, full
from hhtbench.lowering.dynamics.products import large, matrix_free
from hhtbench.lowering.scalar_compiler import native, native_call
from hhtbench.solution.counting import Work
from problems import planar_chain
from solvers._initcond import check_start, project
from solvers._start import PhasePoint

T, N = 0.3, 6
Q, V = np.sin(np.arange(1.0, N + 1)), np.cos(np.arange(1.0, N + 1))
LAM, MU = np.array([0.7, -1.1, 0.4]), np.array([0.9])


class Mixed(System):
    """Rheonomic position constraints, a velocity constraint nonlinear in v, a mass that is a diagonal; n = 6."""

    mass_matrix: Array = parameter((1.0, 2.0, 3.0, 1.5, 2.5, 0.5), doc="[kg]")
    stiffness: Array = parameter(2.0, doc="[N/m]")

    def force(self, t, q, v):
        return -self.stiffness * q**3 - 0.1 * jnp.roll(q, 1) * v

    def constraint(self, t, q):
        return q[:3] * q[1:4] - jnp.sin(2.0 * t + q[2:5])

    def velocity_constraint(self, t, q, v):
        return (v[5] + q[0] * v[4] ** 2 - jnp.cos(t))[None]


DENSE = derive(Mixed(), T, Q, V)
FREE = matrix_free(DENSE)


def products(dynamics, t, q, v, lam, mu):
    return {
        "constraint_velocity": dynamics.constraint_velocity(t, q, v),
        "constraint_time_derivative": dynamics.constraint_time_derivative(t, q),
        "constraint_acceleration": dynamics.constraint_acceleration(t, q, v),
        "reaction": dynamics.reaction(t, q, v, lam),
        "velocity_reaction": dynamics.velocity_reaction(t, q, v, mu),
        "velocity_constraint_acceleration": dynamics.velocity_constraint_acceleration(t, q, v),
        "force": dynamics.mass(t, q) @ v - dynamics.force(t, q, v),
    }


def test_products_equal_what_jacobians_give():
    free, dense = (jax.jit(products)(dynamics, T, Q, V, LAM, MU) for dynamics in (FREE, DENSE))
    for name, wanted in dense.items():
        assert np.allclose(free[name], wanted, rtol=1e-14, atol=1e-14), name


def curve(dynamics, x, t, v):
    return jnp.concatenate([dynamics.constraint_velocity(t, x, v), dynamics.force(t, x, v)])


def test_a_coloured_derivative_equals_the_full_one():
    coloured = Coloured(curve, FREE, example=(Q, T, V))
    values, derivative = coloured(Q, T, V)
    assert np.allclose(values, jax.jit(curve)(FREE, jnp.asarray(Q), T, jnp.asarray(V)), rtol=1e-14)
    full = jax.jit(jax.jacfwd(curve, 1))(FREE, jnp.asarray(Q), T, jnp.asarray(V))
    assert np.allclose(derivative.toarray(), full, rtol=1e-14)
    assert coloured.pattern.rows.size < 0.6 * derivative.shape[0] * N and coloured.pattern.colours < N


def test_an_entry_that_vanishes_at_the_start_belongs_to_the_pattern():
    nowhere = np.zeros(N)
    pattern = Coloured(curve, FREE, example=(nowhere, 0.0, nowhere)).pattern
    assert np.array_equal(pattern.matrix(np.ones(pattern.rows.size)).toarray() > 0, _dependencies())


def _dependencies():
    rows = np.zeros((9, N), dtype=bool)
    for i in range(3):
        rows[i, i : i + 3] = True
    rows[3:] = np.eye(N, dtype=bool) | np.roll(np.eye(N, dtype=bool), -1, axis=1)
    return rows


def test_a_pattern_holds_for_other_parameter_values():
    quiet = matrix_free(derive(Mixed(stiffness=0.0), T, Q, V))
    first, second = (Coloured(curve, dynamics, example=(Q, T, V)) for dynamics in (quiet, FREE))
    assert first.pattern is second.pattern


CHAIN = planar_chain.problem(n_links=81)  # n + m = 405: just large
BENT_Q = CHAIN.q0 + 1e-3 * np.sin(np.arange(CHAIN.q0.size))
BENT_V = np.cos(np.arange(CHAIN.q0.size))


@pytest.fixture(scope="module")
def chain():
    return derive(CHAIN.system, 0.0, CHAIN.q0, CHAIN.v0)


def test_sparse_levels_equal_full_ones(chain):
    thin, full = (ConstraintLevels(chain, full=kind).at(0.0, BENT_Q, BENT_V) for kind in (False, True))
    assert np.allclose(thin.position_jacobian.toarray(), full.position_jacobian, rtol=1e-14)
    assert np.allclose(thin.velocity_drift, full.velocity_drift, rtol=1e-12, atol=1e-13)
    assert np.allclose(thin.scaled_position(1.0), full.scaled_position(1.0), rtol=1e-10)
    assert np.allclose(thin.scaled_velocity(1.0), full.scaled_velocity(1.0), rtol=1e-10)
    assert np.allclose(np.abs(thin.rows).sum(axis=1), np.abs(full.rows).sum(axis=1))


def test_the_sparse_acceleration_level_equals_the_full_one(chain):
    thin, full = (AccelerationLevel(chain, full=kind).solve(0.0, CHAIN.q0, BENT_V) for kind in (False, True))
    assert np.allclose(thin.vdot, full.vdot, rtol=0, atol=1e-11 * np.abs(full.vdot).max())
    assert np.allclose(thin.lam, full.lam, rtol=0, atol=1e-11 * np.abs(full.lam).max())


class Doubled(planar_chain.PlanarChain):
    """The last joint stated twice."""

    def constraint(self, t, q):
        rows = super().constraint(t, q)
        return jnp.concatenate([rows, rows[-2:]])


def test_dependent_rows_of_a_large_system_end_as_a_singular_level():
    system = Doubled(m=CHAIN.system.m, l=CHAIN.system.l)
    assert AccelerationLevel(derive(system, 0.0, CHAIN.q0, CHAIN.v0)).solve(0.0, CHAIN.q0, CHAIN.v0).singular


def test_an_inconsistent_start_of_a_large_system_is_projected(chain):
    levels = ConstraintLevels(chain)
    place = PhasePoint(0.0, CHAIN.q0 + 1e-5 * np.sin(np.arange(CHAIN.q0.size)), BENT_V)
    assert check_start(chain, levels, place, (None, None)) is not None
    projected, note = project(chain, place, Work())
    assert check_start(chain, levels, projected, (None, None)) is None and "moved q0" in note


def test_nothing_of_size_n_times_n_is_made_for_ten_thousand_links():
    """A full matrix would have 7 GB; deriving and looking at the mass takes none of it."""
    problem = planar_chain.problem(n_links=10_000)
    dynamics = derive(problem.system, 0.0, problem.q0, problem.v0)
    assert isinstance(dynamics.constant_mass, Diagonal) and isinstance(dynamics.inverse_mass, Diagonal)
    assert large(dynamics) is not None
    told = {row.subject: row.text for row in describe(problem).about("linear algebra")}
    assert "sparse LU" in told["acceleration level"] and "band LU" in told["HHT step"]


def test_a_full_or_singular_mass_is_not_taken_for_a_diagonal():
    full = np.diag([1.0, 2.0, 3.0, 1.5, 2.5, 0.5])
    full[0, 1] = full[1, 0] = 0.1
    assert matrix_free(derive(Mixed(mass_matrix=full), T, Q, V)) is None
    assert matrix_free(derive(Mixed(mass_matrix=np.array([1.0, 0.0, 1, 1, 1, 1])), T, Q, V)) is None


def banded(n=200, width=2, seed=0):
    """A positive definite matrix whose entries of very different sizes are in a band before its rows were shuffled."""
    draw = np.random.default_rng(seed)
    entries = np.triu(np.tril(draw.normal(size=(n, n)), width), -width)
    matrix, size = entries @ entries.T + np.eye(n), np.exp(3.0 * draw.normal(size=n))
    order = draw.permutation(n)
    return (matrix * np.outer(size, size))[np.ix_(order, order)]


def test_a_mass_of_few_entries_multiplies_and_divides_like_the_full_one():
    matrix, x = banded(), np.random.default_rng(1).normal(size=200)
    mass = compact(matrix, jnp)
    assert isinstance(mass, Sparse) and isinstance(mass.inverse(), BandInverse)
    assert mass.values.size < 0.2 * matrix.size
    np.testing.assert_array_equal(np.asarray(mass), matrix)
    np.testing.assert_array_equal(full(mass, jnp), matrix)
    np.testing.assert_array_equal(mass.diagonal, np.diag(matrix))
    expected = matrix @ x
    np.testing.assert_allclose(mass @ x, expected, rtol=0.0, atol=1e-14 * np.abs(expected).max())
    size = np.sqrt(np.diag(matrix))  # the condition of the scaled matrix counts
    expected = np.linalg.solve(matrix / np.outer(size, size), x)
    np.testing.assert_allclose(size * (mass.inverse() @ (size * x)), expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("route", ["machine code", "xla"])
def test_factors_of_a_band_that_varies_divide_like_the_full_matrix(route):
    matrix, x = banded(120), np.random.default_rng(1).normal(size=120)
    entries = entries_at(120, np.flatnonzero(matrix))
    divide = lambda dynamics, values: entries.inverse(entries.of(values.reshape(120, 120), jnp), jnp) @ x  # noqa: E731
    if route == "xla":
        found = jax.jit(partial(divide, None))(matrix.ravel())
    else:
        found = native_call(native(divide, FREE, shapes=((14400,),)), ((14400,),))(matrix.ravel())
    size = np.sqrt(np.diag(matrix))
    expected = np.linalg.solve(matrix / np.outer(size, size), x / size)
    np.testing.assert_allclose(size * found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


def asymmetric(matrix):
    matrix[0, np.flatnonzero(matrix[0])[1]] *= 1.5


def indefinite(matrix):
    matrix[3, 3] *= 1e-3


def singular(matrix):
    matrix[5], matrix[:, 5] = 0.0, 0.0
    matrix[5, 5] = 1e-15 * matrix.max()
    i, j = 5, 6
    matrix[i], matrix[:, i] = matrix[j], matrix[:, j]
    matrix[i, i] = matrix[i, j] = matrix[j, i] = matrix[j, j]


def wide(matrix):
    matrix[0] = matrix[:, 0] = 1e-3 * np.sqrt(np.diag(matrix) * matrix[0, 0])
    matrix[0, 0] *= 1e6


@pytest.mark.parametrize("change", [asymmetric, indefinite, singular, wide])
def test_a_mass_that_has_no_band_for_an_inverse_stays_full(change):
    matrix = banded()
    change(matrix)
    assert compact(matrix, jnp) is matrix


def test_a_large_mass_of_few_entries_is_found_in_a_full_one():
    class Strip(System):
        mass_matrix = banded(300)

        def force(self, t, q, v):
            return -q

    dynamics = derive(Strip(), 0.0, np.ones(300), np.ones(300))
    assert isinstance(dynamics.constant_mass, Sparse) and isinstance(dynamics.inverse_mass, BandInverse)
    assert matrix_free(dynamics).structure.mass == "sparse" and dynamics.structure.mass == "constant"
