"""Intervals, steps, output times and budgets at their extremes (rows O1, O4, O5, O7, S1 to S5, S7 to S9 of the matrix)."""

import numpy as np
import pytest

from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import ALPHAS, JAX_PENDULUM, PENDULUM, Q0, SYSTEMS, V0, Calls, pendulum_at, tension_at


@pytest.mark.parametrize("route", SYSTEMS)
def test_a_step_longer_than_the_interval_is_the_interval(route):
    long = HHT(SYSTEMS[route]).solve((0.0, 0.01), Q0, V0, step=5.0)
    exact = HHT(SYSTEMS[route]).solve((0.0, 0.01), Q0, V0, steps=1)
    assert np.array_equal(long.t, [0.0, 0.01])
    assert np.array_equal(long.q, exact.q)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("asked", [None, [0.0, 0.05, 0.15, 0.205, 1.0]])
def test_the_step_budget_counts_over_the_whole_interval_and_keeps_its_steps(alpha, asked):
    hht = HHT(JAX_PENDULUM, alpha=alpha)
    solution = hht.solve((0.0, 1.0), Q0, V0, step=0.01, max_num_steps=20, t_eval=asked)
    assert solution.status is Status.max_steps
    assert not solution.success
    assert solution.counters.steps_accepted == 20
    assert len(solution.steps_data.t) == 20
    assert len(solution.t) == (21 if asked is None else 3)
    assert "20 steps" in solution.message
    assert hht.solve((0.0, 0.2), Q0, V0, step=0.01, max_num_steps=20).success  # exactly enough
    assert hht.solve((0.0, 0.5), Q0, V0, step=0.01, max_num_steps=None).success


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("budget", [1, 2, 5, 40])
def test_a_spent_budget_of_evaluations_is_named_even_at_the_start(route, budget):
    solution = HHT(SYSTEMS[route]).solve((0.0, 1.0), Q0, V0, step=0.01, max_evaluations=budget)
    assert solution.status is Status.evaluation_budget
    assert f"{budget} evaluations" in solution.message
    assert solution.counters.residual_evaluations <= budget
    each = 20 if route == "numpy" else 2  # with differences of the constraints
    assert solution.counters.output_evaluations <= each * len(solution.t), "what is handed over is completed"
    assert solution.counters.nonfinite_evaluations == 0


@pytest.mark.parametrize("route", SYSTEMS)
def test_a_spent_budget_of_seconds_is_named_even_at_the_start(route):
    solution = HHT(SYSTEMS[route]).solve((0.0, 1.0), Q0, V0, step=0.01, max_seconds=1e-9)
    assert solution.status is Status.deadline
    assert "seconds" in solution.message


@pytest.mark.parametrize("asked", [None, [0.5], [0.5, 0.5]])
@pytest.mark.parametrize("how", [{"step": 0.1}, {"steps": 7}])
def test_an_empty_interval_succeeds_without_a_step(asked, how):
    calls = Calls()
    solution = HHT(NumpySystem(**calls.wrap(PENDULUM))).solve((0.5, 0.5), Q0, V0, t_eval=asked, **how)
    assert solution.status is Status.success
    assert np.array_equal(solution.t, [0.5] if asked is None else asked)
    assert np.array_equal(solution.q, [Q0] * len(solution.t))
    assert np.array_equal(solution.v, [V0] * len(solution.t))
    assert solution.counters.steps_accepted == solution.counters.newton_iterations == 0
    assert calls.count["force_jacobians"] == 0  # only the step needs them
    assert np.array_equal(solution(0.5).q, Q0)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
def test_forward_and_back_returns_to_the_start(alpha, route):
    hht = HHT(SYSTEMS[route], alpha=alpha)
    there = hht.solve((0.0, 0.5), Q0, V0, step=0.005)
    back = hht.solve((0.5, 0.0), there.q[-1], there.v[-1], step=0.005)
    assert back.success
    assert back.t[0] == 0.5
    assert back.t[-1] == 0.0
    assert np.all(np.diff(back.t) < 0)
    q, v = pendulum_at(there.t)
    error = max(np.max(np.abs(there.q - q)), np.max(np.abs(there.v - v)))  # stands for the tolerance at fixed steps
    assert np.max(np.abs(back.q[-1] - Q0)) <= 100 * error
    assert np.max(np.abs(back.v[-1] - V0)) <= 100 * error
    assert error < 1e-3
    asked = hht.solve((0.5, 0.0), there.q[-1], there.v[-1], step=0.005, t_eval=[0.5, 0.25, 0.0])
    assert np.array_equal(asked.q[1], back.q[50])


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("origin", [1e9, -1e9])
def test_the_origin_of_time_does_not_matter(alpha, route, origin):
    hht = HHT(SYSTEMS[route], alpha=alpha)
    here, there = (hht.solve((t0, t0 + 1.0), Q0, V0, step=0.01) for t0 in (0.0, origin))
    assert there.success
    assert there.t[-1] == origin + 1.0
    assert len(there.t) == len(here.t)
    for name in ("q", "v", "lam"):
        assert np.max(np.abs(getattr(here, name) - getattr(there, name))) <= 1e-7


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize(
    "how", [{"step": 0.01}, {"step": 0.1}, {"steps": 11}, {"steps": [0.9, 0.1]}, {"steps": [0.01] * 100}], ids=str
)
def test_steps_below_the_spacing_of_time_are_named_and_none_is_accepted(route, how):
    """At 1e15 s doubles are 1/8 s apart."""
    solution = HHT(SYSTEMS[route]).solve((1e15, 1e15 + 1.0), Q0, V0, **how)
    assert np.all(np.diff(solution.t) > 0)
    if how != {"steps": [0.9, 0.1]}:
        assert solution.status is Status.time_resolution
        assert "1000000000000000" in solution.message
    ends = np.r_[1e15, solution.steps_data.t]
    assert np.all(ends[:-1] + solution.steps_data.h != ends[:-1])


