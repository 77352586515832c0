"""Step control that remembers how Newton's iteration converged: guesses from unequal steps, cost on stiff scenes."""

import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.step.attempt import lagrange


def test_weights_of_guesses_are_those_of_the_polynomial_through_the_points():
    times, t = np.array([0.3, -0.2, -1.1]), 0.9
    for degree in (1, 2):
        points = times[: degree + 1]
        weights = lagrange(t, *times, degree == 2)
        for values in np.eye(3)[:, : degree + 1][: degree + 1]:
            expected = np.polyval(np.polyfit(points, values, degree), t)
            assert np.dot(weights[: degree + 1], values) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("damping", [3.5e3, 3.5e6])
def test_stiff_bushings_cost_less_at_loose_tolerances_and_steps_are_hardly_ever_begun_again(damping):
    problem = hb.load_problem("bushing_chain", c=damping)
    counters = [hb.solve(problem, "hht", rtol=rtol).counters for rtol in (1e-2, 1e-3, 1e-4)]
    evaluations = [c.residual_evaluations for c in counters]
    assert evaluations == sorted(evaluations)
    for c, most in zip(counters, (8, 6, 6), strict=True):
        assert c.residual_evaluations <= most * c.steps_accepted
        assert c.steps_rejected_newton <= 0.02 * c.steps_accepted


def test_steps_after_a_failure_stay_shorter_than_the_one_that_failed_and_a_checkpoint_keeps_that():
    problem = hb.load_problem("bushing_chain", c=3.5e6)
    solvers = [HHT(problem.system) for _ in range(2)]
    whole, parts = solvers
    for solver in solvers:
        solver.init_step(problem.t_span[0], problem.q0, problem.v0, rtol=1e-2)
    while whole.counters.steps_rejected_newton == 0:
        whole.step()
        parts.step()
    memory = whole.state.memory
    assert memory.bound is not None and memory.h_next > 0.0
    resumed = HHT(problem.system)
    resumed.resume(parts.checkpoint())
    for _ in range(10):
        bound = whole.state.memory.bound
        whole.step(), resumed.step()
        assert abs(whole.state.h) <= bound * (1 + 1e-9)
        assert whole.state.q.tobytes() == resumed.state.q.tobytes()
