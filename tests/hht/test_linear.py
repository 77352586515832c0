"""Acceptance row J5: every kind of linear algebra gives the same steps; factors of any matrix."""

from contextlib import nullcontext

import numpy as np
import pytest

from hhtbench import load_problem
from hhtbench.lowering.compile.coloured import Pattern
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.solution.result import Status
from solvers.hht import HHT
from solvers.kernel.linear.analysis import of_pattern
from solvers.kernel.linear.matrix import factor, moved_by, respond, solve, solve_often
from solvers.kernel.memory import (
    CALLS_PYTHON,
    CHANGE,
    CODE,
    CONVERGED,
    FUNCTIONS,
    LEAST_PIVOT,
    MAPS,
    RANK,
    RECORD,
    RIGHT,
    SINGULAR,
    SOLUTION,
    VALUES,
    view,
)
from tests.sample import slow

SAME = 1e-11
PROBLEMS = {
    "planar_chain(n_links=6)": 1e-3,  # constant diagonal mass
    "bead_chain(n_beads=3)": 1e-3,
    "rolling_disk_incline": 1e-3,  # both kinds of constraints
    "jay_negrut_pendulum": 1e-3,  # variable mass
    "planar_chain(n_links=40)": 1e-4,  # coloured derivatives
}
KINDS = ("dense", "band", "sparse")


def stepped(problem, kind, h, count):
    hht = HHT(problem.system, alpha=-0.1, linsolver=kind)
    status = hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, lam_guess=problem.lam_guess)
    assert status is Status.success
    for _ in range(count):
        assert hht.step() is Status.success, hht.message
    return hht


def difference(one, other):
    pairs = ((one.state.q, other.state.q), (one.state.v, other.state.v))
    return max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in pairs)


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_kind_of_linear_algebra_gives_the_same_steps(name):
    problem, h = load_problem(name), PROBLEMS[name]
    runs = {kind: stepped(problem, kind, h, 20) for kind in KINDS}
    for kind in KINDS:
        assert f"{kind} matrix" in runs[kind].engine_used
        assert difference(runs[kind], runs["dense"]) < SAME, kind


@pytest.mark.parametrize(
    "name, kind", [("spinup_beam(n_elements=16)", "band"), slow("cable_pendulum(dimension=3)", "dense")]
)
def test_a_mass_whose_inverse_fills_is_kept_sparse_where_that_costs_less(name, kind):
    problem = load_problem(name)
    hht = stepped(problem, "auto", 1e-3, 20)
    assert (hht._engine.functions.analysis.kind, hht._engine.structure.mass == "sparse") == (kind, kind == "band")
    full = stepped(problem, "dense", 1e-3, 20)
    assert np.abs(hht.state.v - full.state.v).max() < 1e-11  # m/s; after 20 ms the beam moves with 1e-7 m/s


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("links", [6, 40])
def test_a_factorisation_made_again_from_a_checkpoint_has_the_same_bits(links, kind):
    problem, h = load_problem(f"planar_chain(n_links={links})"), 1e-4
    whole = stepped(problem, kind, h, 5)
    assert whole.state.factorised is not None
    parts = HHT(problem.system, alpha=-0.1, linsolver=kind)
    parts.resume(whole.checkpoint())
    for _ in range(5):
        assert whole.step() is parts.step() is Status.success
        assert np.array_equal(whole.state.q, parts.state.q) and np.array_equal(whole.state.unknowns, parts.state.unknowns)
    assert whole.counters == parts.counters


# --- factors of any matrix


