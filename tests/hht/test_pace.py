"""A run that will not arrive ends early, with its cause (rows J3, P10, P12 of the acceptance matrix)."""

from itertools import count

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System, parameter
from hhtbench.result import Status
from solvers.hht import HHT
from solvers.hht.run import pace, solve
from solvers.hht.run.stepper import Stepper
from tests.hht.scenes import Q0, V0, Pendulum, pendulum


class Sliding(System):
    """A block that friction brings to rest after 1/3 s; its law jumps there."""

    friction: object = parameter(3.0)

    def force(self, t, q, v):
        return -self.friction * jnp.sign(v)


class Heavy(Pendulum):
    """Its weight is near the largest number."""

    def force(self, t, q, v):
        return jnp.array([0.0, -1e308])


@pytest.fixture(autouse=True)
def by_steps(monkeypatch):
    """Looks come after so many steps, however slow the machine is."""
    monkeypatch.setattr(pace, "SECONDS", np.inf)


def test_a_jump_that_a_motion_sticks_to_is_told_and_not_crawled_along():
    solution = HHT(Sliding()).solve((0.0, 1.0), [0.0], [1.0], rtol=1e-5, max_seconds=60.0)
    assert solution.status is Status.step_too_small
    assert "will not arrive" in solution.message
    assert "jump" in solution.message
    assert solution.t[-1] == pytest.approx(1 / 3, abs=1e-5)
    assert solution.counters.steps_accepted in (1_000, 2_000)


def test_a_derivative_that_is_never_finite_is_named():
    nan = np.full((2, 2), np.nan)
    system = pendulum(force_jacobians=lambda t, q, v: (nan, nan))
    solution = HHT(system).solve((0.0, 1.0), Q0, V0, rtol=1e-5, max_seconds=120.0)
    assert solution.status is Status.nonfinite_callback
    assert "force_jacobians" in solution.message
    assert solution.counters.steps_accepted in (1_000, 2_000)


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_a_force_that_overflows_at_every_step_of_use_is_told(engine):
    solution = HHT(Heavy(), engine=engine).solve((0.0, 1.0), Q0, V0, rtol=1e-5, max_seconds=120.0)
    assert solution.status is Status.nonfinite_callback
    assert solution.counters.steps_accepted in (1_000, 2_000)


def test_a_slow_run_that_newton_does_not_refuse_goes_on():
    solution = HHT(Pendulum(), max_step=1e-9).solve((0.0, 10.0), Q0, V0, rtol=1e-5, max_num_steps=20_000)
    assert solution.status is Status.max_steps


class Tiny(Pendulum):
    """Its rod is so short that it swings 1e50 times a second."""

    length: object = parameter(1e-100)

    def constraint(self, t, q):
        return jnp.array([(q @ q - self.length**2) / 2])


@pytest.mark.parametrize("q0", [[0.6e-100, -0.8e-100], [1e-100, 0.0]])
def test_a_motion_that_no_number_of_steps_follows_is_told_at_default_budgets(q0, monkeypatch):
    monkeypatch.setattr(pace, "PATIENCE", 0.0)
    solution = HHT(Tiny()).solve((0.0, 1.0), q0, [0.0, 0.0], rtol=1e-4, atol=1e-104)
    assert solution.status is Status.max_steps
    assert "will not arrive" in solution.message
    assert solution.counters.steps_accepted <= 20_000


def test_the_steps_that_were_asked_for_are_taken_along_such_a_motion():
    solution = HHT(Tiny()).solve((0.0, 1.0), [1e-100, 0.0], [0.0, 0.0], rtol=1e-4, atol=1e-104, max_num_steps=30_000)
    assert solution.status is Status.max_steps
    assert solution.counters.steps_accepted == 30_000


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


def test_a_force_with_noise_above_the_tolerance_is_told_and_not_crawled_along():
    solution = HHT(noisy(1e-6)).solve((0.0, 1.0), Q0, V0, rtol=1e-8, max_num_steps=600)
    assert solution.status is Status.step_too_small
    assert "noise: two calls of force" in solution.message
    assert solution.counters.steps_accepted == 500


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


def test_a_force_whose_noise_takes_too_many_steps_is_told_at_default_budgets():
    solution = HHT(noisy(1e-5)).solve((0.0, 1.0), Q0, V0, rtol=1e-8)
    assert solution.status is Status.step_too_small
    assert "200000 do not lead to the end" in solution.message


