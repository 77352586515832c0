"""What differences of a NumpySystem cost, and how exact they are."""

import time

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering.dynamics.differences import second_derivative

BARS = 5
MASS = np.diag(np.tile([1.0, 1.0, 1.0 / 12.0], BARS))
WEIGHT = np.tile([0.0, -9.81, 0.0], BARS)
TURN = np.arccos((17**0.5 - 1) / 4)  # [rad] between two bars of the arch: its pins are 3 apart


def half_bar(angle):
    return 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


ANGLES = TURN * (2 - np.arange(BARS))
ENDS = np.cumsum(2.0 * half_bar(ANGLES), axis=0)
Q0 = np.column_stack([ENDS - half_bar(ANGLES), ANGLES]).ravel()


class Chain:
    """Five bars between two pins, n = 15 and m = 12, which counts the calls of its constraint."""

    def __init__(self, pause=0.0):
        self.calls, self.pause = 0, pause

    def constraint(self, t, q):
        self.calls += 1
        time.sleep(self.pause)
        bars = q.reshape(BARS, 3)
        left, right = bars[:, :2] - half_bar(bars[:, 2]), bars[:, :2] + half_bar(bars[:, 2])
        return np.concatenate([left[0], (left[1:] - right[:-1]).ravel(), right[-1] - ENDS[-1]])

    def jacobian(self, t, q):
        angles, rows = q.reshape(BARS, 3)[:, 2], np.zeros((2 * BARS + 2, 3 * BARS))
        along = 0.5 * np.stack([-np.sin(angles), np.cos(angles)], axis=1)
        for i in range(BARS):
            for row, sign, side in ((2 * i, 1, -1), (2 * i + 2, -1 if i < BARS - 1 else 1, 1)):
                rows[row : row + 2, 3 * i : 3 * i + 2] = sign * np.eye(2)
                rows[row : row + 2, 3 * i + 2] = sign * side * along[i]
        return rows

    def solved(self, steps, **declared):
        system = hb.NumpySystem(force=lambda t, q, v: WEIGHT, constraint=self.constraint, mass_matrix=MASS, **declared)
        problem = hb.Problem(name="chain", system=system, t_span=(0.0, 1e-3 * steps), q0=Q0, v0=np.zeros(3 * BARS))
        solution = hb.load_solver("hht").solve(problem, hb.Request(step=1e-3))  # without the check of the result
        assert solution.success, solution.message
        return solution


def test_a_step_by_differences_takes_at_most_a_hundred_calls_all_counted_and_moves_as_by_the_jacobian():
    chain, exact = Chain(), Chain()
    found, expected = chain.solved(50), exact.solved(50, constraint_jacobian=exact.jacobian)
    assert chain.calls <= 100 * 50
    counted = found.counters
    assert counted.residual_evaluations + counted.output_evaluations >= chain.calls
    np.testing.assert_allclose(found.q, expected.q, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.v, expected.v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.lam, expected.lam, rtol=0, atol=1e-8 * np.abs(expected.lam).max())
    assert max(np.abs(chain.constraint(t, q)).max() for t, q in zip(found.t, found.q, strict=True)) < 1e-11
    drift = [np.abs(chain.jacobian(t, q) @ v).max() for t, q, v in zip(found.t, found.q, found.v, strict=True)]
    assert max(drift) < 1e-9


def test_a_declared_pattern_takes_fewer_calls_for_the_same_motion():
    plain, sparse = Chain(), Chain()
    pattern = sparse.jacobian(0.0, Q0 + 0.1) != 0.0
    expected, found = plain.solved(10), sparse.solved(10, sparsity={"constraint_jacobian": pattern})
    assert sparse.calls < 0.6 * plain.calls
    np.testing.assert_allclose(found.v, expected.v, rtol=0, atol=1e-9)


def test_the_message_names_the_derivative_that_would_save_the_time():
    chain = Chain(pause=1e-3)
    assert "declare constraint_jacobian(t, q)." in chain.solved(2).message
    assert "declare" not in chain.solved(2, constraint_jacobian=chain.jacobian, constraint_time_derivative=_no_rate).message


def _no_rate(t, q):
    return np.zeros(2 * BARS + 2)


@pytest.mark.parametrize("pattern", [None, [[1, 1, 0], [0, 1, 1]]])
def test_second_differences_are_the_second_derivatives(pattern):
    function = lambda x: np.array([np.sin(x[0]) * x[1] ** 2, np.exp(x[1] * x[2])])  # noqa: E731
    x, y, z = place = np.array([0.4, -0.7, 1.3])
    first = np.array([[-np.sin(x) * y * y, 2 * y * np.cos(x), 0], [2 * y * np.cos(x), 2 * np.sin(x), 0], [0, 0, 0]])
    cross = 1 + y * z
    second = np.exp(y * z) * np.array([[0, 0, 0], [0, z * z, cross], [0, cross, y * y]])
    found = second_derivative(function, place, np.array([2.0, -3.0]), pattern)
    np.testing.assert_allclose(found, 2.0 * first - 3.0 * second, rtol=0, atol=1e-6)
