"""Redundant rows are left out: same motion, multipliers of least norm, and a status where that is not possible."""

import re
import time
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

from hhtbench.api import solve
from hhtbench.lowering import derive, minimum_norm, padded, reduce_redundant, redundant_rows, unreduced
from hhtbench.lowering.dynamics import rank
from hhtbench.protocol.events import Event
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution import counting
from hhtbench.solution.result import Status
from solvers.hht import HHT

Q0, V0 = np.array([1.0, 0.0]), np.array([0.0, 2.0])
SOLVERS = [
    ("hht", {"steps": 400}, 3e-4),
    ("ida(form=ggl)", {"rtol": 1e-8}, 1e-5),
    ("scipy(method=DOP853)", {"rtol": 1e-8}, 1e-5),
    ("collocation(form=index2)", {"rtol": 1e-8}, 1e-7),
    ("projected(method=DOP853)", {"rtol": 1e-8}, 1e-7),
]


class Once(System):
    """A bead on a ring under gravity."""

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1) / 2])


class Twice(Once):
    """The same row three times, at three sizes."""

    def constraint(self, t, q):
        return jnp.array([1.0, 3.7, 1e-8]) * (q @ q - 1) / 2


class Held(Twice):
    """A velocity row that repeats the derivative of a position row."""

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1) / 2])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([q @ v])


def numpy_twice():
    return NumpySystem(
        force=lambda t, q, v: np.array([0.0, -1.0]),
        constraint=lambda t, q: np.array([1.0, 2.0]) * (q @ q - 1) / 2,
        constraint_jacobian=lambda t, q: np.array([q, 2 * q]),
    )


def bead(system):
    return Problem(name="bead", system=system, t_span=(0.0, 2.0), q0=Q0, v0=V0)


@pytest.mark.parametrize(("solver", "request_", "bound"), SOLVERS, ids=lambda x: x if isinstance(x, str) else "")
def test_the_motion_is_that_of_one_row_and_multipliers_are_the_smallest(solver, request_, bound):
    once = solve(bead(Once()), solver, t_eval=[0.7, 2.0], **request_)
    with pytest.warns(UserWarning, match=r"redundant constraints: rank 1 of 3 rows"):
        thrice = solve(bead(Twice()), solver, t_eval=[0.7, 2.0], **request_)
    assert thrice.status is Status.success
    np.testing.assert_allclose(thrice.q, once.q, atol=bound)
    np.testing.assert_allclose(thrice.v, once.v, atol=3 * bound)
    weights = np.array([1.0, 3.7, 1e-8])
    expected = once.lam * weights / (weights @ weights)  # the pseudo-inverse of one row
    np.testing.assert_allclose(thrice.lam, expected, atol=10 * bound)


def falling_along_a_rail(tilt=0.0, off=0.0):
    """Two rails, the second off by a length and turned by an angle less than ranks are told apart by."""

    class Leaning(Once):
        def constraint(self, t, q):
            return jnp.stack([q[0] - 1, q[0] + tilt * q[1] - 1 - off])

    with pytest.warns(UserWarning, match="redundant"):
        return solve(Problem(name="rail", system=Leaning(), t_span=(0, 1), q0=[1, 0], v0=[0, 0]), "hht", rtol=1e-4)


@pytest.mark.parametrize(("off", "held"), [(0.0, 1e-15), (1e-11, 1e-11)])
def test_the_message_tells_which_rows_were_left_out_and_how_well_they_hold(off, held):
    found = falling_along_a_rail(off=off)
    assert found.success
    told = re.search(r"Rows \[1\] of \[g; k\] .* hold to (\S+) of their size", found.message)
    assert told is not None
    assert 0.1 * held * (off > 0) <= float(told[1]) <= 2 * held


def test_without_a_row_nothing_is_said_of_how_well_they_hold():
    with pytest.warns(UserWarning, match="redundant"):
        found = HHT(Twice()).solve((0.0, 1.0), [1.0, 0.0], [0.0, 0.0], step=0.1, t_eval=[1.0], max_num_steps=2)
    assert found.status is Status.max_steps and found.t.size == 0
    assert "were left out" in found.message and "hold to" not in found.message


@pytest.mark.parametrize("tilt", [1e-10, 1e-11, 1e-12])
def test_a_row_left_out_that_is_violated_by_more_than_roundoff_was_none_that_followed_from_others(tilt):
    """Both rails hold the bead still; without the second it falls by 5 m, which violates that by 1e-12 of its size only."""
    found = falling_along_a_rail(tilt=tilt)
    assert found.status is Status.redundant_constraints and "nearly dependent" in found.message
    assert np.abs(found.q[:, 1]).max(initial=0.0) < 1e-12 / tilt


