"""Positions where the constraints lose rank: the right branch, or a status; never silence (row P7)."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.result import Status


@pytest.mark.parametrize("alpha", [-0.05, -0.3])
def test_four_bars_go_through_their_dead_points_on_the_right_branch(alpha):
    """Horizontal bars at 0.7 s and about every 1.4 s from there on; the closed solution keeps the parallelogram."""
    problem = hb.load_problem("four_bars")
    errors = []
    for tolerance in (1e-3, 1e-4):
        solution = hb.load_solver(f"hht(alpha={alpha})").solve(problem, hb.Request(rtol=tolerance))
        assert solution.success
        errors.append(np.abs(solution.q[-1] - problem.exact(solution.t[-1]).q).max())
    assert errors[1] < 0.05
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize("steps", [50, 333, 1000])
def test_prescribed_steps_through_a_dead_point_keep_the_branch_or_tell(steps):
    """What cannot be right must not be called success: the energy tells a wrong branch taken with a jump of v."""
    problem = hb.load_problem("four_bars(t_end=1.0)")
    solution = hb.load_solver("hht").solve(problem, hb.Request(steps=steps))
    if solution.status is not Status.success:
        assert solution.status in (Status.newton_failed, Status.singular_iteration_matrix)
        return
    exact = np.array([problem.exact(float(t)).q for t in solution.t])
    assert np.abs(solution.q - exact).max() < 12 * steps**-2.0, "measured 9 h^2; the other branch is 1 m away"
