"""Constant steps beside stiff springs: no length fails between others that work."""

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


class Floor(hb.System):
    """A mass that a spring throws back from the origin, and one beside that the same spring holds."""

    stiffness: object = hb.parameter(1.0)

    def force(self, t, q, v):
        return jnp.stack([jnp.where(q[0] < 0, -self.stiffness * q[0], 0.0), -self.stiffness * q[1]])


@pytest.mark.parametrize(
    ("step", "amplitude", "told"),
    [(1e-3, 0.0, True), (1e-5, 0.0, False), (1e-3, 1e-12, False)],
    ids=["contact in one step", "contact in 31 steps", "a vibration too small to matter"],
)
def test_prescribed_steps_tell_of_forces_that_begin_and_end_between_two_looks(step, amplitude, told):
    """The contact lasts 3.1e-4 s: a step of three times that throws the mass back faster than it came."""
    end = 2.0 if amplitude == 0.0 else 0.9
    solution = HHT(Floor(stiffness=1e8)).solve((0.0, end), [1.0, amplitude], [-1.0, 0.0], step=step)
    assert solution.success, solution.message
    assert ("forces change v[0] by" in solution.message) is told
    if end == 2.0:
        assert bool(abs(solution.v[-1, 0] - 1.0) > 0.5) is told