@pytest.mark.parametrize("solver", ["hht", "ida(form=ggl)"])
@pytest.mark.parametrize("make", [Held, numpy_twice], ids=["a velocity row", "plain callables"])
def test_redundancy_is_found_in_velocity_rows_and_in_plain_callables(solver, make):
    how = {"steps": 400} if solver == "hht" else {"rtol": 1e-8}
    once = solve(bead(Once()), solver, t_eval=[2.0], **how)
    with pytest.warns(UserWarning, match="redundant constraints"):
        found = solve(bead(make()), solver, t_eval=[2.0], **how)
    assert found.status is Status.success
    np.testing.assert_allclose(found.q, once.q, atol=1e-4)
    assert found.lam.shape[1] + found.mu.shape[1] == 2


@pytest.mark.parametrize("solver", ["hht", "ida(form=ggl)"])
def test_contradictory_rows_are_an_inconsistent_start(solver):
    class Contradiction(Once):
        def constraint(self, t, q):
            return jnp.array([1.0, 1.0]) * (q @ q - 1) / 2 + jnp.array([0.0, 0.1])

    how = {"steps": 10} if solver == "hht" else {"rtol": 1e-6}
    with pytest.warns(UserWarning, match="redundant"):
        solution = solve(bead(Contradiction()), solver, **how)
    assert solution.status is Status.inconsistent_initial
    assert "g[1] = 0.1" in solution.message


@pytest.mark.parametrize("solver", ["hht", "ida(form=ggl)"])
def test_a_declared_reaction_may_need_every_multiplier(solver):
    class Own(Twice):
        def reaction(self, t, q, lam):
            return -q * (lam[0] + 3.7 * lam[1] + 1e-8 * lam[2])

    how = {"steps": 10} if solver == "hht" else {"rtol": 1e-6}
    assert solve(bead(Own()), solver, **how).status is Status.redundant_constraints


def test_reduced_functions_are_rows_of_the_whole():
    whole = derive(Held(), 0.0, Q0, V0)
    assert reduce_redundant(derive(Twice(), 0.0, Q0, V0), (1, 2)).structure.m == 1
    reduced = reduce_redundant(whole, (1,))
    assert (reduced.structure.m, reduced.structure.p) == (1, 0)
    assert unreduced(reduced) is whole
    np.testing.assert_array_equal(reduced.constraint_jacobian(0.0, Q0), whole.constraint_jacobian(0.0, Q0))
    lam, mu = padded(reduced, np.array([[2.0]]), np.zeros((1, 0)))
    np.testing.assert_array_equal(np.concatenate([lam, mu], axis=1), [[2.0, 0.0]])
    assert redundant_rows(reduced) == (1,)
    np.testing.assert_allclose(minimum_norm(np.array([[1.0, 0.0], [2.0, 0.0]]), np.array([5.0, 0.0]), (1,)), [1.0, 2.0])


def test_the_smallest_multipliers_do_not_jump_where_a_state_is_off_the_constraints():
    """Rows that are independent by 1e-8 only, as they are in a state with that error."""
    rows, x = np.array([[1.0, 0.0], [1.0, 1e-8]]), np.array([2.0, 0.0])
    np.testing.assert_allclose(minimum_norm(rows, x, (1,)), [1.0, 1.0], atol=1e-7)


def test_rows_of_other_sizes_leave_multipliers_of_others_alone():
    """Those of a row of 1e5 were off by 1e-5 of themselves, for the roundoff of those of a row of 1e-5 that has a double."""
    rows = np.array([[1e5, 0.0, 0.0, 0.0], [0.0, 0.0, 3e-6, 5e-6], [0.0, 0.0, 0.3, 0.5], [0.0, 0.0, 0.3, 0.5]])
    given = np.array([2.3e-4, 3.5e7, 0.0, 0.0])
    found = minimum_norm(rows, given, (2, 3))
    assert abs(found[0] - given[0]) < 1e-15 * given[0]
    np.testing.assert_allclose(rows.T @ found, rows.T @ given, rtol=1e-13)
    np.testing.assert_allclose(found[1:], 175.0 * np.array([1e-5, 1.0, 1.0]), rtol=1e-4)


