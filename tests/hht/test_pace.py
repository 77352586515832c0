"""A run that will not arrive ends early, with its cause (rows J3, P10, P12 of the acceptance matrix)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System, parameter
from hhtbench.result import Status
from solvers.hht import HHT
from solvers.hht.run.stepper import Stepper
from tests.hht.scenes import Q0, V0, Pendulum, pendulum


def test_a_slow_run_that_newton_does_not_refuse_goes_on():
    solution = HHT(Pendulum(), max_step=1e-9).solve((0.0, 10.0), Q0, V0, rtol=1e-5, max_num_steps=20_000)
    assert solution.status is Status.max_steps


class Tiny(Pendulum):
    """Its rod is so short that it swings 1e50 times a second."""

    length: object = parameter(1e-100)

    def constraint(self, t, q):
        return jnp.array([(q @ q - self.length**2) / 2])


@pytest.mark.parametrize("damping", [1e10, 1e3])
def test_a_long_rest_after_such_a_motion_is_arrived_at(damping):
    """A vibration of 1e6/s dies out in 2 ms, or ten seconds: at an even pace 1e15 steps more would be needed for long."""

    class Quick(System):
        def force(self, t, q, v):
            return jnp.array([-1e12 * q[0] - damping * v[0], -1e-12 * q[1] - 1e-6 * v[1]])

    solution = HHT(Quick()).solve((0.0, 1e9), [1e-2, 1.0], [0.0, 0.0], rtol=1e-3, atol=1e-3, t_eval=[0.0, 1e9])
    assert solution.status is Status.success, solution.message


def test_a_diagnosis_of_forces_beyond_all_squares_ends_with_the_status():
    class Strong(Pendulum):
        def force(self, t, q, v):
            return jnp.array([0.0, -1e220])

    solution = HHT(Strong()).solve((0.0, 1.0), [1.0, 0.0], [0.0, 0.0], rtol=1e-4, max_num_steps=600)
    assert solution.status is Status.max_steps


class Shaken(System):
    """A block on a floor that is shaken for a second, with friction that is nearly a jump; then it rests for ever."""

    def force(self, t, q, v):
        return -3.0 * jnp.tanh(v / 1e-8) + 5.0 * jnp.sin(200.0 * t) * jnp.where(t < 1.0, 1.0, 0.0)


def test_a_rough_start_before_a_long_rest_arrives():
    solution = HHT(Shaken()).solve((0.0, 1e6), [0.0], [1.0], rtol=1e-4, max_num_steps=20_000)
    assert solution.status is Status.success
    assert solution.counters.steps_rejected_newton > 0.1 * 1_000  # refused as often as what will not arrive


def noisy(size):
    """The weight, off by a random part of ``size`` at every call."""
    random = np.random.default_rng(3)
    return pendulum(force=lambda t, q, v: np.array([0.0, -9.81 * (1.0 + size * random.standard_normal())]))


def test_a_force_with_noise_far_below_the_tolerance_arrives():
    solution = HHT(noisy(1e-10)).solve((0.0, 1.5), Q0, V0, rtol=1e-5)
    assert solution.status is Status.success
    assert solution.counters.steps_accepted > 500


def test_a_force_with_noise_of_twice_the_tolerance_arrives_as_accurately_as_asked():
    """It enters v with h only: half as many steps again take it in."""
    solution = HHT(noisy(2e-5)).solve((0.0, 3.0), Q0, V0, rtol=1e-5)
    exact = HHT(Pendulum()).solve((0.0, 3.0), Q0, V0, rtol=1e-7)
    assert solution.status is Status.success, solution.message
    assert np.abs(solution.q[-1] - exact.q[-1]).max() < 10 * 1e-5


def test_a_jump_is_not_blamed_on_noise_far_below_the_error_that_it_makes():
    random = np.random.default_rng(3)

    def force(t, q, v):
        return np.array([0.0, -9.81 * (1.0 + 1e-12 * random.standard_normal()) - (1e12 if t > 0.4321 else 0.0)])

    solution = HHT(pendulum(force=force)).solve((0.0, 1.0), Q0, V0, rtol=1e-5)
    assert solution.status is Status.step_too_small
    assert "jump" in solution.message
    assert "noise" not in solution.message


@pytest.mark.parametrize(("system", "first"), [(Pendulum(), 512), (pendulum(), 20)], ids=["machine code", "callables"])
def test_steps_that_may_be_slow_are_made_few_at_a_time_at_first(system, first, monkeypatch):
    """Between calls the user's interrupt is seen; a call of quick ones would cost as much as they do."""
    asked, advance = [], Stepper.advance
    monkeypatch.setattr(Stepper, "advance", lambda self, *x: asked.append(len(x[3])) or advance(self, *x))
    HHT(system).solve((0.0, 1.0), Q0, V0, rtol=1e-4)
    assert asked[0] == first


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [1e8, 1e9, 1e12, 1e15])
def test_a_vibration_far_faster_than_the_interval_is_followed_from_its_start(w, rtol):
    """Errors of steps far too long, which stay while they shrink, were taken for roundoff, and that for a time's spacing."""
    spring = NumpySystem(force=lambda t, q, v: -w * w * q)
    solution = HHT(spring, alpha=-0.05).solve((0.0, 1.0), [1.0], [0.0], rtol=rtol, atol=rtol, max_num_steps=50)
    assert solution.status is Status.max_steps, solution.message
    assert abs(solution.q[-1, 0] - np.cos(w * solution.t[-1])) < rtol
