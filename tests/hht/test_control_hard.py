"""Error control and forces in balance where it is hard: jumps, budgets, roundoff and rest end right or with a status."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status
from problems import andrews, jay_negrut_pendulum
from solvers.hht import HHT
from tests.hht.scenes import JAX_PENDULUM, Q0, V0, Ball, pendulum_at

# --- what a step must not pass over


@pytest.mark.parametrize("stiffness", [1e6, 1e8])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
def test_a_stop_that_is_met_within_a_step_does_not_filter_its_own_error(stiffness, tolerance):
    """Falls 1 m, bounces, and is as high again: with the new matrix alone the energy was gone after one step."""
    ball = Ball(k=stiffness)
    solution = HHT(ball).solve((0.0, 0.9), [1.0], [0.0], rtol=tolerance)
    assert solution.success
    energy = [float(ball.energy(t, q, v)) for t, q, v in zip(solution.t, solution.q, solution.v, strict=True)]
    assert energy[-1] == pytest.approx(9.81, rel=0.02)
    back = np.sqrt(2 / 9.81)
    assert solution.q[-1, 0] == pytest.approx(1 - 9.81 / 2 * (0.9 - 2 * back) ** 2, abs=0.02)


def test_stepping_to_a_time_just_ahead_does_not_spoil_the_steps_after_it():
    hht = HHT(JAX_PENDULUM)
    hht.init_step(0.0, Q0, V0, rtol=1e-6)
    for _ in range(20):
        hht.step(1.0)
    length = hht.state.h
    for gap in (1e-11, 1e-9, 1e-6):
        assert hht.step(1.0, tstop=hht.state.t + gap) is Status.success
        for _ in range(5):
            assert hht.step(1.0) is Status.success
        assert hht.state.h > length / 3
    exact = pendulum_at(hht.state.t)
    assert np.abs(hht.state.q - exact[0]).max() < 1e-5


# --- hard cases end with a status


def named_tolerance(message):
    return float(re.search(r"roundoff is reached.* to atol=([\d.e-]+)\.$", message)[1])


def test_a_tolerance_below_roundoff_is_named_with_one_that_is_not():
    """Shorter steps make the error larger: no jump in the forces does that."""
    hht = HHT(JAX_PENDULUM)
    solution = hht.solve((0.0, 0.5), Q0, V0, rtol=0, atol=1e-10)
    assert solution.status is Status.step_too_small
    assert "jump" not in solution.message
    atol = named_tolerance(solution.message)
    assert 2e-10 < atol < 1e-7
    assert hht.solve((0.0, 0.5), Q0, V0, rtol=0, atol=atol).success


@pytest.mark.parametrize(("make", "atol"), [(jay_negrut_pendulum.problem, 1e-9), (andrews.problem, 1e-10)])
def test_an_error_that_stays_while_steps_shrink_is_roundoff(make, atol):
    """It fell and grew by turns until steps of 1e-18 s had one of 1.01, or crept on with those; steps before are chance."""
    problem = make()
    hht = HHT(problem.system)
    solution = hht.solve(problem.t_span, problem.q0, problem.v0, rtol=0, atol=atol, max_num_steps=10_000)
    assert solution.status is Status.step_too_small
    assert 10 * atol < named_tolerance(solution.message) < 1e4 * atol
    assert np.abs(solution.steps_data.h).min() > 1e-10


@pytest.mark.parametrize("size", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("atol", [1e-6, 1e-8, 1e-9])
def test_a_jump_is_stepped_over_or_named_at_tolerances_above_roundoff(size, atol):
    push = NumpySystem(force=lambda t, q, v: np.array([size if t > 0.4321 else -1.0]))
    solution = HHT(push).solve((0.0, 0.5), [1.0], [0.5], rtol=0, atol=atol)
    assert "roundoff" not in solution.message
    assert solution.success or "jump" in solution.message


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_structure_that_forces_hold_at_rest_has_the_tolerance_of_what_they_could_do(unit):
    """Two rods hold a weight between them: v' is what rounding leaves of forces in balance, and no size of a motion."""
    anchors = np.array([[0.0, 0.0], [2.0, 0.0]]) * unit
    place = np.array([0.3, -0.8]) * unit
    lengths = ((place - anchors) ** 2).sum(axis=1)
    system = NumpySystem(
        force=lambda t, q, v: np.array([3.0, -9.81]) * unit - 1e3 * (q - 0.9 * place),
        constraint=lambda t, q: (((q - anchors) ** 2).sum(axis=1) - lengths) / 2,
    )
    for options in ({"alpha": 0.0, "b": 0.2}, {"alpha": -0.3, "b": 0.2}, {"extrapolate_reaction": True}):
        solution = HHT(system, **options).solve((0.0, 1.0), place, [0.0, 0.0], rtol=1e-6)
        assert solution.success, solution.message
        assert solution.counters.steps_accepted < 100
        assert np.abs(solution.v).max() < 1e-9 * unit


@pytest.mark.parametrize(
    ("options", "ends"), [({"min_step": 1e4}, Status.step_too_small), ({"first_step": 1e4}, Status.success)]
)
def test_an_interval_far_shorter_than_a_length_that_was_given_is_no_remainder_whose_error_is_known(options, ends):
    """Found by fuzzing: a radian and a half in one step, accepted without a look at its error."""
    system = NumpySystem(force=lambda t, q, v: -1e4 * q)
    solution = HHT(system, **options).solve((0.0, 0.015), [1.0], [0.0], rtol=1e-4)
    assert solution.status is ends
    assert np.abs(solution.q[-1, 0] - np.cos(100 * solution.t[-1])) < 1e-3


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [1e9, 1e12])
def test_a_vibration_far_faster_than_the_interval_is_followed_from_its_start(w, rtol):
    """Errors of steps far too long, which stay while they shrink, were taken for roundoff, and that for a time's spacing."""
    spring = NumpySystem(force=lambda t, q, v: -w * w * q)
    solution = HHT(spring, alpha=-0.05).solve((0.0, 1.0), [1.0], [0.0], rtol=rtol, atol=rtol, max_num_steps=50)
    assert solution.status is Status.max_steps, solution.message
    assert abs(solution.q[-1, 0] - np.cos(w * solution.t[-1])) < rtol


class Truss(hb.System):
    """Two rods that hold a load, at rest."""

    load: object = hb.parameter(1.0)

    def force(self, t, q, v):
        return jnp.stack([self.load, -self.load])

    def constraint(self, t, q):
        rod = q - jnp.array([2.0, 0.0])
        return jnp.stack([(q @ q - 1.01) / 2.0, (rod @ rod - 1.01) / 2.0])


@pytest.mark.parametrize("load", [1e3, 1e5, 1e7])
@pytest.mark.parametrize("steps", [10, 20, 100])
def test_a_structure_that_rests_under_a_load_is_no_motion_that_roundoff_moves(load, steps):
    solution = hb.HHT(Truss(load=load)).solve((0.0, 1.0), [1.0, 0.1], [0.0, 0.0], steps=steps)
    assert solution.success, solution.message
    assert np.abs(solution.q - [1.0, 0.1]).max() < 1e-9
