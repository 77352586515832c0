"""Vibrations that constraint forces carry are told where they make steps unstable, (H33), or too many (row P2)."""

import math

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers.hht.run import tension
from solvers.hht.run.pace import CROWDED
from solvers.hht.run.singular import LONGEST
from solvers.hht.run.tension import fastest
from tests.hht.scenes import GRAVITY, pendulum

HANGING = np.array([0.0, -1.0])


def frequency(system, q, v=None):
    """Of the fastest vibration about a state of rest [rad/s]."""
    hht = hb.HHT(system)
    hht.init_step(0.0, q, np.zeros(np.size(q)) if v is None else v, step=1e-3)
    return fastest(hht._engine, hht.state)


def test_a_hanging_pendulum_vibrates_as_it_does():
    assert frequency(pendulum(), HANGING) == pytest.approx(np.sqrt(9.81), rel=1e-6)


def test_a_standing_one_does_not():
    """What falls over has no frequency."""
    assert frequency(pendulum(), -HANGING) == 0.0


def test_what_falls_over_does_not_hide_what_vibrates():
    """A standing pendulum and a hanging one that is half as fast: the unit rod, and one of 4 m."""

    def constraint(t, q):
        return np.array([q[:2] @ q[:2] - 1.0, q[2:] @ q[2:] - 16.0]) / 2.0

    def rows(t, q):
        return np.array([[q[0], q[1], 0.0, 0.0], [0.0, 0.0, q[2], q[3]]])

    system = NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81, 0.0, -9.81]), constraint=constraint, constraint_jacobian=rows
    )
    assert frequency(system, np.array([0.0, 1.0, 0.0, -4.0])) == pytest.approx(np.sqrt(9.81) / 2.0, rel=1e-2)


@pytest.mark.parametrize("ratio", [1.0, 1e4, 1e8])
def test_rods_with_a_light_body_between_them_vibrate_by_their_tension(ratio):
    """Linearised by hand: (1 + r) g (x/l) above, r g below; eigenvalues of the straight double pendulum of unit rods."""
    q, v = DoublePendulum.straight(0.0)
    assert frequency(DoublePendulum(ratio=ratio), q, v) == pytest.approx(DoublePendulum.fastest(ratio), rel=1e-3)


@pytest.mark.parametrize("offset", [0.0, 1e5, 6.4e6])
def test_a_vibration_is_the_same_wherever_places_are_told_from(offset):
    """Unit rows, which change by as much as they are large over a difference that is as long as the rod."""
    pivot = np.array([offset, 0.0])

    def rows(t, q):
        return ((q - pivot) / np.hypot(*(q - pivot)))[None, :]

    far = pendulum(constraint=lambda t, q: np.array([np.hypot(*(q - pivot)) - 1.0]), constraint_jacobian=rows)
    assert frequency(far, pivot + HANGING) == pytest.approx(np.sqrt(9.81), rel=1e-4)


def test_a_look_that_takes_long_is_not_taken(monkeypatch):
    monkeypatch.setattr(tension, "seconds_of_look", lambda dynamics: 2 * LONGEST)
    assert frequency(pendulum(), HANGING) == 0.0


def test_a_look_at_slow_functions_ends_with_what_is_known(monkeypatch):
    """The first estimate of the iteration, from below."""
    monkeypatch.setattr(tension, "SECONDS", 0.0)
    system, fast = DoublePendulum(ratio=1e4), DoublePendulum.fastest(1e4)
    assert 0.0 < frequency(system, *DoublePendulum.straight(0.0)) < 0.99 * fast


def rods(ratio, **request):
    options = {"b": request.pop("b", 0.0)}
    return hb.HHT(DoublePendulum(ratio=ratio), **options).solve((0.0, 1.0), *DoublePendulum.straight(0.5), **request)


def test_prescribed_steps_beyond_the_bound_are_told_with_it():
    solution = rods(1e6, step=1e-3)
    assert solution.status is Status.newton_failed
    assert "constraint forces carry a vibration of" in solution.message
    assert rods(1e6, step=1e-3, b=1.0).success


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "take shorter ones or extrapolate_reaction=True, which damps it, or b = 1"),
        ({"alpha": 0.0}, "take shorter ones or b = 1"),
        ({"reaction": "midpoint"}, 'or extrapolate_reaction=True, which damps it, or b = 1 with reaction="implicit"'),
    ],
    ids=str,
)
def test_options_are_named_where_they_are_taken_and_help(options, text):
    solution = hb.HHT(DoublePendulum(ratio=1e6), **options).solve((0.0, 1.0), *DoublePendulum.straight(0.5), step=1e-3)
    assert solution.status is Status.newton_failed
    assert solution.message.endswith(text)


