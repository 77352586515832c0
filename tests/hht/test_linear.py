"""Acceptance row J5: every kind of linear algebra gives the same steps; which one is chosen; factors outlive a pickle."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from solvers.hht.blocks import find_order
from solvers.hht.choose import analyse, choose
from solvers.hht.engine import HostEngine, layout_of
from solvers.hht.sparse import Band, Splu

from hhtbench import load_problem
from hhtbench.counting import Work
from hhtbench.errors import ProblemError
from hhtbench.lowering.compile.patterns import Pattern
from problems import planar_chain
from solvers._start import Place, dynamics_for
from solvers.hht.options import HHTOptions
from solvers.hht.run.start import first_state
from solvers.hht.step.state import Step

SAME = 1e-11
METHOD = HHTOptions(alpha=-0.1).method()
PROBLEMS = {
    "planar_chain(n_links=6)": 1e-3,  # constant diagonal mass: coloured derivatives
    "bead_chain(n_beads=3)": 1e-3,
    "rolling_disk_incline": 1e-3,  # both kinds of constraints
    "jay_negrut_pendulum": 1e-3,  # variable mass: zeros are sifted from full matrices
}
KINDS = ("dense", "band", "sparse")


def begun(problem, kind, h, method=METHOD):
    place = Place(problem.t_span[0], problem.q0, problem.v0)
    dynamics = dynamics_for(problem.system, place)
    engine = HostEngine(dynamics, method, Work(), choice=choose(dynamics, layout_of(dynamics, method), kind))
    return engine, first_state(engine, place, problem.lam_guess, problem.mu_guess, h)


def stepped(problem, kind, h, count, forget=False):
    engine, state = begun(problem, kind, h)
    for _ in range(count):
        taken = engine.step(replace(state, factor=None) if forget else state, h, state.t + h)
        assert isinstance(taken, Step), taken
        state = taken.state
    return engine, state


def difference(one, other):
    pairs = ((one.q, other.q), (one.v, other.v))
    return max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in pairs)


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_kind_of_linear_algebra_gives_the_same_steps(name):
    problem, h = load_problem(name), PROBLEMS[name]
    runs = {kind: stepped(problem, kind, h, 20) for kind in KINDS}
    assert {engine.choice.linear.kind for engine, _ in runs.values()} == set(KINDS)
    for kind in KINDS[1:]:
        assert difference(runs[kind][1], runs["dense"][1]) < SAME, kind


@pytest.mark.parametrize("kind", KINDS)
def test_a_kept_factor_gives_the_same_steps_as_a_fresh_one(kind):
    problem = load_problem("planar_chain(n_links=6)")
    (kept, one), (fresh, other) = (stepped(problem, kind, 1e-4, 20, forget=forget) for forget in (False, True))
    assert kept.work.counters().factorisations < fresh.work.counters().factorisations
    assert difference(one, other) < SAME


@pytest.mark.parametrize("kind", KINDS)
def test_stepping_on_from_a_pickled_state_gives_the_same_bits(kind):
    problem, h = load_problem("planar_chain(n_links=6)"), 1e-3
    engine, state = stepped(problem, kind, h, 5)
    copy = pickle.loads(pickle.dumps(state))
    right = np.cos(np.arange(engine.layout.size))
    assert np.array_equal(copy.factor.solve(right), state.factor.solve(right))
    assert np.array_equal(copy.factor.change(right), state.factor.change(right))
    one, other = (engine.step(s, h, s.t + h).state for s in (state, copy))
    assert np.array_equal(one.q, other.q) and np.array_equal(one.unknowns, other.unknowns)


def pattern_of(matrix):
    rows, columns = np.nonzero(matrix)
    return Pattern(matrix.shape, rows, columns, np.zeros(matrix.shape[1], dtype=np.int32), 1)


def random_matrix(seed):
    """Block lower triangular bands; many diagonal entries are zero, the rows shuffled, or next to it: pivots must move."""
    lots = np.random.default_rng(seed)
    size = 30
    i, j = np.indices((size, size))
    band = np.where(np.abs(i - j) <= 2, lots.normal(size=(size, size)), 0.0)
    band[np.arange(0, size, 3), np.arange(0, size, 3)] = 1e-18 * (seed % 2)
    coupled = np.where((i // 10 > j // 10) & (lots.random((size, size)) < 0.1), lots.normal(size=(size, size)), 0.0)
    matrix = np.where(i // 10 == j // 10, band, coupled)
    return matrix if seed % 2 else matrix[lots.permutation(size)][:, lots.permutation(size)]


@pytest.mark.parametrize("kind", ["band", "sparse"])
@pytest.mark.parametrize("seed", range(5))
def test_factors_solve_what_they_were_made_of(kind, seed):
    matrix, maps = random_matrix(seed), np.eye(30)[:4] + 2.0 * np.eye(30)[4:8]
    stacked = np.concatenate([matrix, maps])
    analysis = analyse(pattern_of(stacked), 30, kind)
    factor = analysis.factor(np.concatenate([np.zeros(4), stacked[np.nonzero(stacked)]]), 0.1)
    right = np.arange(1.0, 31.0)
    wanted = np.linalg.solve(matrix, right)
    assert np.allclose(factor.solve(right), wanted, rtol=0, atol=1e-13 * np.linalg.cond(matrix) * np.abs(wanted).max())
    assert np.allclose(factor.change(right), maps @ right)
    assert np.allclose(factor.largest(right, 2), [np.abs(maps[:2] @ right).max(), np.abs(maps[2:] @ right).max()])


@pytest.mark.parametrize("kind", ["band", "sparse"])
def test_a_singular_matrix_has_no_factor(kind):
    matrix = np.diag(np.ones(5)) + np.diag(np.ones(4), 1)
    matrix[2, 2:4], matrix[3, 3] = (1.0, 2.0), 2.0
    matrix[3] = matrix[2]
    stacked = np.concatenate([matrix, np.eye(5)[:2]])
    entries = np.concatenate([np.zeros(2), stacked[np.nonzero(stacked)]])
    assert analyse(pattern_of(stacked), 5, kind).factor(entries, 0.1) is None


def test_a_value_that_is_not_finite_shows_in_the_largest_change():
    stacked = np.concatenate([np.eye(3), np.eye(3)[:2]])
    factor = analyse(pattern_of(stacked), 3, "band").factor(np.concatenate([np.zeros(2), np.ones(5)]), 0.1)
    assert np.isnan(factor.largest(np.array([np.nan, 1.0, 1.0]), 1)).all()


def stacked_pattern(matrix):
    return pattern_of(sparse.vstack([sparse.csr_array(matrix), sparse.eye_array(2, matrix.shape[0])]).toarray())


def test_the_kind_follows_size_band_and_fill():
    size = 400
    i, j = np.indices((size, size))
    chain, arrow = np.abs(i - j) <= 3, (i == j) | (i == 0) | (j == 0)
    assert isinstance(analyse(stacked_pattern(chain), size, "auto"), Band)
    assert isinstance(analyse(stacked_pattern(arrow), size, "auto"), Splu)
    assert analyse(stacked_pattern(np.ones((size, size))), size, "auto").kind == "dense"


@pytest.fixture(scope="module")
def long_chain():
    return stepped(planar_chain.problem(n_links=200), "auto", 1e-4, 10)


def test_blocks_that_follow_one_another_are_found(long_chain):
    """Constant forces: accelerations first, then lam0, then lam1; each a band of its own."""
    blocks = long_chain[0].choice.linear.order.blocks
    assert blocks[:, 1].tolist() == [600, 400, 400]
    assert blocks[:, 2:].max() <= 4


def test_a_cycle_is_one_block():
    rows, columns = np.arange(6), np.roll(np.arange(6), 1)
    both = np.concatenate([rows, rows]), np.concatenate([rows, columns])
    assert len(find_order(*both, 6).blocks) == 1


def test_a_long_sequence_of_blocks_stays_one():
    """Row i takes from unknown i - 1 alone: thirty blocks of one would cost more than a band of two diagonals."""
    both = np.concatenate([np.arange(30), np.arange(1, 30)]), np.concatenate([np.arange(30), np.arange(29)])
    assert find_order(*both, 30).blocks[:, 1:].tolist() in ([[30, 1, 0]], [[30, 0, 1]])


def test_small_systems_and_those_with_full_matrices_stay_dense():
    engine, _ = begun(planar_chain.problem(n_links=6), "auto", 1e-3)
    assert engine.choice.linear.kind == "dense" and "below" in engine.choice.linear.reason
    with pytest.raises(ProblemError, match="linsolver must be one of auto, dense, band, sparse"):
        begun(planar_chain.problem(n_links=6), "klu", 1e-3)


def test_steps_of_short_links_converge_to_roundoff_and_the_chain_stays_whole(long_chain):
    """Links of 1/200 m: coordinates of 1 m hold angles to 1e-13 only; the measured roundoff ends the iteration."""
    engine, state = long_chain
    counted = engine.work.counters()
    assert counted.steps_rejected_newton == 0
    assert counted.newton_iterations < 8 * 10
    levels = np.abs(np.asarray(engine.choice.products.constraint(state.t, state.q)))
    assert levels.max() < 1e-14
