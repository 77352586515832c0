"""Mechanisms that pass through singular positions: one-degree reductions, ranks, the smooth branch."""

import math

import numpy as np
import pytest

from tests.problems.mechanics import Mechanics, compiled, measured
from tests.problems.published import STORED
from tests.problems.reductions import CRANK_START, WINDOWS_START, integrated, reduced


@pytest.mark.parametrize(
    ("name", "parameters", "n", "start", "before"),
    [
        ("four_bars", {"n_windows": 1}, 1, WINDOWS_START, [0.35, 0.7]),  # horizontal at 0.708 s
        ("four_bars", {}, 2, WINDOWS_START, [0.35, 0.7]),  # at 0.714 s
        ("slider_crank_equal_lengths", {}, None, CRANK_START, [0.12, 0.24]),  # upright at 0.250 s
    ],
)
def test_motion_before_the_singular_position_is_the_one_degree_reduction(make, name, parameters, n, start, before):
    problem = make(name, **parameters)
    measure = measured(problem.system)
    rates = lambda t, y: np.concatenate([np.split(y, 2)[1], measure(*np.split(y, 2))[0]])  # noqa: E731
    found = integrated(rates, np.concatenate([problem.q0, problem.v0]), before)
    for y, (angle, rate) in zip(found, integrated(reduced(n), start, before), strict=True):
        q, v = np.split(y, 2)
        np.testing.assert_allclose(problem.observables["crank_angle"](0.0, q, v, None), angle, rtol=1e-11)
        np.testing.assert_allclose(problem.observables["crank_rate"](0.0, q, v, None), rate, rtol=1e-11)
        if name == "four_bars":
            np.testing.assert_allclose(
                problem.observables["B0"](0.0, q, v, None), [math.sin(angle), math.cos(angle)], atol=1e-11
            )
        else:
            np.testing.assert_allclose(q, [angle, -angle, 2 * math.cos(angle)], atol=1e-11)


@pytest.mark.parametrize("n", [1, 2, None])
def test_one_degree_reduction_goes_through_singular_positions_as_published(n):
    entry = STORED["slider_crank_equal_lengths" if n is None else f"iftomm_A02_fourbar_N{n}"]
    published = np.array([entry[key] for key in (("crank_angle", "crank_rate") if n is None else ("phi", "phid"))], float).T
    times = np.array(entry["t"], float)
    found = integrated(reduced(n), CRANK_START if n is None else WINDOWS_START, times)
    np.testing.assert_allclose(found, published, rtol=0, atol=1e-10)


SMOOTH = [{"n_windows": 1}, {"n_windows": 4, "m": 2.0, "l": 0.5, "g": 4.0, "speed": 0.8}, {"g": 0.0}]


@pytest.mark.parametrize("parameters", SMOOTH)
def test_smooth_branch_of_the_windows_satisfies_constraints_and_equations_of_motion(make, derivative, parameters):
    problem = make("four_bars", **parameters)
    measure, first = measured(problem.system), problem.exact(0.0)
    np.testing.assert_allclose(first.q, problem.q0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(first.v, problem.v0, rtol=0, atol=1e-13)
    for t in (0.13, 0.5, 0.91):
        q, v, lam, _ = problem.exact(t)
        vdot, expected, position, velocity, _ = measure(q, v)
        np.testing.assert_allclose(np.concatenate([position, velocity]), 0.0, atol=1e-13)
        for i, rate in enumerate((v, vdot)):
            found = derivative(lambda s, i=i: problem.exact(s)[i], t, 5e-3)
            np.testing.assert_allclose(found, rate, rtol=0, atol=1e-10 * np.abs(vdot).max())
        np.testing.assert_allclose(lam, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("n", [1, 2, 4])
def test_windows_lose_one_row_each_where_all_bars_are_horizontal_and_carry_unbounded_forces_if_several(make, n):
    """Forces: half the distance to the singular position, twice the axial force; bounded for one window."""
    from problems.four_bars import parallel_multipliers, parallel_state

    rows = Mechanics(compiled(make("four_bars", n_windows=n).system)).position_rows
    rank = lambda phi: np.linalg.matrix_rank(rows(0.0, parallel_state(n, 1.0, phi, 0.0)[0]), tol=1e-10)  # noqa: E731
    assert [rank(phi) for phi in (0.0, 1.5, math.pi / 2, 3 * math.pi / 2)] == [6 * n + 2, 6 * n + 2, 5 * n + 2, 5 * n + 2]
    largest = [np.abs(parallel_multipliers(n, 1.0, 1.0, 9.81, math.pi / 2 - d, 5.0)).max() for d in (1e-3, 1e-6)]
    np.testing.assert_allclose(largest[1] / largest[0], 1.0 if n == 1 else 1000.0, rtol=0.2)


def test_slider_crank_loses_a_row_upright_where_a_second_branch_crosses(make):
    system = Mechanics(compiled(make("slider_crank_equal_lengths").system))
    rank = lambda *q: np.linalg.matrix_rank(system.position_rows(0.0, np.array(q)), tol=1e-10)  # noqa: E731
    a, up = 1.2, math.pi / 2
    assert (rank(a, -a, 2 * math.cos(a)), rank(up, -up, 0.0)) == (2, 1)
    for other in ((a, a - math.pi, 0.0), (up, up - math.pi, 0.0)):
        np.testing.assert_allclose(system.g(0.0, np.array(other)), 0.0, atol=1e-15)