def test_a_mass_whose_inverse_fills_has_b_alone():
    bar = hb.load_problem("clamped_bar_impact(n_elements=250)")
    hht = hb.HHT(bar.system)
    hht.init_step(bar.t_span[0], bar.q0, bar.v0, step=1e-6)
    assert tension.remedies(hht._engine) == ["b = 1"]


@pytest.mark.parametrize("b", [0.0, 0.2])
def test_what_velocity_constraints_carry_has_shorter_steps_alone(b):
    """A pendulum held by q . v = 0: stable up to h omega = 2 whatever b, so b = 0.2 does not reach 2.58."""
    skate = {
        "velocity_constraint": lambda t, q, v: np.array([q @ v]),
        "velocity_constraint_jacobian": lambda t, q, v: q[None],
    }
    system = NumpySystem(force=lambda t, q, v: np.array([0.0, -(230.0**2)]), **skate)
    solution = hb.HHT(system, b=b).solve((0.0, 0.4), [np.sin(1e-6), -np.cos(1e-6)], [0.0, 0.0], step=0.01)
    assert solution.status is Status.newton_failed
    assert solution.message.endswith("s, h omega = 2; take shorter ones")


def test_what_velocity_and_position_constraints_carry_has_b_where_it_helps():
    def rows(t, q, v):
        return np.array([[1.0, 0.0, 0.0, 0.0]])

    system = NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81, 0.0, -9.81]),
        constraint=lambda t, q: np.array([(q[2:] @ q[2:] - 1.0) / 2.0]),
        velocity_constraint=lambda t, q, v: v[:1],
        velocity_constraint_jacobian=rows,
    )
    hht = hb.HHT(system)
    hht.init_step(0.0, np.array([0.0, 0.0, 0.0, -1.0]), np.zeros(4), step=1e-3)
    assert tension.remedies(hht._engine) == ["b = 1 where position constraints carry it"]


def test_too_many_steps_by_error_that_follow_a_vibration_are_told_so():
    few, fewer = (rods(1e8, rtol=1e-4, max_num_steps=3_000, b=b) for b in (0.0, 1.0))
    assert few.status is fewer.status is Status.max_steps
    assert "Constraint forces carry a vibration of" in few.message
    assert fewer.t[-1] > 3 * few.t[-1], "the remedy"


def test_a_run_that_arrives_in_many_steps_which_follow_a_vibration_says_so():
    many, few = (rods(1e6, rtol=1e-3, **options) for options in ({}, {"b": 1.0}))
    assert many.success and many.counters.steps_accepted > CROWDED
    assert "Constraint forces carry a vibration of" in many.message
    assert "extrapolate_reaction=True, which damps it, or b = 1 takes longer ones where" in many.message
    assert "smaller than the tolerance asks for; else loosen the tolerance" in many.message
    assert few.success and "vibration" not in few.message


def test_a_run_that_arrives_in_many_steps_of_a_plain_motion_says_nothing():
    solution = hb.HHT(pendulum()).solve((0.0, 20.0), HANGING, [1.0, 0.0], rtol=1e-5)
    assert solution.success and solution.counters.steps_accepted > CROWDED
    assert "vibration" not in solution.message


@pytest.mark.parametrize("times", [1.8, 2.05, 4.0, 8.0])
@pytest.mark.parametrize("ratio", [1e2, 1e6])
def test_prescribed_steps_that_fail_beyond_the_bound_are_told_with_it_wherever_they_fail(ratio, times):
    """h omega at the start, from which it grows as the rods swing down; where it ends they are bent by what has grown."""
    solution = rods(ratio, step=times / (DoublePendulum.fastest(ratio) * math.sqrt(math.cos(0.5))))
    assert solution.status is Status.newton_failed
    assert "constraint forces carry a vibration of" in solution.message


@pytest.mark.parametrize("speed", [1e-3, 0.02, 1.0])
def test_too_many_steps_of_a_plain_motion_are_not_blamed_on_a_vibration(speed):
    """However little it moves beside the length of its rod: this vibration is the motion."""
    solution = hb.HHT(pendulum()).solve((0.0, 1e3), HANGING, [speed, 0.0], rtol=1e-3, max_num_steps=600)
    assert solution.status is Status.max_steps
    assert "vibration" not in solution.message


