"""Dense output: how accurate it is between steps, and that asking for it changes no step (row S9)."""

import tracemalloc

import numpy as np
import pytest

from hhtbench.solution.result import Status
from solvers.hht import HHT
from solvers.hht.run import history, solve
from tests.hht.event_scenes import wall
from tests.hht.scenes import ALPHAS, GRAVITY, Q0, SYSTEMS, V0, Pendulum, pendulum_at

INSIDE = np.linspace(0.0, 1.0, 41)[1:-1]  # of a step


def local_solution(q, v, times):
    """The unit pendulum's motion from (q, v) at time 0: (k, 2) each, by DOP853."""
    angle, speed = np.arctan2(q[0], -q[1]), q[0] * v[1] - q[1] * v[0]
    return pendulum_at(times, angle, speed)


def hermite(s, h, q1, v1):
    """The cubic (and its derivative) with zero at the start and q1, v1 at the end of a step h."""
    s = s[:, None]
    return s * s * ((3 - 2 * s) * q1 + (s - 1) * h * v1), 6 * s * (1 - s) * q1 / h + s * (3 * s - 2) * v1


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
def test_interpolation_adds_an_error_of_order_four_in_q_and_three_in_v(route, alpha):
    """Against the exact solution from the step's start, after what the step itself has done wrong at its end."""
    found = []
    for h in (0.1, 0.05, 0.025):
        solution = HHT(SYSTEMS[route], alpha=alpha).solve((0.0, h), Q0, V0, steps=1)
        q, v = local_solution(Q0, V0, np.append(INSIDE, 1.0) * h)
        q_step, v_step = hermite(INSIDE, h, solution.q[-1] - q[-1], solution.v[-1] - v[-1])
        dense = solution(INSIDE * h)
        found.append([np.max(np.abs(dense.q - q[:-1] - q_step)), np.max(np.abs(dense.v - v[:-1] - v_step))])
    slopes = np.log2(np.array(found[:-1]) / np.array(found[1:]))
    assert np.all(slopes[:, 0] > 3.8)
    assert np.all(slopes[:, 1] > 2.8)


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("how", [{"step": 0.03}, {"steps": [0.2, 0.1, 0.3, 0.2]}, {"rtol": 1e-5}], ids=str)
def test_output_times_change_no_bit_of_the_steps(route, how):
    solver = HHT(SYSTEMS[route], alpha=-0.3)
    free = solver.solve((0.0, 0.8), Q0, V0, **how)
    asked = np.sort(np.append(np.linspace(0.0, 0.8, 37), free.t[3]))
    bound = solver.solve((0.0, 0.8), Q0, V0, t_eval=asked, **how)
    assert free.status is bound.status is Status.success
    assert np.array_equal(bound.t, asked)
    for name in ("t", "h", "a", "lam_start", "lam_end"):
        assert getattr(free.steps_data, name).tobytes() == getattr(bound.steps_data, name).tobytes()
    plain, moved = free(asked), free(asked, project=True)
    for found, there, before in ((bound.q, moved.q, plain.q), (bound.v, moved.v, plain.v)):
        np.testing.assert_allclose(found, there, rtol=0, atol=np.abs(there - before).max() ** 2 + 4e-15)
    row = int(np.flatnonzero(asked == free.t[3])[0])
    assert bound.q[row].tobytes() == free.q[3].tobytes()
    for name in ("residual_evaluations", "newton_iterations", "factorisations", "steps_accepted"):
        assert getattr(free.counters, name) == getattr(bound.counters, name)


@pytest.mark.parametrize("span", [(0.0, 2.0), (2.0, 0.0)])
@pytest.mark.parametrize("how", [{"steps": 5000}, {"rtol": 1e-8}], ids=str)
def test_rows_are_the_same_bits_where_too_many_steps_are_not_kept(monkeypatch, span, how):
    solver = HHT(SYSTEMS["jax"], events=wall())
    whole = solver.solve(span, Q0, V0, t_eval=[*span], **how)
    asked = np.sort(np.r_[np.linspace(*span, 1001), np.repeat(whole.t_events[0], 2)])[:: -1 if span[0] > span[1] else 1]
    whole = solver.solve(span, Q0, V0, t_eval=asked, **how)
    monkeypatch.setattr(history, "MAX_KEPT", 1)
    few = solver.solve(span, Q0, V0, t_eval=asked, **how)
    assert whole.t_events[0].size > 0
    assert few.status is whole.status is Status.success
    for name in ("t", "q", "v", "lam", "mu", "message", "counters"):
        np.testing.assert_array_equal(getattr(few, name), getattr(whole, name))
    assert few.steps_data is few.interpolant is None
    every = solver.solve(span, Q0, V0, t_eval=asked, keep_steps=True, **how)
    assert every.interpolant.t.tobytes() == whole.interpolant.t.tobytes()
    with pytest.raises(ValueError, match="steps than it keeps"):
        few(0.5)


def test_steps_that_nobody_asked_for_take_no_memory_beyond_what_is_kept(monkeypatch):
    monkeypatch.setattr(history, "MAX_KEPT", 10_000)
    monkeypatch.setattr(solve, "MAX_CALL", 512)
    solver, steps = HHT(SYSTEMS["jax"]), 20_000
    solver.solve((0.0, 1.0), Q0, V0, steps=steps, t_eval=[1.0])
    tracemalloc.start()
    try:
        solution = solver.solve((0.0, 1.0), Q0, V0, steps=steps, t_eval=[1.0])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert solution.counters.steps_accepted == steps
    assert peak < steps * 8, "one number a step, of eight"


@pytest.mark.parametrize("length", [1e-12, 1e-9])
def test_rows_of_steps_that_hardly_move_q_have_the_velocities_of_the_motion(length):
    """At this angle q is rounded the other way in one of the steps, which over its length is a velocity of 0.01 m/s."""
    times, start = np.linspace(0.0, length, 101), [np.sin(1.6), -np.cos(1.6)]
    solution = HHT(Pendulum()).solve((0.0, length), start, [0.0, 0.0], rtol=1e-6, t_eval=times)
    assert solution.success, solution.message
    np.testing.assert_allclose(np.linalg.norm(solution.v, axis=1), GRAVITY * np.sin(1.6) * times, rtol=1e-5)
    np.testing.assert_allclose(solution(times).v, solution.v, atol=1e-4 * GRAVITY * length)
