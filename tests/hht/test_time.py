"""Times far from the origin, steps too short for them, and budgets that end at the start (more in rows S1 to S9)."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import JAX_PENDULUM, Q0, SYSTEMS, V0, pendulum_at, tension_at


def test_stepping_by_hand_stops_at_the_spacing_of_time():
    hht = HHT(JAX_PENDULUM)
    assert hht.init_step(1e15, Q0, V0, step=0.01) is Status.success
    assert hht.step() is Status.time_resolution
    assert hht.state.t == 1e15


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("lengths", [[0.01, 1e-14, 0.02, 1e-15, 0.07 - 1.1e-14], [1e-15, 0.03, 0.07]], ids=str)
def test_a_run_goes_on_after_a_step_too_short_to_move_anything(route, lengths):
    """The multipliers of such a step are roundoff over h^2; they must not reach the next step or the output."""
    solution = HHT(SYSTEMS[route]).solve((0.0, 0.1), Q0, V0, steps=np.array(lengths))
    assert solution.success, solution.message
    q, v = pendulum_at(solution.t)
    assert np.max(np.abs(solution.q - q)) < 1e-3
    assert np.max(np.abs(solution.v - v)) < 1e-2
    assert np.max(np.abs(solution.lam[:, 0] - tension_at(solution.q, solution.v))) < 1e-7


def test_under_error_control_the_steps_that_are_used_are_those_the_times_have():
    """At 1e9 s doubles are 1.2e-7 s apart: with lengths of their own, 3,000 steps were off by 1e-4 s."""
    hht = HHT(JAX_PENDULUM)
    here, there = (hht.solve((t0, t0 + 0.1), Q0, V0, rtol=1e-8) for t0 in (0.0, 1e9))
    assert there.success
    lengths = there.steps_data.h
    assert np.array_equal(np.diff(there.t), lengths)
    assert np.count_nonzero(np.diff(lengths)) < 0.1 * lengths.size, "equal steps stay equal"
    assert np.max(np.abs(there.q[-1] - here.q[-1])) < 1e-7 / 4


def test_a_constant_step_by_hand_is_the_one_the_times_have():
    hht = HHT(JAX_PENDULUM)
    hht.init_step(1e9, Q0, V0, step=1e-3)
    before = hht.state.t
    for _ in range(50):
        assert hht.step() is Status.success
        assert hht.state.t - before == hht.state.h
        before = hht.state.t
    q, _ = pendulum_at([0.0, hht.state.t - 1e9])
    assert np.max(np.abs(hht.state.q - q[-1])) < 1e-6
    assert hht.state.h == pytest.approx(1e-3, rel=1e-4)


def test_far_from_the_origin_a_tolerance_beyond_the_times_is_named():
    """At 1e12 s they are 1.2e-4 s apart, and 1e-6 needs steps of 6e-4 s: of 5 spacings."""
    solution = HHT(JAX_PENDULUM).solve((1e12, 1e12 + 2.0), Q0, V0, rtol=1e-6, atol=1e-6)
    assert solution.status is Status.time_resolution
    assert "times what the tolerances allow" in solution.message
    assert "shift the time origin" in solution.message


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_a_run_that_fails_in_its_first_step_returns_the_reached_output_times_in_both_directions(end):
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan if t else 0.0]))
    solution = HHT(system).solve((0.0, end), [1.0], [0.0], steps=4, t_eval=[0.0, end / 2, end])
    assert solution.status is hb.Status.nonfinite_callback
    assert solution.t.tolist() == [0.0]