class Factored:
    """A matrix and maps below it in one place of the loops' memory, whose own functions factorise and solve."""

    def __init__(self, matrix, maps, kind, lu=1):
        stacked, size = np.concatenate([matrix, maps]), len(matrix)
        self.analysis, self.lu, self.callbacks = of_pattern(pattern_of(stacked), size, kind), lu, Callbacks()
        assert self.analysis.kind == kind
        self.z = self._memory(len(maps) // 2)
        entries = stacked[np.nonzero(stacked)]
        view(self.z, VALUES)[size:] = entries
        view(self.z, MAPS + lu)[:] = entries[self.analysis.own :]
        with self.callbacks if kind == "sparse" else nullcontext():
            self.ended = factor(self.z, lu, entries)
        assert self.callbacks.take_cause() is None

    def _memory(self, n):
        a = self.analysis
        z = a.memory(n=n, m=0, p=0, inverse_mass=0)
        outside = self.outside = a.outside()  # held: its callbacks refer to it weakly
        if outside is not None:
            z.i[CALLS_PYTHON] = 1
            for name, pair in outside.codes(self.callbacks).items():
                at = CODE + 2 * FUNCTIONS.index(name)
                z.i[at : at + 2] = pair
        return z

    def solve(self, right, how=solve):
        out = np.zeros(right.size)
        with self.callbacks:
            how(self.z, self.lu, right, out)
        return out

    def response(self, right):
        """What a right-hand side makes of the unknowns and of the maps."""
        view(self.z, RIGHT)[:] = right
        with self.callbacks:
            respond(self.z, self.lu)
        return view(self.z, SOLUTION), view(self.z, CHANGE)

    def recorded(self, name):
        return view(self.z, RECORD + self.lu)[name]


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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lu", [0, 1])
def test_factors_solve_what_they_were_made_of(kind, seed, lu):
    matrix, maps = random_matrix(seed), np.eye(30)[:4] + 2.0 * np.eye(30)[4:8]
    factored = Factored(matrix, maps, kind, lu)
    assert factored.ended == CONVERGED
    right = np.arange(1.0, 31.0)
    wanted = np.linalg.solve(matrix, right)
    close = {"rtol": 0, "atol": 1e-13 * np.linalg.cond(matrix) * np.abs(wanted).max()}
    np.testing.assert_allclose(factored.solve(right), wanted, **close)
    solution, change = factored.response(right)
    np.testing.assert_allclose(solution, wanted, **close)
    np.testing.assert_allclose(change, maps @ solution, rtol=1e-14)
    moved = [np.abs(maps[:2] @ right).max(), np.abs(maps[2:] @ right).max()]
    np.testing.assert_allclose(moved_by(factored.z, lu, right), moved)


@pytest.mark.parametrize("kind", ["dense", "band"])
def test_a_small_matrix_that_serves_often_is_inverted(kind):
    matrix = random_matrix(1)
    factored, right = Factored(matrix, np.eye(30)[:2], kind), np.arange(1.0, 31.0)
    found = [factored.solve(right, solve_often) for _ in range(50)]
    assert any(np.any(each != found[0]) for each in found), "by the inverse at last"
    for each in found:
        np.testing.assert_allclose(matrix @ each, right, rtol=0, atol=1e-12 * np.linalg.cond(matrix))


@pytest.mark.parametrize("kind", KINDS)
def test_a_pattern_with_entries_that_vanish_serves_later_matrices(kind):
    """A band of ones whose upper diagonal is zero at first."""
    matrix = np.eye(30) + 0.5 * np.eye(30, k=1)
    factored, right = Factored(matrix, np.eye(30)[:2], kind, lu=0), np.arange(1.0, 31.0)
    stacked = np.concatenate([matrix, np.eye(30)[:2]])
    at = np.nonzero(stacked)
    for upper in (0.0, 0.5):
        now = np.eye(30) + upper * np.eye(30, k=1)
        entries = np.concatenate([now, np.eye(30)[:2]])[at]
        view(factored.z, VALUES)[30:] = entries
        with factored.callbacks:
            factor(factored.z, 0, entries)
        np.testing.assert_allclose(now @ factored.solve(right), right, rtol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_a_singular_matrix_has_no_factor(kind):
    matrix = np.diag(np.ones(5)) + np.diag(np.ones(4), 1)
    matrix[2, 2:4], matrix[3, 3] = (1.0, 2.0), 2.0
    matrix[3] = matrix[2]
    factored = Factored(matrix, np.eye(5)[:2], kind)
    assert factored.ended == SINGULAR
    assert (factored.recorded(LEAST_PIVOT), factored.recorded(RANK)) == (0.0, 4)
