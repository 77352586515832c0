"""Steps beside stiff springs and dampers: no length fails, and led motions are as exact as others, (H59)."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from problems.stiff_spring_pendulum import problem
from solvers.hht import HHT

TURNING = [(1e10, 100), (1e12, 200), (1e12, 20), (1e12, 10), (1e13, 27)]  # stiffness [N/m], steps in a second
STARTING = [(1e10, 2.27e-5), (1e12, 1e-6), (1e12, 8.55e-6), (1e13, 3.92e-6)]  # stiffness, step [s]


class Pair(hb.System):
    """Two masses side by side at ``x0``, a stiff spring between them, that fall."""

    x0: object = hb.parameter(0.0)

    def force(self, t, q, v):
        pull = 1e10 * (q[2] - q[0] - 1.0)
        return jnp.stack([pull, -9.81, -pull, -9.81])


@pytest.mark.parametrize("alpha", [0.0, -0.05, -0.3])
@pytest.mark.parametrize(("stiffness", "steps"), TURNING)
def test_a_stiff_spring_may_turn_in_a_step(stiffness, steps, alpha):
    """The error is the method's alone, 11 h^2 for the rigid rod and alpha = -0.3; both levels hold to roundoff."""
    scene, rigid = problem(stiffness=stiffness), problem(stiffness="inf").reference
    solution = HHT(scene.system, alpha=alpha).solve((0.0, 1.0), scene.q0, scene.v0, steps=steps)
    assert solution.success, solution.message
    assert np.abs(solution.q[-1] - rigid["q"][-1]).max() < 15.0 / steps**2
    rod, turning = solution.q[:, 2:] - solution.q[:, :2], solution.v[:, 2:] - solution.v[:, :2]
    assert np.abs(np.sum(rod * rod, axis=1) - 1.0).max() < 1e-14
    assert np.abs(np.sum(rod * turning, axis=1)).max() < 1e-13
    assert solution.counters.newton_iterations < 25 * steps  # with two vain attempts; whole increments take 4 to 9


@pytest.mark.parametrize(("stiffness", "h"), STARTING)
def test_roundoff_of_a_stiff_spring_is_no_failure_while_all_is_slow(stiffness, h):
    """Just after a start from rest the noise of k l is far above 1e-8 of v: the masses fall freely all the same."""
    scene, steps = problem(stiffness=stiffness), 100
    solution = HHT(scene.system, alpha=0.0).solve((0.0, steps * h), scene.q0, scene.v0, steps=steps)
    assert solution.success, solution.message
    np.testing.assert_allclose(solution.v[-1, 1::2], -9.81 * steps * h, rtol=1e-6)


def test_a_stiff_spring_far_from_the_origin_has_the_roundoff_of_its_coordinates():
    far = HHT(Pair(x0=1e4)).solve((0.0, 1e-3), [1e4, 0.0, 1e4 + 1.0, 0.0], [0.01, 0.0, -0.01, 0.0], steps=50)
    assert far.success, far.message
    np.testing.assert_allclose(far.v[-1, 1::2], -9.81e-3, rtol=1e-9)


SPAN = 10.0


class Servo(hb.System):
    """One coordinate that a spring and a damper lead along sin t, and its mass where that is ``heavy``."""

    spring: object = hb.parameter(0.0)
    damper: object = hb.parameter(0.0)

    def force(self, t, q, v):
        return self.mass(q) * -jnp.sin(t) - self.spring * (q - jnp.sin(t)) - self.damper * (v - jnp.cos(t))

    def mass(self, q):
        return 1.0


class Heavy(Servo):
    """The same with a mass that varies."""

    def mass(self, q):
        return 2.0 + jnp.sin(3.0 * q)

    def mass_matrix(self, t, q):
        return self.mass(q)[:, None]


@functools.cache
def led(kind, spring, damper, rtol, alpha):
    """The run, and the largest errors of q and v over ``rtol``."""
    solution = hb.HHT(kind(spring=spring, damper=damper), alpha=alpha).solve((0.0, SPAN), [0.0], [1.0], rtol=rtol)
    assert solution.success, solution.message
    off = (solution.q[:, 0] - np.sin(solution.t), solution.v[:, 0] - np.cos(solution.t))
    return solution, *(np.abs(x).max() / rtol for x in off)


@pytest.mark.parametrize("kind", [Servo, Heavy])
@pytest.mark.parametrize("alpha", [0.0, -0.3])
@pytest.mark.parametrize("rtol", [1e-3, 1e-5])
@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6, 1e8, 1e12])
def test_dampers_that_lead_a_motion_do_not_hide_its_error(stiffness, rtol, alpha, kind):
    """With c = k = 1e8 and rtol 1e-5 the motion was off by 21,000 rtol, in 33 steps."""
    solution, in_q, in_v = led(kind, stiffness, stiffness, rtol, alpha)
    plain = led(kind, 1.0, 1.0, rtol, alpha)[0]
    assert max(in_q, in_v) < 3.0
    assert solution.counters.steps_accepted < 1.2 * plain.counters.steps_accepted


@pytest.mark.parametrize("kind", [Servo, Heavy])
@pytest.mark.parametrize("alpha", [0.0, -0.3])
@pytest.mark.parametrize(("stiffness", "rtol"), [(1e4, 1e-3), (1e6, 1e-3), (1e8, 1e-3), (1e8, 1e-5), (1e12, 1e-5)])
def test_springs_that_lead_a_motion_leave_its_velocity_exact(stiffness, rtol, alpha, kind):
    """With k = 1e8 v was off by 26,000 rtol in 25 steps; with 1e6 80,009 steps followed a vibration that steps had made."""
    solution, in_q, in_v = led(kind, stiffness, 0.0, rtol, alpha)
    assert in_q < 1.0 and in_v < 10.0
    assert solution.counters.steps_accepted < 2.0 * led(kind, 1.0, 1.0, rtol, alpha)[0].counters.steps_accepted


class Follower(hb.System):
    """One that is driven, and one that hangs on it by a spring and a damper."""

    spring: object = hb.parameter(0.0)
    damper: object = hb.parameter(0.0)

    def force(self, t, q, v):
        pull = self.spring * (q[0] - q[1]) + self.damper * (v[0] - v[1])
        return jnp.stack([-pull, pull - jnp.sin(t)])

    def constraint(self, t, q):
        return jnp.stack([q[0] - jnp.sin(t)])


@pytest.mark.parametrize("alpha", [0.0, -0.3])
@pytest.mark.parametrize("rtol", [1e-3, 1e-5])
@pytest.mark.parametrize(("spring", "damper"), [(1e8, 0.0), (1e12, 0.0), (1e8, 1e8), (0.0, 1e8)])
def test_what_hangs_on_something_driven_is_as_exact(spring, damper, rtol, alpha):
    """v of the one was off by 800 rtol, since both were thought to be off by as much."""
    system = Follower(spring=spring, damper=damper)
    solution = hb.HHT(system, alpha=alpha).solve((0.0, SPAN), [0.0, 0.0], [1.0, 1.0], rtol=rtol)
    assert solution.success, solution.message
    in_q, in_v = solution.q - np.sin(solution.t)[:, None], solution.v - np.cos(solution.t)[:, None]
    assert max(np.abs(in_q).max(), np.abs(in_v).max()) < 10 * rtol
    assert solution.counters.steps_rejected_error < 0.1 * solution.counters.steps_accepted + 10