@pytest.mark.parametrize(("ratio", "rtol"), [(3e3, 1e-6), (1e4, 1e-8), (1e5, 1e-7)])
def test_many_steps_that_a_tight_tolerance_asks_of_a_slow_swing_are_not_blamed_on_a_vibration(ratio, rtol):
    """Rods in the slow mode alone, h omega = 0.1 to 0.8 for the fast one; as many steps as where that is passed over."""
    fast = DoublePendulum.fastest(ratio)
    slow2 = (1.0 + ratio) * GRAVITY**2 / fast**2
    start = DoublePendulum.straight(0.0)[0], 0.01 * np.array([1.0, 0.0, GRAVITY / (GRAVITY - slow2), 0.0])
    system, given = DoublePendulum(ratio=ratio), {"rtol": rtol, "max_num_steps": 2_000}
    plain, other = (hb.HHT(system, extrapolate_reaction=x).solve((0.0, 1e3), *start, **given) for x in (False, True))
    assert plain.status is Status.max_steps
    assert 0.1 < fast * plain.t[-1] / 2_000 < 1.0
    assert plain.t[-1] > 0.9 * other.t[-1]
    assert "vibration" not in plain.message


def test_other_failures_at_prescribed_steps_do_not_speak_of_vibrations():
    jump = pendulum(force=lambda t, q, v: np.array([0.0, -9.81 - 1e8 * np.sign(q[0] - 0.3)]))
    solution = hb.HHT(jump).solve((0.0, 1.0), HANGING, [1.0, 0.0], step=1e-2)
    assert solution.status is Status.newton_failed
    assert "vibration" not in solution.message


def swing(o, h=0.01, count=20, amplitude=1e-6, **options):
    """A swing of the frequency ``o`` / h by prescribed steps."""
    problem = hb.load_problem(f"simple_pendulum(g={(o / h) ** 2!r}, amplitude={amplitude!r}, t_end={h * count!r})")
    return hb.solve(problem, hb.load_solver("hht", **options), step=h)


@pytest.mark.parametrize("count", [6, 20])
def test_a_vibration_that_grows_to_the_end_of_a_run_is_told(count):
    """Just beyond the bound, where Newton's iteration converges."""
    solution = swing(2.1, count=count)
    assert np.abs(solution.q[:, 0]).max() > 1e-5
    assert solution.status is Status.unreliable
    assert "growth" in solution.message
    assert "carry a vibration of 210 rad/s" in solution.message


@pytest.mark.parametrize("u", [1.0, 30.0])
def test_a_vibration_that_grows_in_a_moving_frame_is_told(u):
    moving = pendulum(
        force=lambda t, q, v: np.array([0.0, -44100.0]),
        constraint=lambda t, q: np.array([((q[0] - u * t) ** 2 + q[1] ** 2 - 1.0) / 2.0]),
        constraint_jacobian=lambda t, q: np.array([[q[0] - u * t, q[1]]]),
    )
    solution = hb.HHT(moving).solve((0.0, 0.18), [np.sin(1e-6), -np.cos(1e-6)], [u, 0.0], step=0.01)
    assert np.abs(solution.v[:, 0] - u).max() > 1.0
    assert solution.status is Status.unreliable
    assert "carry a vibration of" in solution.message


@pytest.mark.parametrize(
    ("o", "options"), [(1.9, {}), (0.1, {}), (2.1, {"b": 1.0}), (200.0, {"b": 1.0}), (5.0, {"alpha": 0.0, "b": 1.0})]
)
def test_a_vibration_that_does_not_grow_is_not_told(o, options):
    assert swing(o, count=200, **options).status is Status.success


def test_what_changing_steps_amplify_is_not_blamed_on_the_tension():
    """A stiff spring along the circle: it goes back and forth with the steps and grows by (H53)."""
    stiff = pendulum(force=lambda t, q, v: np.array([-1e8 * q[0], -9.81]))
    steps = np.tile([1.0, 10.0], 15)
    solution = hb.HHT(stiff, alpha=-0.3).solve((0.0, 1.0), HANGING, [1e-9, 0.0], steps=steps / steps.sum())
    assert solution.status is Status.unreliable
    assert "(H53)" in solution.message
    assert "constraint forces" not in solution.message


def test_steps_by_error_that_follow_what_velocity_constraints_carry_are_told_that_no_option_helps():
    """The rods with a light body, held by k = g' alone: mu carries it, and neither b nor extrapolation is asked there."""

    def rows(t, q, v):
        return np.array([[q[0], q[1], 0.0, 0.0], [q[0] - q[2], q[1] - q[3], q[2] - q[0], q[3] - q[1]]])

    ratio = 1e8
    held = NumpySystem(
        mass_matrix=np.diag([1.0, 1.0, ratio, ratio]),
        force=lambda t, q, v: -GRAVITY * np.array([0.0, 1.0, 0.0, ratio]),
        velocity_constraint=lambda t, q, v: rows(t, q, v) @ v,
        velocity_constraint_jacobian=rows,
    )
    solution = hb.HHT(held).solve((0.0, 1.0), *DoublePendulum.straight(0.5), rtol=1e-4, max_num_steps=1_000)
    assert solution.status is Status.max_steps
    assert "Constraint forces carry a vibration of" in solution.message
    assert solution.message.endswith("follow it; no option takes longer ones, a looser tolerance may.")
