"""Step control that remembers how Newton's iteration converged: guesses from unequal steps, cost on stiff scenes."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

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


class Block(hb.System):
    """A block on a spring and on a belt of 0.5 m/s, with friction that turns within ``width`` [m/s]."""

    width: object = hb.parameter(1e-6)

    def force(self, t, q, v):
        slip = v - 0.5
        return -20.0 * q - 15.0 * slip / jnp.sqrt(slip**2 + self.width**2)


BLOCK = hb.Problem(name="block", system=Block(), t_span=(0.0, 15.0), q0=[0.0], v0=[0.0])


def test_the_bound_after_a_failure_holds_and_is_in_checkpoints():
    whole = HHT(BLOCK.system)
    whole.init_step(0.0, BLOCK.q0, BLOCK.v0, rtol=1e-2)
    whole.step()
    binding = 0
    for _ in range(60):
        before = whole.state.memory
        resumed = HHT(BLOCK.system)
        resumed.resume(whole.checkpoint())
        after = resumed.state.memory
        assert after.bound == before.bound
        whole.step()
        resumed.step()
        assert whole.state.q.tobytes() == resumed.state.q.tobytes()
        if before.bound is not None and before.bound < before.h_next:
            binding += 1
            assert abs(whole.state.h) <= before.bound * (1 + 1e-9)
    assert binding > 0


def test_friction_that_is_nearly_a_jump_is_solved_within_few_evaluations():
    """With a bound that relaxed by 4 % a step it took 20,000 evaluations, in steps of 1e-7 s, and did not end."""
    s = hb.solve(BLOCK, "hht", rtol=1e-3, max_evaluations=20_000)

    def rate(t, y):
        slip = y[1] - 0.5
        return [y[1], -20.0 * y[0] - 15.0 * slip / np.hypot(slip, 1e-6)]

    known = solve_ivp(rate, (0.0, 15.0), [0.0, 0.0], "Radau", rtol=1e-7, atol=1e-9).y[:, -1]
    assert s.success, s.message
    assert s.counters.residual_evaluations < 2_500
    np.testing.assert_allclose([s.q[-1, 0], s.v[-1, 0]], known, atol=0.03)
