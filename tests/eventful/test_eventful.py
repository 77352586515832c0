"""Events of every solver against closed solutions, against minimal coordinates, and against HHT's own."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import derive
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.counting import Work
from solvers._initcond import project
from solvers._start import PhasePoint
from solvers.eventful.changes import Changes
from solvers.hht.events.locate import Crossing
from solvers.hht.events.sides import BESIDE
from tests.hht.event_scenes import impacts, wall
from tests.hht.scenes import Q0, V0
from tests.sample import slow

G = 9.81
FREE = ["ida(form=index1)", "cvode", "scipy", "scipy(method=DOP853)", "diffrax(method=Dopri8)", "projected"]
BOUND = ["ida", "cvode", "scipy(method=Radau)", "diffrax(method=Dopri8)", "projected", "collocation"]


class Balls(hb.System):
    """Balls of 1 kg that fall, heights q."""

    def force(self, t, q, v):
        return -G * jnp.ones_like(q)


def ball(t_end, heights=(1.0,), **more):
    start = {"q0": list(heights), "v0": [0.0] * len(heights)} | more
    return hb.Problem(name="balls", system=Balls(), t_span=(0.0, t_end), **start)


def bounce(i=0, share=0.5, **options):
    """Ball i leaves the floor with this share of its speed."""
    back = lambda t, q, v: (q, jnp.where(jnp.arange(v.size) == i, -share * v, v))  # noqa: E731
    return hb.Event(lambda t, q, v: q[i], direction=-1, change=back, name=f"floor {i}", **options)


FALL = np.sqrt(2 / G)
HITS = FALL * np.array([1.0, 2.0, 2.5])
TOP = hb.Event(lambda t, q, v: v[0], direction=-1, name="top")


@pytest.mark.parametrize("solver", FREE)
def test_bouncing_ball_hits_and_turns_at_the_closed_times(solver):
    found = hb.solve(ball(1.2), solver, rtol=1e-9, atol=1e-11, events=[bounce(), TOP])
    assert found.status.label == "success"
    np.testing.assert_allclose(found.t_events[0], HITS, atol=1e-8)
    np.testing.assert_allclose(found.t_events[1], FALL * np.array([1.5, 2.25, 2.625]), atol=1e-8)
    np.testing.assert_allclose(found.q_events[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.v_events[0][:, 0], -G * FALL * np.array([1.0, 0.5, 0.25]), rtol=1e-8)
    s = 1.2 - HITS[-1]
    np.testing.assert_allclose(found.q[-1, 0], G * FALL / 8 * s - G * s * s / 2, atol=1e-8)
    twice = np.flatnonzero(np.diff(found.t) == 0.0)  # before and after each change
    np.testing.assert_allclose(found.t[twice], HITS, atol=1e-8)
    np.testing.assert_allclose(found.v[twice + 1], -0.5 * found.v[twice], rtol=1e-12)


@pytest.mark.parametrize("solver", [slow(x) if x.startswith("diffrax") else x for x in BOUND])
def test_pendulum_hits_the_wall_as_in_its_angle(solver):
    times, rates = impacts(3)
    problem = hb.load_problem("simple_pendulum").starting((0.0, times[-1] + 0.1), Q0, V0)
    found = hb.solve(problem, solver, rtol=1e-9, atol=1e-11, events=[wall()])
    assert found.status.label == "success"
    np.testing.assert_allclose(found.t_events[0], times, atol=2e-8)
    np.testing.assert_allclose(found.v_events[0][:, 0], rates, atol=1e-7)
    own = hb.solve(problem, "hht", rtol=1e-7, events=[wall()], t_eval=[times[-1] + 0.1])
    np.testing.assert_allclose(found.q[-1], own.q[-1], atol=1e-6)
    level = np.abs(found.q[:, 0] * found.v[:, 0] + found.q[:, 1] * found.v[:, 1])
    after = np.flatnonzero(np.diff(found.t) == 0.0) + 1
    np.testing.assert_allclose(level[after], 0.0, atol=1e-12)  # changes are projected


class Crane(hb.System):
    """A trolley of 20 kg on a rail, its load of 5 kg on a rope of 4 m."""

    mass_matrix = (20.0, 5.0, 5.0)

    def force(self, t, q, v):
        return jnp.stack([50.0 * jnp.sin(t) - 10.0 * v[0], 0.0, -G * 5.0])

    def constraint(self, t, q):
        return ((q[1] - q[0]) ** 2 + q[2] ** 2 - 16.0)[None] / 2


STOP = hb.Event(lambda t, q, v: q[0] - 2.0, direction=1, change=lambda t, q, v: (q, -0.5 * v), name="end of the rail")
BRAKE = hb.Event(
    lambda t, q, v: q[1] - q[0] - 0.6,
    direction=1,
    change=lambda t, q, v: (q, v * jnp.array([1.0, 0.7, 0.7])),
    name="brake of the load, which swings on",
)


@pytest.mark.parametrize(
    ("solver", "rtol"), [("ida", 1e-9), ("projected", 1e-9), *(slow(x, 1e-9) for x in BOUND[1:4]), slow("collocation", 1e-9)]
)
def test_all_solvers_agree_on_a_crane_with_two_events(solver, rtol):
    """Numbers: projected(DOP853) and Radau at 1e-11, by an own few lines that share no code with the events here."""
    crane = hb.Problem(name="crane", system=Crane(), t_span=(0.0, 10.0), q0=[0.0, 0.0, -4.0], v0=[0.0] * 3)
    found = hb.solve(crane, solver, rtol=rtol, atol=1e-11, events=[STOP, BRAKE])
    np.testing.assert_allclose(found.t_events[0], [2.0342532127], atol=5e-9)
    np.testing.assert_allclose(found.t_events[1], [3.8139205304, 9.7548439276], atol=2e-8)
    np.testing.assert_allclose(found.q[-1], [-1.39549788, -0.8127395, -3.95732140], atol=5e-8)


@pytest.mark.parametrize("solver", ["cvode", "projected"])
@pytest.mark.parametrize("height", [0.3, 0.7, 1.1, 2.6])
def test_two_events_at_one_time_both_change_the_state(solver, height):
    fall = np.sqrt(2 * height / G)
    found = hb.solve(ball(1.5 * fall, (height, 3 * height / 3)), solver, rtol=1e-8, events=[bounce(0), bounce(1)])
    assert [each.size for each in found.t_events] == [1, 1]
    assert found.q.min() > -1e-9


def test_events_that_only_watch_leave_every_step_as_it_is():
    plain = hb.solve(ball(0.4), "scipy(method=DOP853)", rtol=1e-8)
    found = hb.solve(ball(0.4), "scipy(method=DOP853)", rtol=1e-8, events=[hb.Event(lambda t, q, v: q[0] - 0.5)])
    np.testing.assert_allclose(found.t_events[0], np.sqrt(1 / G), atol=1e-12)
    np.testing.assert_allclose(found.q[-1], plain.q[-1], atol=1e-12)


@pytest.mark.parametrize("solver", ["cvode", "projected"])
def test_terminal_events_end_at_their_occurrence(solver):
    for count in (True, 2):
        found = hb.solve(ball(9.0), solver, rtol=1e-9, events=[bounce(terminal=count)])
        assert (found.status.label, found.t_events[0].size) == ("event", int(count))
        assert found.t[-1] == found.t_events[0][-1]
        np.testing.assert_allclose(found.t[-1], HITS[int(count) - 1], atol=1e-8)


@pytest.mark.parametrize("solver", ["cvode", "projected"])
def test_rows_at_given_times_are_those_of_the_motion(solver):
    times = np.linspace(0.0, 1.2, 7)
    found = hb.solve(ball(1.2), solver, rtol=1e-9, atol=1e-11, events=[bounce()], t_eval=times)
    np.testing.assert_array_equal(found.t, times)
    begun = np.array([0.0, *HITS])[np.searchsorted(HITS, times)]
    speed = np.array([0.0, *(G * FALL * np.array([0.5, 0.25, 0.125]))])[np.searchsorted(HITS, times)]
    s = times - begun
    np.testing.assert_allclose(found.q[:, 0], (begun == 0.0) + speed * s - G * s * s / 2, atol=1e-8)
    ended = hb.solve(ball(1.2), solver, rtol=1e-9, events=[bounce(terminal=True)], t_eval=times)
    np.testing.assert_array_equal(ended.t, times[times < HITS[0]])


def test_a_row_at_the_time_of_a_change_is_there_once_with_the_state_after_it():
    turn = hb.Event(lambda t, q, v: t - 0.25, change=lambda t, q, v: (q, -v))
    found = hb.solve(ball(0.5), "scipy(method=DOP853)", rtol=1e-9, events=[turn], t_eval=[0.0, 0.25, 0.5])
    np.testing.assert_array_equal(found.t, [0.0, 0.25, 0.5])
    np.testing.assert_allclose(found.v[:, 0], [0.0, 0.25 * G, 0.0], atol=1e-9)


def test_time_may_run_backward():
    problem = ball(1.0, q0=[0.0], v0=[-G * FALL]).starting((FALL, 0.0))
    half = hb.Event(lambda t, q, v: q[0] - 0.5, direction=1)
    found = hb.solve(problem, "scipy(method=DOP853)", rtol=1e-9, events=[half])
    np.testing.assert_allclose(found.t_events[0], np.sqrt(1 / G), atol=1e-10)


def test_a_ball_that_comes_to_rest_ends_the_run_where_its_bounces_pile_up():
    found = hb.solve(ball(3.0), "projected", rtol=1e-8, events=[bounce()])
    assert found.status.label == "time_resolution"
    assert "pile up" in found.message
    np.testing.assert_allclose(found.t[-1], 3 * FALL, atol=1e-6)
    assert found.t_events[0].size > 20


@pytest.mark.parametrize(
    ("solver", "rtol"),
    [
        *(("ida(form=index1)", 1e-6), ("cvode", 1e-8), ("scipy(method=LSODA)", 1e-4)),
        *(("scipy(method=Radau)", 1e-6), ("projected", 1e-8)),
    ],
)
def test_no_ball_falls_through_the_floor_when_it_comes_to_rest(solver, rtol):
    found = hb.solve(ball(10.0), solver, rtol=rtol, atol=rtol, events=[bounce()], max_seconds=60.0)
    assert found.status.label == "time_resolution"
    assert found.q.min() > -10 * rtol


@pytest.mark.parametrize("solver", ["cvode", "projected", "scipy(method=Radau)"])
@pytest.mark.parametrize("end", [0.4, 0.8, 2.1, 2.5])
def test_a_change_at_the_end_of_the_interval_or_of_the_run_is_in_the_last_row(solver, end):
    clock = lambda t, q, v: q[1] - end  # noqa: E731 - a coordinate of unit speed, so that the solver finds the time
    double = lambda t, q, v: (q, 2 * v)  # noqa: E731

    class Clock(hb.System):
        def force(self, t, q, v):
            return jnp.stack([-q[0], 0.0])

    for more, last in ({"terminal": False}, end), ({"terminal": True}, 3.0):
        problem = hb.Problem(name="clock", system=Clock(), t_span=(0.0, last), q0=[1.0, 0.0], v0=[0.0, 1.0])
        found = hb.solve(problem, solver, rtol=1e-9, atol=1e-11, events=[hb.Event(clock, change=double, **more)])
        assert found.status.label == ("event" if last == 3.0 else "success"), found.message
        times = 1 + found.t_events[0].size  # at the end of the interval it may be beyond by roundoff
        assert times == 2 or last == end
        np.testing.assert_allclose(found.v[-1], [-times * np.sin(end), times], atol=1e-7)


def test_a_start_on_the_floor_with_the_motion_upward_is_no_event():
    found = hb.solve(ball(0.5, q0=[0.0], v0=[3.0]), "cvode", rtol=1e-9, events=[bounce()])
    assert found.t_events[0].size == 0
    found = hb.solve(ball(0.17, q0=[0.0], v0=[-1.0]), "cvode", rtol=1e-9, atol=1e-12, events=[bounce()])
    np.testing.assert_allclose(found.t_events[0], [0.0, 1.0 / G, 1.5 / G], atol=1e-8)


def test_a_zero_at_the_end_of_the_interval_is_an_event():
    at_end = hb.Event(lambda t, q, v: t - 0.4, change=lambda t, q, v: (q, -v))
    found = hb.solve(ball(0.4), "projected", rtol=1e-8, events=[at_end])
    assert (found.status.label, found.t_events[0].tolist()) == ("success", [0.4])
    np.testing.assert_allclose(found.v[-2:, 0], [-0.4 * G, 0.4 * G], rtol=1e-12)


def test_a_function_that_jumps_and_a_numpy_system_take_events_too():
    system = NumpySystem(force=lambda t, q, v: np.array([-G]))
    fall = hb.Problem(name="fall", system=system, t_span=(0.0, 1.2), q0=[1.0], v0=[0.0])
    events = [hb.Event(lambda t, q, v: q[0], direction=-1, change=lambda t, q, v: (q, -0.5 * v))]
    found = hb.solve(fall, "scipy(method=DOP853)", rtol=1e-9, events=events)
    np.testing.assert_allclose(found.t_events[0], HITS, atol=1e-8)
    step = hb.Event(lambda t, q, v: 1.0 if t >= 0.3 else -1.0, terminal=True)
    found = hb.solve(fall, "scipy(method=DOP853)", rtol=1e-9, events=[step])
    np.testing.assert_allclose(found.t[-1], 0.3, atol=1e-12)


def test_wrong_events_and_failures_are_those_of_hht():
    with pytest.raises(TypeError, match="must return one real number"):
        hb.solve(ball(1.0), "cvode", rtol=1e-6, events=[hb.Event(lambda t, q, v: q)])
    with pytest.raises(TypeError, match=r"change of event 'bad' must return \(q, v\)"):
        hb.solve(ball(1.0), "cvode", rtol=1e-6, events=[hb.Event(lambda t, q, v: q[0], change=lambda *_: 1, name="bad")])
    nan = hb.Event(lambda t, q, v: jnp.where(q[0] > 0.5, 1.0, jnp.nan), name="nan")
    assert hb.solve(ball(1.0), "cvode", rtol=1e-6, events=[nan]).status.label == "nonfinite_callback"
    declined = hb.solve(ball(1.0), "cvode", steps=10, events=[bounce()])
    assert declined.status.label == "declined"
    few = hb.solve(ball(1.2), "cvode", rtol=1e-9, max_num_steps=20, events=[bounce()])
    assert few.status.label == "max_steps"
    assert few.counters.steps_accepted <= 20
    assert few.t.size


@pytest.mark.parametrize("off", [-1e-9, 1e-9])
def test_a_projected_change_that_lets_the_motion_pass_stays_behind_its_zero(off):
    q, v = np.array([0.0, 0.6, -np.sqrt(16.0 - 0.36) + off]), np.array([0.0, 1.0, 0.0])
    dynamics = derive(Crane(), 0.0, q, v)
    changes = Changes([BRAKE], [BRAKE], dynamics, Work())
    place = changes.point(0.0, q, v, 4.0, 1.0)

    def bound(state):
        moved, _ = project(dynamics, PhasePoint(0.0, state.q, state.v), Work())
        return replace(state, q=moved.q, v=moved.v)

    after, known = changes.applied([Crossing(0, 0.0, -1, (0.0, 0.0))], place, 0.1, np.array([-1.0, 0.0]), bound)
    assert abs(after.q[1] - after.q[0] - 0.6) > 1e-12  # the projection has moved it off the zero, either way
    assert known[0] == BESIDE


@pytest.mark.filterwarnings("ignore:redundant")
def test_redundant_rows_that_have_drifted_stop_no_run():
    turned = hb.Event(lambda t, q, v: q[0] - 0.3, change=lambda t, q, v: (q, 0.9 * v), name="turned")
    problem = hb.load_problem("bricard").starting((0.0, 1.5))
    found = [hb.solve(problem, one, rtol=1e-6, events=[turned]) for one in ("hht", "projected", "scipy(method=Radau)")]
    assert [one.status.label for one in found] == ["success"] * 3
    assert found[0].t_events[0].size
    for other in found[1:]:
        assert "calc_initcond" not in other.message
        np.testing.assert_allclose(other.t_events[0], found[0].t_events[0], atol=2e-5)
        np.testing.assert_allclose(other.q[-1], found[0].q[-1], atol=2e-5)
