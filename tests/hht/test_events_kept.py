"""Where a change turns or stops an event's function, the motion never goes on silently on the other side of its zero."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import AT_REST, FREE, GRAVITY, HOW, height
from tests.hht.scenes import SYSTEMS

TWO = NumpySystem(force=lambda t, q, v: np.full(2, -GRAVITY))


def floor(level, restitution, direction=-1):
    """A floor for the first coordinate."""
    turned = lambda t, q, v: (q, -restitution * v)  # noqa: E731
    return Event(lambda t, q, v: q[0] - level, direction=direction, change=turned, name="floor")


def side(i, restitution=0.8):
    """A floor for coordinate ``i`` of two."""
    turned = lambda t, q, v: (q, v * np.where(np.arange(2) == i, -restitution, 1.0))  # noqa: E731
    return Event(lambda t, q, v: q[i], direction=-1, change=turned, name=f"side {i}")


@pytest.mark.parametrize("restitution", [0.0, 1e-3, 0.5, 0.9])
@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("how", [*HOW, {"step": 0.01}], ids=str)
def test_bounces_on_a_floor_away_from_zero_end_where_they_pile_up(how, direction, restitution):
    """From -1 heights are differences of rounded numbers; the flights add up to fall (1 + e) / (1 - e)."""
    solution = HHT(FREE, events=floor(-1.0, restitution, direction)).solve((0.0, 10.0), [0.0], [0.0], **how)
    assert solution.status is Status.time_resolution
    assert "'floor' pile up" in solution.message
    rest = np.sqrt(2.0 / GRAVITY) * (1 + restitution) / (1 - restitution)
    assert abs(solution.t[-1] - rest) < 1e-5
    assert solution.q.min() > -1.0 - 1e-14
    assert abs(solution.q[-1, 0] + 1.0) < 1e-10


def test_bounces_that_pile_up_are_no_success_with_an_accuracy():
    class Ball(hb.System):
        def force(self, t, q, v):
            return jnp.stack([-9.8])

    ball = hb.Problem(name="ball", system=Ball(), t_span=(0, 2.0), q0=[0.0], v0=[0.0])
    solution = hb.solve(ball, "hht", events=[floor(-1.0, 0.5)], accuracy=1e-3)
    assert solution.status is Status.time_resolution
    assert abs(solution.t_events[0][-1] - 3 * np.sqrt(2 / 9.8)) < 1e-5


@pytest.mark.parametrize("how", HOW, ids=str)
def test_bounces_pile_up_when_steps_are_made_by_hand(how):
    solver = HHT(FREE, events=floor(-1.0, 0.5))
    assert solver.init_step(0.0, [0.0], [0.0], **how) is Status.success
    assert solver.step(2.0, "normal") is Status.time_resolution
    assert "'floor' pile up" in solver.message
    assert abs(solver.state.t - 3 * np.sqrt(2 / GRAVITY)) < 1e-5


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("level", [0.1, -0.1])
def test_a_rod_stays_on_its_side_of_a_wall(level, restitution):
    """Beyond its lowest point the rod falls off the wall again; before it, it comes to rest there."""
    solution = HHT(SYSTEMS["numpy"], events=floor(level, restitution)).solve(
        (0.0, 6.0), [np.sin(1.0), -np.cos(1.0)], [0, 0], step=0.02
    )
    assert solution.status is (Status.time_resolution if level > 0 else Status.success)
    assert solution.q[:, 0].min() > level - 1e-14
    assert solution.t_events[0].size > 0


@pytest.mark.parametrize("apart", [0, 1, 2, 5, 8, 13, 40])
@pytest.mark.parametrize("how", HOW, ids=str)
def test_two_balls_that_land_within_roundoff_both_bounce(how, apart):
    height = 0.6
    landing = np.sqrt(2 * height / GRAVITY)
    start = [height, height + apart * np.spacing(height)]
    solution = HHT(TWO, events=[side(0), side(1)]).solve((0.0, 2 * landing), start, [0.0, 0.0], **how)
    assert solution.success
    for found in solution.t_events:
        np.testing.assert_allclose(found, [landing], atol=1e-14)
    assert solution.q.min() > -1e-14


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("speed", [1.0, 0.3])
def test_a_ball_that_meets_a_corner_is_turned_by_both_walls(how, speed):
    free = NumpySystem(force=lambda t, q, v: np.zeros(2))
    start = np.array([0.7, 0.7 * speed])
    solution = HHT(free, events=[side(0), side(1)]).solve((0.0, 2.0), start, [-1.0, -speed], **how)
    assert solution.success
    assert [found.size for found in solution.t_events] == [1, 1]
    np.testing.assert_allclose(solution.q[-1], 0.8 * 1.3 * np.array([1.0, speed]), rtol=1e-12)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("half_angle", [20.0, 30.0, 40.0, 60.0])
def test_a_ball_dropped_into_a_wedge_passes_neither_wall(how, half_angle):
    """The change by the second wall leads back to the first, so that it is met again at the same time."""
    x, y = np.cos(np.radians(half_angle)), np.sin(np.radians(half_angle))
    normals = [np.array([x, y]), np.array([-x, y])]
    walls = [
        Event(lambda t, q, v, n=n: n @ q, direction=-1, change=lambda t, q, v, n=n: (q, v - 1.9 * (n @ v) * n))
        for n in normals
    ]
    falls = NumpySystem(force=lambda t, q, v: np.array([0.0, -GRAVITY]))
    solution = HHT(falls, events=walls).solve((0.0, 1.0), [0.0, 1.0], [0.0, 0.0], **how)
    assert solution.success or "pile up" in solution.message
    assert min((solution.q @ n).min() for n in normals) > -1e-14
    least = 2 if half_angle < 40.0 else 1
    assert max(found.size for found in solution.t_events) >= least


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("gap", [0.0, 1e-15, -1e-15, 1e-12])
def test_three_equal_masses_that_meet_together_part_in_their_order(how, order, gap):
    """The outer ones exchange their speeds through the one in the middle, which stays at rest."""

    def meeting(i):
        swapped = [1, 0, 2] if i == 0 else [0, 2, 1]
        return Event(lambda t, q, v: q[i + 1] - q[i], direction=-1, change=lambda t, q, v: (q, v[swapped]))

    free = NumpySystem(force=lambda t, q, v: np.zeros(3))
    events = [meeting(i) for i in order]
    solution = HHT(free, events=events).solve((0.0, 2.0), [-1.0, gap, 1.0], [1.0, 0.0, -1.0], **how)
    assert solution.success, solution.message
    np.testing.assert_allclose(solution.q[-1], [-1.0, 0.0, 1.0], atol=1e-11)
    assert sum(len(found) for found in solution.t_events) == 3


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_a_terminal_floor_with_a_change_ends_a_motion_that_begins_on_it(how, speed):
    event = Event(height, direction=-1, terminal=True, change=lambda t, q, v: (q, -0.5 * v))
    solution = HHT(FREE, events=event).solve((0.0, 2.0), [0.0], [speed], **how)
    assert solution.status is Status.event
    assert (solution.t[-1], solution.v[-1, 0]) == (0.0, -0.5 * speed)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize(("level", "ulps"), [(0.0, 0), (-1.0, -1), (-1.0, 0), (-1.0, 1), (0.3, -1), (0.3, 0), (0.3, 1)])
def test_a_start_at_rest_on_a_floor_is_ended_by_its_name(how, level, ulps):
    start = level + ulps * np.spacing(level)
    solution = HHT(FREE, events=floor(level, 0.5)).solve((0.0, 2.0), [start], [0.0], **how)
    assert solution.status is Status.time_resolution
    assert "'floor' pile up" in solution.message
    assert abs(solution.q[-1, 0] - level) < 1e-14


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_start_that_moves_into_a_floor_bounces_there(how):
    """Thrown down at 1 m/s from the floor it flies for 2 e / g, e^2 and so on."""
    solution = HHT(FREE, events=floor(0.0, 0.5)).solve((0.0, 0.16), [0.0], [-1.0], **how)
    assert solution.success
    np.testing.assert_allclose(solution.t_events[0], np.array([0.0, 1.0, 1.5]) / GRAVITY, atol=1e-14)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_motion_that_a_change_stops_on_a_floor_is_ended_by_its_name(how):
    solution = HHT(FREE, events=floor(0.0, 0.0)).solve((0.0, 2.0), [1.0], [0.0], **how)
    assert solution.status is Status.time_resolution
    assert solution.t[-1] == pytest.approx(np.sqrt(2 / GRAVITY), abs=1e-14)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_motion_that_is_stopped_where_no_force_pushes_it_on_rests_there(how):
    solution = HHT(AT_REST, events=floor(0.35, 0.0, direction=0)).solve((0.0, 2.0), [0.0], [1.0], **how)
    assert solution.success
    np.testing.assert_allclose(solution.t_events[0], [0.35], rtol=1e-14)
    np.testing.assert_allclose(solution.q[-1], 0.35, rtol=1e-14)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("direction", [1, 0])
@pytest.mark.parametrize("factor", [2.0, 1.0, 0.5, 1e-3])
def test_a_change_that_does_not_turn_the_motion_lets_it_pass(factor, direction, how):
    slower = Event(lambda t, q, v: q[0] - 0.35, direction=direction, change=lambda t, q, v: (q, factor * v))
    solution = HHT(AT_REST, events=slower).solve((0.0, 2.0), [0.0], [1.0], **how)
    assert solution.success
    np.testing.assert_allclose(solution.t_events[0], [0.35], rtol=1e-14)
    np.testing.assert_allclose(solution.q[-1], 0.35 + factor * 1.65, rtol=1e-12)


@pytest.mark.parametrize("gap", [1e-9, 1e-12, 1e-15])
def test_a_bounce_just_before_a_prescribed_time_is_no_second_one(gap):
    fall = np.sqrt(2 / GRAVITY)
    solution = HHT(FREE, events=Event(height, change=lambda t, q, v: (q, -0.5 * v))).solve(
        (0.0, 1.5 * (fall + gap)), [1.0], [0.0], step=(fall + gap) / 2
    )
    assert solution.success
    np.testing.assert_allclose(solution.t_events[0], [fall], rtol=1e-14)


def test_an_impact_just_behind_a_steps_start_is_no_pile_up():
    """The second bounce of a ball lies 1e-7 of a step behind the start of a step that no change has made."""
    system = NumpySystem(force=lambda t, q, v: np.array([-GRAVITY]))
    floor = Event(lambda t, q, v: q[0], direction=-1, change=lambda t, q, v: (q, -0.5 * v))
    second = 2.0 * np.sqrt(2.0 / GRAVITY)  # of a fall from 1 m and a rebound with half the speed
    ends = np.concatenate([[0.0], np.arange(0.1, second - 0.05, 0.1), second - 1e-8 + 0.1 * np.arange(3)])
    solution = HHT(system, alpha=0.0, events=floor).solve((0.0, ends[-1]), [1.0], [0.0], steps=np.diff(ends))
    assert solution.success, solution.message
    assert np.allclose(solution.t_events[0][:2], [second / 2, second], rtol=0, atol=1e-6)
