"""Events that change the state: impacts, and what the integration keeps across them (rows E1, P11)."""

import numpy as np
import pytest

from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem
from solvers.hht import HHT
from tests.hht.event_scenes import FREE, GRAVITY, HOW, RESTITUTION, clock, height, impacts, wall
from tests.hht.scenes import ALPHAS, Q0, SYSTEMS, V0, tension_at


@pytest.mark.parametrize("origin", [0.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_bouncing_ball_hits_the_floor_when_the_closed_solution_does_from_any_origin_of_time(how, direction, origin):
    """Free fall is a parabola, which the method follows exactly.

    An impact falls between two times: what is left of the height there, however signed, is no second one.
    """
    floor = Event(height, direction=direction, change=lambda t, q, v: (q, -RESTITUTION * v))
    solution = HHT(FREE, events=[floor]).solve((origin, origin + 2.0), [1.0], [0.0], **how)
    assert solution.success, solution.message
    fall = np.sqrt(2.0 / GRAVITY)
    expected = fall + 2 * fall * np.cumsum([0.0, *RESTITUTION ** np.arange(1, 20)])
    expected = expected[expected < 2.0]
    assert len(expected) >= 4
    np.testing.assert_allclose(solution.t_events[0] - origin, expected, rtol=0, atol=1e-14 + 10 * np.spacing(origin))
    if origin == 0.0:
        np.testing.assert_allclose(solution.q_events[0], 0.0, atol=1e-14)
        speeds = GRAVITY * fall * RESTITUTION ** np.arange(len(expected))
        np.testing.assert_allclose(solution.v_events[0][:, 0], -speeds, rtol=1e-13)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_force_that_flips_at_a_known_time_is_right_where_the_flip_is_an_event(alpha, how):
    """A free mass: q = t - a t^2/2 to the flip, then pushed the other way."""
    system = NumpySystem(force=lambda t, q, v: np.array([-GRAVITY if q[1] < 0.5 else GRAVITY, 0.0]))
    flip = clock(0.4321, change=lambda t, q, v: (np.array([q[0], 1.0]), v))
    solution = HHT(system, alpha=alpha, events=flip).solve((0.0, 1.0), [0.0, 0.0], [1.0, 0.0], **how)
    rest = 1.0 - 0.4321
    known = 1.0 - GRAVITY * 0.4321**2 / 2 - GRAVITY * 0.4321 * rest + GRAVITY * rest**2 / 2
    assert solution.q[-1, 0] == pytest.approx(known, abs=1e-5)
    assert np.abs(solution.t - 0.4321).min() < 1e-9


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
def test_impacts_of_a_pendulum_on_a_wall_converge_with_order_two(route, alpha):
    times, rates = impacts(2)
    errors = []
    for step in (0.02, 0.01):
        solution = HHT(SYSTEMS[route], alpha=alpha, events=wall()).solve((0.0, 1.8), Q0, V0, step=step)
        assert solution.success, solution.message
        errors.append([*np.abs(solution.t_events[0] - times), *np.abs(solution.v_events[0][:, 0] - rates)])
    assert np.all(np.array(errors[0]) > 3.5 * np.array(errors[1]))
    assert np.max(errors[1]) < 2e-3


@pytest.mark.parametrize("route", SYSTEMS)
def test_impacts_under_error_control_follow_the_tolerance(route):
    times, _ = impacts(2)
    solution = HHT(SYSTEMS[route], events=wall()).solve((0.0, 1.8), Q0, V0, rtol=1e-5)
    assert np.max(np.abs(solution.t_events[0] - times)) < 2e-5
    assert solution.counters.steps_rejected_error <= 4


@pytest.mark.parametrize("how", [{"step": 0.01}, {"rtol": 1e-5}], ids=str)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_both_levels_hold_to_roundoff_at_an_event_before_and_after_the_change(alpha, how):
    solution = HHT(SYSTEMS["jax"], alpha=alpha, events=wall()).solve((0.0, 0.7), Q0, V0, **how)
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    assert solution.t[row] == solution.t_events[0][0]
    for i in (row, row + 1):
        assert abs(solution.q[i] @ solution.q[i] - 1.0) < 1e-13
        assert abs(solution.q[i] @ solution.v[i]) < 1e-13
        assert abs(solution.lam[i, 0] - tension_at(solution.q[i], solution.v[i])) < 1e-12
    assert abs(solution.q[row, 0]) < 1e-14
    np.testing.assert_allclose(solution.v[row + 1], -RESTITUTION * solution.v[row], atol=1e-13)


def test_a_change_is_projected_onto_both_levels_in_the_norm_of_the_mass():
    kick = clock(0.25, change=lambda t, q, v: (1.1 * q, v + np.array([1.0, 2.0])))
    solution = HHT(SYSTEMS["jax"], events=kick).solve((0.0, 0.5), Q0, V0, step=0.01)
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    q, v = solution.q[row], solution.v[row] + np.array([1.0, 2.0])
    np.testing.assert_allclose(solution.q[row + 1], q, atol=1e-13)  # the closest point of the circle to 1.1 q
    np.testing.assert_allclose(solution.v[row + 1], v - q * (q @ v), atol=1e-13)
    assert np.max(np.abs(np.sum(solution.q**2, 1) - 1)) < 1e-13


def test_prescribed_steps_keep_their_grid_after_an_event():
    solution = HHT(FREE, events=clock(0.25, change=lambda t, q, v: (q, v))).solve((0.0, 1.0), [0.0], [1.0], step=0.1)
    assert set(np.arange(11) / 10) <= set(solution.t)
    assert len(solution.t) == 13
    assert len(solution.steps_data.t) == solution.counters.steps_accepted == 11
    np.testing.assert_allclose(solution.steps_data.h[2:4], 0.05, atol=1e-15)


def test_dense_output_is_that_of_its_side_of_a_change_and_the_new_state_at_it():
    solution = HHT(SYSTEMS["jax"], events=wall()).solve((0.0, 0.7), Q0, V0, step=0.01)
    at = solution.t_events[0][0]
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    assert np.array_equal(solution(at).v, solution.v[row + 1])
    before, after = solution(np.nextafter(at, 0.0)), solution(np.nextafter(at, 1.0))
    np.testing.assert_allclose(before.v, solution.v[row], atol=1e-13)
    np.testing.assert_allclose(after.v, solution.v[row + 1], atol=1e-13)
    asked = HHT(SYSTEMS["jax"], events=wall()).solve((0.0, 0.7), Q0, V0, step=0.01, t_eval=[0.5, at, 0.65])
    assert np.array_equal(asked.v[1], solution.v[row + 1])
    assert np.array_equal(asked.lam[1], solution.lam[row + 1])
    np.testing.assert_allclose(asked.q, solution([0.5, at, 0.65]).q, rtol=0, atol=0)