@pytest.mark.parametrize(("asked", "allowed"), [(None, 1_000), (5_000, 5_000)])
def test_steps_that_were_asked_for_are_taken_as_many_as_they_are(asked, allowed, monkeypatch):
    """The default's number given is not the default."""
    monkeypatch.setattr(pace, "SETTLED", 50)
    monkeypatch.setattr(pace, "MANY", 1_000)
    monkeypatch.setattr(solve, "MAX_STEPS", 5_000)
    solution = HHT(noisy(1e-5)).solve((0.0, 1.0), Q0, V0, rtol=1e-8, max_num_steps=asked)
    assert solution.status is Status.step_too_small
    assert f" {allowed} do not lead to the end" in solution.message
    assert solution.counters.steps_accepted == 50


def shaken(name, size):
    """The pendulum with one function that is off by a random part of ``size`` at every call, reactions after the start."""
    functions = {
        "mass_matrix": lambda t, q: np.eye(2),
        "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
        "constraint_jacobian": lambda t, q: q[None, :].copy(),
        "reaction": lambda t, q, lam: -lam[0] * q,
    }
    random, known, begin = np.random.default_rng(3), functions[name], 0.01 if name == "reaction" else -1.0

    def off(t, *x):
        value = known(t, *x)
        return value + (t > begin) * size * random.standard_normal() * (1.0 if name == "constraint" else value)

    return pendulum(**{name: off}, constraint_time_derivative=lambda t, q: np.zeros(1))


@pytest.mark.parametrize(
    ("name", "size"), [("mass_matrix", 1e-6), ("constraint", 1e-9), ("constraint_jacobian", 1e-6), ("reaction", 1e-6)]
)
def test_the_function_with_noise_is_named(name, size, monkeypatch):
    monkeypatch.setattr(pace, "SETTLED", 200)
    solution = HHT(shaken(name, size)).solve((0.0, 1.0), Q0, V0, rtol=1e-8, max_num_steps=400, t_eval=[1.0])
    assert solution.status is Status.step_too_small, solution.message
    assert f"noise: two calls of {name} with" in solution.message
    assert ("There is" in solution.message) is (name == "reaction"), "beside another cause, or as the cause"


def test_a_jump_is_not_blamed_on_noise_far_below_the_error_that_it_makes():
    random = np.random.default_rng(3)

    def force(t, q, v):
        return np.array([0.0, -9.81 * (1.0 + 1e-12 * random.standard_normal()) - (1e12 if t > 0.4321 else 0.0)])

    solution = HHT(pendulum(force=force)).solve((0.0, 1.0), Q0, V0, rtol=1e-5)
    assert solution.status is Status.step_too_small
    assert "jump" in solution.message
    assert "noise" not in solution.message


@pytest.mark.parametrize(("system", "first"), [(Pendulum(), 500), (pendulum(), 20)], ids=["machine code", "callables"])
def test_steps_that_may_be_slow_are_made_few_at_a_time_at_first(system, first, monkeypatch):
    """Between calls the user's interrupt is seen; a call of quick ones would cost as much as they do."""
    asked, advance = [], Stepper.advance
    monkeypatch.setattr(Stepper, "advance", lambda self, *x: asked.append(len(x[3])) or advance(self, *x))
    HHT(system).solve((0.0, 1.0), Q0, V0, rtol=1e-4)
    assert asked[0] == first


def test_a_slow_run_is_looked_at_by_the_clock(monkeypatch):
    """Every look at the clock is a second later than the last: of a run that will not arrive the second look is the end."""
    seconds = count()
    monkeypatch.setattr(pace, "SECONDS", 3.0)
    monkeypatch.setattr(pace.time, "perf_counter", lambda: float(next(seconds)))
    monkeypatch.setattr(solve, "QUICK", 0)
    monkeypatch.setattr(solve, "MOST", 20)
    solution = HHT(Sliding()).solve((0.0, 1.0), [0.0], [1.0], rtol=1e-5)
    assert solution.status is Status.step_too_small
    assert "will not arrive" in solution.message
    assert solution.counters.steps_accepted < 500


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [1e8, 1e9, 1e12, 1e15])
def test_a_vibration_far_faster_than_the_interval_is_followed_from_its_start(w, rtol):
    """Errors of steps far too long, which stay while they shrink, were taken for roundoff, and that for a time's spacing."""
    spring = NumpySystem(force=lambda t, q, v: -w * w * q)
    solution = HHT(spring, alpha=-0.05).solve((0.0, 1.0), [1.0], [0.0], rtol=rtol, atol=rtol, max_num_steps=50)
    assert solution.status is Status.max_steps, solution.message
    assert abs(solution.q[-1, 0] - np.cos(w * solution.t[-1])) < rtol