def test_stepping_by_hand_stops_at_the_spacing_of_time():
    hht = HHT(JAX_PENDULUM)
    assert hht.init_step(1e15, Q0, V0, step=0.01) is Status.success
    assert hht.step() is Status.time_resolution
    assert hht.state.t == 1e15


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", [*SYSTEMS, "skate", "free"])
@pytest.mark.parametrize(
    ("t0", "t1"),
    [
        (0.0, 1e-15),
        (1.0, np.nextafter(1.0, 2.0)),
        (1.0, np.nextafter(1.0, 0.0)),
        (0.0, 1e-8),
    ],
)
def test_the_shortest_intervals_succeed_and_leave_the_state(alpha, route, t0, t1):
    system = {**SYSTEMS, "skate": SKATE, "free": FREE}[route]
    q0, v0 = (SKATE_Q, SKATE_V) if route == "skate" else (Q0, V0)
    solution = HHT(system, alpha=alpha).solve((t0, t1), q0, v0, step=1e-3)
    assert solution.success, solution.message
    assert np.array_equal(solution.t, [t0, t1])
    moved = abs(t1 - t0) * 20.0  # accelerations stay below 20
    assert np.all(np.abs(solution.q[-1] - q0) <= np.maximum(np.spacing(np.abs(q0)), moved))
    assert np.all(np.abs(solution.v[-1] - v0) <= np.maximum(np.spacing(np.abs(v0)), moved))
    for values in (solution.lam, solution.mu, solution.steps_data.a, solution([t0, 0.5 * (t0 + t1), t1]).v):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("t1", [5e-324, 1e-300, 1e-200])
@pytest.mark.parametrize("how", [{"steps": 1}, {"rtol": 1e-5}], ids=str)
def test_an_interval_whose_square_is_zero_ends_by_name(t1, how):
    solution = HHT(JAX_PENDULUM).solve((0.0, t1), Q0, V0, **how)
    assert solution.status is Status.time_resolution, solution.message
    assert np.array_equal(solution.t, [0.0])


SKATE_Q, SKATE_V = np.array([0.1, 0.2, 0.3]), np.array([np.cos(0.3), np.sin(0.3), 0.7])
SKATE = NumpySystem(
    force=lambda t, q, v: np.array([0.0, -1.0, 0.0]),
    velocity_constraint=lambda t, q, v: np.array([np.sin(q[2]) * v[0] - np.cos(q[2]) * v[1]]),
    velocity_constraint_jacobian=lambda t, q, v: np.array([[np.sin(q[2]), -np.cos(q[2]), 0.0]]),
)
FREE = NumpySystem(force=lambda t, q, v: np.array([0.0, -9.81]))


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


@pytest.mark.parametrize("span", [(0.0, 1.0), (0.3, 1.7), (1.0, 0.1), (-1.0, 0.1)])
@pytest.mark.parametrize("how", [{"step": 0.1}, {"step": 0.03}, {"steps": 7}, {"steps": 6}])
def test_the_last_time_is_the_end_exactly_and_times_are_strictly_monotone(span, how):
    solution = HHT(JAX_PENDULUM).solve(span, Q0, V0, **how)
    assert solution.success
    assert solution.t[0] == span[0]
    assert solution.t[-1] == span[1]
    assert np.all(np.diff(solution.t) * np.sign(span[1] - span[0]) > 0)
    lengths = solution.steps_data.h
    again = HHT(JAX_PENDULUM).solve(span, Q0, V0, steps=np.abs(lengths))
    assert again.t[-1] == span[1]


def test_one_row_per_asked_time_with_duplicates():
    asked = [0.0, 0.0, 0.013, 0.05, 0.05, 0.0999, 0.1, 0.1]
    hht = HHT(JAX_PENDULUM)
    solution = hht.solve((0.0, 0.1), Q0, V0, step=0.01, t_eval=asked)
    assert np.array_equal(solution.t, asked)
    assert len(solution.q) == len(solution.v) == len(solution.lam) == len(asked)
    every = hht.solve((0.0, 0.1), Q0, V0, step=0.01)
    assert np.array_equal(solution.q[[0, 3, 7]], every.q[[0, 5, 10]])  # step ends are the steps' own values
    assert np.array_equal(solution.lam[[0, 3, 7]], every.lam[[0, 5, 10]])
    assert np.array_equal(solution.q[0], solution.q[1])


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
