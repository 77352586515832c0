"""A run that will not arrive ends early, with its cause (rows J3, P10, P12 of the acceptance matrix)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0, Pendulum, pendulum


@pytest.mark.parametrize("damping", [1e10, 1e3])
def test_a_long_rest_after_such_a_motion_is_arrived_at(damping):
    """A vibration of 1e6/s dies out in 2 ms, or ten seconds: at an even pace 1e15 steps more would be needed for long."""

    class Quick(System):
        def force(self, t, q, v):
            return jnp.array([-1e12 * q[0] - damping * v[0], -1e-12 * q[1] - 1e-6 * v[1]])

    solution = HHT(Quick()).solve((0.0, 1e9), [1e-2, 1.0], [0.0, 0.0], rtol=1e-3, atol=1e-3, t_eval=[0.0, 1e9])
    assert solution.status is Status.success, solution.message


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


def test_a_force_with_noise_of_twice_the_tolerance_arrives_as_accurately_as_asked():
    """It enters v with h only: half as many steps again take it in."""
    solution = HHT(noisy(2e-5)).solve((0.0, 3.0), Q0, V0, rtol=1e-5)
    exact = HHT(Pendulum()).solve((0.0, 3.0), Q0, V0, rtol=1e-7)
    assert solution.status is Status.success, solution.message
    assert np.abs(solution.q[-1] - exact.q[-1]).max() < 10 * 1e-5


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [1e8, 1e9, 1e12, 1e15])
def test_a_vibration_far_faster_than_the_interval_is_followed_from_its_start(w, rtol):
    """Errors of steps far too long, which stay while they shrink, were taken for roundoff, and that for a time's spacing."""
    spring = NumpySystem(force=lambda t, q, v: -w * w * q)
    solution = HHT(spring, alpha=-0.05).solve((0.0, 1.0), [1.0], [0.0], rtol=rtol, atol=rtol, max_num_steps=50)
    assert solution.status is Status.max_steps, solution.message
    assert abs(solution.q[-1, 0] - np.cos(w * solution.t[-1])) < rtol