@pytest.mark.parametrize("given", [[3e24, 0.0, 7e74], [3e8, 0.0, 7e74], [0.0, 0.0, 7e74]], ids=str)
@pytest.mark.parametrize("sparse", [False, True])
def test_nor_do_rows_in_tiny_units_take_a_share_by_roundoff(given, sparse):
    """A double of a rod beside a blade whose rows are 1e66 times smaller."""
    rows = np.array([[0.3e66, 0.7e66], [0.9e66, 2.1e66], [0.6, -0.1]])
    found = minimum_norm(sp.csr_array(rows) if sparse else rows, np.array(given), (1,))
    assert found[2] == given[2]
    np.testing.assert_allclose(found[:2], given[0] * np.array([0.1, 0.3]), rtol=1e-12)


class Tangent(System):
    """A bead on a rail that a second rail touches at the start: rows that are dependent there and nowhere else."""

    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return jnp.stack([q[1], q[1] - q[0] ** 2])


@pytest.mark.parametrize("solver", ["hht", "projected(method=DOP853)", "ida(form=ggl)"])
def test_rows_end_before_a_row_that_was_left_out_is_violated(solver):
    how = {"steps": 10} if solver == "hht" else {"rtol": 1e-6}
    problem = Problem(name="rails", system=Tangent(), t_span=(0.0, 1.0), q0=[0.0, 0.0], v0=[1.0, 0.0])
    with pytest.warns(UserWarning, match="redundant"):
        solution = solve(problem, solver, **how)
    assert solution.status is Status.redundant_constraints, solution.message
    assert np.abs(solution.q[:, 0] ** 2).max() < 1e-3


def test_steps_and_events_go_where_rows_are_lost():
    hht = HHT(Tangent(), events=[Event(lambda t, q, v: t - 0.5), Event(lambda t, q, v: t - 0.05)])
    with pytest.warns(UserWarning, match="redundant"):
        solution = hht.solve((0.0, 1.0), [0.0, 0.0], [1.0, 0.0], steps=1000, t_eval=[0.0, 1e-5, 0.9])
    assert solution.status is Status.redundant_constraints, solution.message
    assert "smaller steps" not in solution.message
    assert solution.t.tolist() == [0.0]
    assert solution.t_events == ()
    assert solution.steps_data is None and solution.interpolant is None


class Thrown(Tangent):
    """The bead comes back to where the rails touch, exactly at 2 s: steps know constant forces."""

    def force(self, t, q, v):
        return jnp.array([-1.0, 0.0])


def test_a_violation_that_is_over_at_the_only_row_is_seen_at_the_steps():
    with pytest.warns(UserWarning, match="redundant"):
        solution = HHT(Thrown()).solve((0.0, 2.0), [0.0, 0.0], [1.0, 0.0], steps=100, t_eval=[2.0])
    assert solution.status is Status.redundant_constraints
    assert solution.t.size == 0
    assert "g[1] is off" in solution.message


@pytest.mark.filterwarnings("ignore:redundant constraints")
def test_rows_that_nobody_has_checked_are_no_success(monkeypatch):
    """By a clock on which the multipliers of least norm of each row take a second more."""
    late, smallest = [0.0], rank.minimum_norm
    monkeypatch.setattr(counting, "time", SimpleNamespace(perf_counter=lambda: time.perf_counter() + late[0]))

    def slowly(*given):
        late[0] += 1.0
        return smallest(*given)

    monkeypatch.setattr(rank, "minimum_norm", slowly)
    solution = solve(bead(Twice()), "hht", steps=50, max_seconds=20.0)
    assert solution.status is Status.deadline
    known = int(re.search(r"ended when (\d+) of 51 rows were checked", solution.message)[1])
    assert 0 < known <= 23
    assert solution.t.size == 51, "no row is lost"
    assert np.array_equal(solution.lam[:, 1] != 0.0, np.arange(51) < known)


def test_multipliers_of_rows_that_vanish_on_the_way_are_none():
    """A double whose factor ends: its row is zero from there on, and what is divided by its size was nan."""

    class Ending(System):
        def force(self, t, q, v):
            return jnp.stack([0.0 * t, -9.81 + 0.0 * t])

        def constraint(self, t, q):
            return jnp.stack([(q @ q - 1.0) / 2.0, jnp.maximum(0.5 - t, 0.0) * (q @ q - 1.0)])

    solution = HHT(Ending()).solve((0.0, 1.0), [1.0, 0.0], [0.0, 0.0], step=0.1)
    assert solution.success and np.isfinite(solution.lam).all()
    assert solution.lam[-1] == pytest.approx([np.sum(solution.v[-1] ** 2) - 9.81 * solution.q[-1, 1], 0.0])
