"""Constraints have more than one solution, and Newton's iteration may find another: such steps are not taken, (H58)."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from tests.sample import slow

HEIGHT = 0.1


class Loaded(hb.System):
    """Two rods that hold a load that changes; they may point up or down.  Something falls beside them."""

    load: object = hb.parameter(1.0)

    def force(self, t, q, v):
        load = self.load * jnp.sin(3.0 * t)
        return jnp.stack([load, -load, -9.81])

    def constraint(self, t, q):
        rod = q[:2] - jnp.array([2.0, 0.0])
        length = 1.0 + HEIGHT**2
        return jnp.stack([(q[:2] @ q[:2] - length) / 2.0, (rod @ rod - length) / 2.0])


@pytest.mark.parametrize("options", [{}, {"alpha": -0.3}, {"b": 1.0}, {"extrapolate_reaction": True}], ids=str)
@pytest.mark.parametrize("load", [1e4, 1e5, 1e6])
@pytest.mark.parametrize("steps", [50, 200, 1000])
def test_a_structure_does_not_leap_to_its_mirror_image(load, steps, options):
    """200 steps of 0.05 s put the joint below instead of above from the second on, which was said to be a success."""
    solution = hb.HHT(Loaded(load=load), **options).solve((0.0, 10.0), [1.0, HEIGHT, 0.0], [0.0] * 3, steps=steps)
    assert np.abs(solution.q[:, 1] - HEIGHT).max() < 1e-6
    assert solution.success or solution.status is hb.Status.newton_failed


def test_a_leap_is_named_and_shorter_steps_avoid_it():
    long, short = (
        hb.HHT(Loaded(load=1e4)).solve((0.0, 10.0), [1.0, HEIGHT, 0.0], [0.0] * 3, steps=steps) for steps in (200, 1000)
    )
    assert "q[1] leaps to another position that the constraints allow; take a smaller step" in long.message
    assert short.success


@pytest.mark.parametrize(
    ("turn", "height", "h"), [(1.0, 0.01, 0.05), (5.0, 0.1, 0.02), (10.0, 0.1, 0.05), slow(10.0, 0.01, 0.05)]
)
def test_a_truss_on_a_bar_that_turns_stays_on_its_side(turn, height, h):
    """By up to half a radian in a step, which moves it by more than the leap."""

    def bar(t):
        c, s = np.cos(turn * t), np.sin(turn * t)
        return np.array([c, s]), np.array([-s, c])

    def constraint(t, q):
        along = bar(t)[0]
        return np.array([(q - along) @ (q - along), (q + along) @ (q + along)]) - 1.0 - height**2

    system = hb.NumpySystem(force=lambda t, q, v: 1e3 * np.sin(3.0 * t) * bar(t)[1], constraint=constraint)
    solution = hb.HHT(system, alpha=-0.3).solve((0.0, 10.0), [0.0, height], [-turn * height, 0.0], step=h)
    sides = [q @ bar(t)[1] for t, q in zip(solution.t, solution.q, strict=True)]
    assert min(sides) > 0.9 * height


@pytest.mark.parametrize("turn", [0.1, 1.0, 2.0, 2.6, 2.9])
def test_points_that_follow_a_wheel_do_not_leap(turn):
    """By up to 166 degrees in a step."""
    wheel = hb.NumpySystem(
        force=lambda t, q, v: np.zeros(3),
        constraint=lambda t, q: np.array([q[1] - np.cos(q[0]), q[2] - np.sin(q[0])]),
        mass_matrix=np.diag([1.0, 1e-9, 1e-9]),
    )
    speed = turn / 0.01
    solution = hb.HHT(wheel).solve((0.0, 1.0), [0.0, 1.0, 0.0], [speed, 0.0, speed], step=0.01)
    assert solution.success, solution.message
    assert abs(solution.q[-1, 0] - speed) < 1e-5


def test_motions_that_steps_hardly_resolve_do_not_leap():
    """A pendulum that goes round once in ten steps, and something that it takes along."""

    class Pendulum(hb.System):
        def force(self, t, q, v):
            return jnp.zeros(3)

        def constraint(self, t, q):
            return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2.0, q[2] - q[0]])

    turn = 2.0 * np.pi
    for alpha in (0.0, -0.3):
        solution = hb.HHT(Pendulum(), alpha=alpha).solve((0.0, 10.0), [1.0, 0.0, 1.0], [0.0, turn, 0.0], step=0.1)
        assert solution.success, solution.message


class Swing(hb.System):
    """A joint on a ring, which a blade lets move towards its middle only, and a weight that swings from it."""

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81, 0.0, -9.81])

    def constraint(self, t, q):
        rod = q[2:] - q[:2]
        return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2.0, (rod @ rod - 1.0) / 2.0])

    def velocity_constraint(self, t, q, v):
        return v[:1]


@pytest.mark.parametrize("h", [0.02, 0.05, 0.1])
def test_what_a_swinging_weight_moves_a_joint_by_is_no_leap(h):
    """Velocity constraints hold no position: the joint's is off by the error of the step, beside a velocity of zero."""
    start = [0.0, -1.0, 1.0, -1.0], [0.0, 0.0, 0.0, 2.0]
    solution = hb.HHT(Swing()).solve((0.0, 1.0), *start, step=h)
    assert solution.success, solution.message
    assert np.abs(solution.q[:, 0]).max() < 12 * h**2
