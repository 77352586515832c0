"""What a solve accepts as its start: consistent data; checked inputs are rows I1 to I8 of the acceptance matrix."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0, Pendulum

STEPS = {"steps": 20}
SPAN = (0.0, 0.2)


POINTS = np.array([[1.07901, -1.041988], [0.0, 1.5], [-0.555727, -0.575472], [1.283995, 0.203365], [0.0, 0.0]])
RODS = np.array([(0, 4), (1, 4), (2, 4), (3, 4), (2, 3), (0, 3)])  # the last point is fixed
MASSES = [3e-4, 1e5, 3e-6, 1e3]


def along_rods(q):
    """(6, 2) from end to end."""
    points = np.vstack([q.reshape(4, 2), np.zeros((1, 2))])
    return points[RODS[:, 0]] - points[RODS[:, 1]]


def rows_of_rods(q):
    rows = np.zeros((6, 5, 2))
    for row, (i, j), d in zip(rows, RODS, along_rods(q), strict=True):
        row[i], row[j] = d, -d
    return rows[:, :4].reshape(6, 8)


@pytest.mark.parametrize("unit", [1e-79, 1.0, 1e79])
def test_calc_initcond_does_the_same_in_any_unit(unit):
    """Light and heavy masses on rods: what is on its constraints stays, what is off moves little."""
    given = POINTS[:4].ravel()
    squares = np.sum(along_rods(given) ** 2, axis=1) / 2
    linkage = NumpySystem(
        mass_matrix=np.repeat(MASSES, 2),
        force=lambda t, q, v: np.zeros(8),
        constraint=lambda t, q: np.sum(along_rods(q) ** 2, axis=1) / 2 - squares * unit**2,
        constraint_jacobian=lambda t, q: rows_of_rods(q),
    )
    for off, most in ((0.0, 1e-14), (1e-3, 1e-2)):
        q0 = (given + off * np.array([1, -1, 1, 0, -1, 1, 0, 1])) * unit
        solution = HHT(linkage).solve((0.0, 1e-3), q0, np.zeros(8), steps=1, calc_initcond=True)
        assert solution.success, solution.message
        assert np.abs(solution.q[0] / unit - given).max() <= most
        assert np.abs(np.sum(along_rods(solution.q[0] / unit) ** 2, axis=1) / 2 - squares).max() <= 1e-12


class Free(System):
    def force(self, t, q, v):
        return jnp.zeros(2)


class WrongMass(Free):
    def mass_matrix(self, t, q):
        return jnp.eye(3)


class WrongJacobian(Free):
    def constraint(self, t, q):
        return q[:1]

    def constraint_jacobian(self, t, q):
        return jnp.zeros((2, 2))


@pytest.mark.parametrize(("system", "name"), [(WrongMass(), "mass_matrix"), (WrongJacobian(), "constraint_jacobian")])
def test_sizes_of_a_jax_system_that_disagree_are_an_error_before_any_compilation(system, name):
    with pytest.raises(ValueError, match=rf"{name} must return shape .*got \("):
        HHT(system).solve(SPAN, Q0, V0, **STEPS)


@pytest.mark.parametrize(("off", "moves"), [(0.0, True), (5e-9, False)])
def test_a_start_that_is_off_by_more_than_the_tolerances_allow_is_named_at_the_first_step(off, moves):
    """It counts as consistent: coarser tolerances do with it."""
    fine = HHT(Pendulum()).solve((0.0, 0.01), Q0 * (1.0 + off), V0, rtol=1e-8)
    assert HHT(Pendulum()).solve((0.0, 0.01), Q0 * (1.0 + off), V0, rtol=1e-5).success
    assert (fine.status is Status.success) is moves, fine.message
    if not moves:
        assert fine.status is Status.inconsistent_initial
        assert "g[0] = 5e-09" in fine.message
        assert "Loosen" not in fine.message


def test_a_step_that_may_not_be_shorter_is_not_blamed_on_a_start_of_ten_digits():
    solution = HHT(Pendulum(), min_step=0.3).solve((0.0, 1.0), Q0 * (1.0 + 2e-11), V0, rtol=1e-6)
    assert solution.status is Status.step_too_small
    assert "0.3" in solution.message
