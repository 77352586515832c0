"""Events: where they are found, what stops, what changes, and what wrong use and failures say (rows E1, E2, C11, P11)."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT, Event
from tests.hht.scenes import ALPHAS, ANGLE, GRAVITY, Q0, SPEED, SYSTEMS, V0, pendulum, pendulum_at, same_bits, tension_at

FREE = NumpySystem(force=lambda t, q, v: np.array([-GRAVITY]))
AT_REST = NumpySystem(force=lambda t, q, v: np.zeros(1))  # with v = 1 the coordinate is the time
HOW = [{"step": 0.1}, {"rtol": 1e-6}]
RESTITUTION = 0.7


def height(t, q, v):
    return q[0]


def clock(at, **options):
    """An event at a given time."""
    return Event(lambda t, q, v: t - at, **options)


def drift(events, span=(0.0, 1.0), **how):
    """The free coordinate with q = t and v = 1: an event of q - c is at c."""
    return HHT(AT_REST, events=events).solve(span, [span[0]], [1.0], **(how or {"step": 0.1}))


def wall():
    """The vertical through the pivot, hit from the right."""
    return Event(height, direction=-1, change=lambda t, q, v: (q, -RESTITUTION * v), name="wall")


def impacts(count):
    """Times of the unit pendulum's impacts and the rates before them, from its angle's equation by DOP853."""

    def hit(t, y):
        return y[0]

    hit.terminal, hit.direction = True, -1
    t, y, times, rates = 0.0, [ANGLE, SPEED], [], []
    for _ in range(count):
        rate = lambda _, y: [y[1], -GRAVITY * np.sin(y[0])]  # noqa: E731
        flight = solve_ivp(rate, (t, t + 9.0), y, "DOP853", events=hit, rtol=1e-13, atol=1e-14)
        t, y = flight.t[-1], [0.0, -RESTITUTION * flight.y[1, -1]]
        times.append(t)
        rates.append(flight.y[1, -1])
    return np.array(times), np.array(rates)


# Location


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_bouncing_ball_hits_the_floor_when_the_closed_solution_does(how):
    """Free fall is a parabola, which the method follows exactly: only roundoff is left of the impact times."""
    floor = Event(height, direction=-1, change=lambda t, q, v: (q, -RESTITUTION * v))
    solution = HHT(FREE, alpha=-0.3, events=[floor]).solve((0.0, 2.0), [1.0], [0.0], **how)
    fall = np.sqrt(2.0 / GRAVITY)
    expected = fall + 2 * fall * np.cumsum([0.0, *RESTITUTION ** np.arange(1, 20)])
    expected = expected[expected < 2.0]
    assert len(expected) >= 4
    np.testing.assert_allclose(solution.t_events[0], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(solution.q_events[0], 0.0, atol=1e-14)
    speeds = GRAVITY * fall * RESTITUTION ** np.arange(len(expected))
    np.testing.assert_allclose(solution.v_events[0][:, 0], -speeds, rtol=1e-13)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
def test_impacts_of_a_pendulum_on_a_wall_converge_with_order_two(route, alpha):
    times, rates = impacts(2)
    errors = []
    for step in (0.02, 0.01):
        solution = HHT(SYSTEMS[route], alpha=alpha, events=wall()).solve((0.0, 1.8), Q0, V0, step=step)
        assert solution.success, solution.message
        errors.append([*np.abs(solution.t_events[0] - times), *np.abs(solution.v_events[0][:, 0] - rates)])
    assert np.all(np.array(errors[0]) > 3.5 * np.array(errors[1]))
    assert np.max(errors[1]) < 2e-3


@pytest.mark.parametrize("route", SYSTEMS)
def test_impacts_under_error_control_follow_the_tolerance(route):
    times, _ = impacts(2)
    solution = HHT(SYSTEMS[route], events=wall()).solve((0.0, 1.8), Q0, V0, rtol=1e-5)
    assert np.max(np.abs(solution.t_events[0] - times)) < 2e-5
    assert solution.counters.steps_rejected_error <= 4


@pytest.mark.parametrize("how", [{"step": 0.01}, {"rtol": 1e-5}], ids=str)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_both_levels_hold_to_roundoff_at_an_event_before_and_after_the_change(alpha, how):
    solution = HHT(SYSTEMS["jax"], alpha=alpha, events=wall()).solve((0.0, 0.7), Q0, V0, **how)
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    assert solution.t[row] == solution.t_events[0][0]
    for i in (row, row + 1):
        assert abs(solution.q[i] @ solution.q[i] - 1.0) < 1e-13
        assert abs(solution.q[i] @ solution.v[i]) < 1e-13
        assert abs(solution.lam[i, 0] - tension_at(solution.q[i], solution.v[i])) < 1e-12
    assert abs(solution.q[row, 0]) < 1e-14
    np.testing.assert_allclose(solution.v[row + 1], -RESTITUTION * solution.v[row], atol=1e-13)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
def test_a_terminal_event_ends_the_run_at_its_time_with_a_state_of_second_order(route, alpha):
    level = Event(lambda t, q, v: q[0] - 0.3, terminal=True, name="level")
    errors = []
    for step in (0.02, 0.01):
        solution = HHT(SYSTEMS[route], alpha=alpha, events=[level]).solve((0.0, 3.0), Q0, V0, step=step)
        assert solution.status is Status.event
        assert solution.success
        assert solution.t[-1] == solution.t_events[0][0]
        assert "'level'" in solution.message
        assert f"{solution.t[-1]:.17g}" in solution.message
        assert abs(solution.q[-1, 0] - 0.3) < 1e-15
        assert abs(solution.q[-1] @ solution.q[-1] - 1.0) < 1e-13
        assert abs(solution.q[-1] @ solution.v[-1]) < 1e-13
        q, v = pendulum_at(solution.t)
        errors.append(max(np.max(np.abs(solution.q[-1] - q[-1])), np.max(np.abs(solution.v[-1] - v[-1]))))
    assert errors[0] > 3.4 * errors[1]


def test_a_terminal_event_of_a_system_with_velocity_constraints_keeps_them():
    problem = hb.load_problem("knife_edge")
    turned = Event(lambda t, q, v: q[2] - problem.q0[2] - 0.5, terminal=True)
    solution = HHT(problem.system, events=turned).solve(problem.t_span, problem.q0, problem.v0, step=0.05)
    assert solution.status is Status.event, solution.message
    phi, (x, y) = solution.q[-1, 2], solution.v[-1, :2]
    assert abs(phi - problem.q0[2] - 0.5) < 1e-15
    assert abs(x * np.sin(phi) - y * np.cos(phi)) < 1e-13


@pytest.mark.parametrize("how", [*HOW, {"steps": 3}, {"steps": [0.13, 0.87]}], ids=str)
@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize(
    "function",
    [lambda t, q, v: np.sign(q[0] - 0.3), lambda t, q, v: 1.0 if t > 0.3 else -2.0, lambda t, q, v: np.floor(t + 0.7) - 0.5],
)
def test_a_function_that_jumps_is_located_to_roundoff(function, terminal, how):
    solution = drift(Event(function, terminal=terminal), **how)
    assert solution.t_events[0].shape == (1,)
    assert abs(solution.t_events[0][0] - 0.3) < 1e-15 * 4


# What counts as an event


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("event", [height, Event(height, terminal=True), Event(height, change=lambda t, q, v: (q, v))])
def test_a_motion_that_begins_on_a_zero_has_no_event_there(event, how):
    solution = drift(event, **how)
    assert solution.status is Status.success
    assert solution.t_events[0].size == 0
    ball = HHT(FREE, events=event).solve((0.0, 1.0), [0.0], [GRAVITY / 4], **how)  # up, and back at t = 1/2
    np.testing.assert_allclose(ball.t_events[0], [0.5], rtol=1e-14)


@pytest.mark.parametrize("how", HOW, ids=str)
@pytest.mark.parametrize("kind", ["recorded", "terminal", "change"])
def test_a_zero_exactly_at_the_end_is_one_event(kind, how):
    options = {"recorded": {}, "terminal": {"terminal": True}, "change": {"change": lambda t, q, v: (q, 2 * v)}}[kind]
    solution = HHT(FREE, events=clock(1.0, **options)).solve((0.0, 1.0), [1.0], [0.0], **how)
    assert np.array_equal(solution.t_events[0], [1.0])
    assert solution.status is (Status.event if kind == "terminal" else Status.success)
    assert solution.t[-1] == 1.0
    if kind == "change":
        assert np.array_equal(solution.v[-1], 2 * solution.v[-2])
        assert np.array_equal(solution(1.0).v, solution.v[-1])


def test_a_motion_goes_on_from_a_terminal_event_without_meeting_it_again():
    level = Event(lambda t, q, v: q[0] - 0.3, terminal=True)
    solver = HHT(SYSTEMS["numpy"], events=level)
    first = solver.solve((0.0, 3.0), Q0, V0, step=0.01)
    second = solver.solve((first.t[-1], 3.0), first.q[-1], first.v[-1], step=0.01)
    assert second.status is Status.event
    assert second.t[-1] > first.t[-1] + 0.1


@pytest.mark.parametrize("span", [(0.0, 2.0), (0.0, -2.0)])
@pytest.mark.parametrize("how", HOW, ids=str)
def test_the_direction_is_that_of_the_function_along_the_integration(span, how):
    rate = np.copysign(1.0, span[1])  # of the angle pi/2 at |t| = 1/2 and so on
    waves = [Event(lambda t, q, v: np.cos(np.pi * q[0]), direction=d) for d in (-1, 0, 1)]
    solution = HHT(AT_REST, events=waves).solve(span, [0.0], [1.0], **how)
    for found, expected in zip(solution.t_events, ([0.5], [0.5, 1.5], [1.5]), strict=True):
        np.testing.assert_allclose(found, rate * np.array(expected), rtol=1e-14)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_numbered_occurrence_is_terminal_and_every_solve_counts_anew(how):
    wave = Event(lambda t, q, v: np.sin(np.pi * (q[0] - 0.1)), terminal=3)
    solver = HHT(AT_REST, events=wave)
    for _ in range(2):
        solution = solver.solve((0.0, 9.0), [0.0], [1.0], **how)
        np.testing.assert_allclose(solution.t_events[0], [0.1, 1.1, 2.1], rtol=1e-14)
        assert solution.status is Status.event


@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0)])
def test_events_in_one_step_come_in_order_of_time_and_a_terminal_one_cuts_off_the_later(span):
    crossed = []

    def at(place):
        return Event(lambda t, q, v: q[0] - place, change=lambda t, q, v: (crossed.append(place), (q, v))[1])

    stop = Event(lambda t, q, v: q[0] - 0.5, terminal=True)
    solution = drift([at(0.8), stop, at(0.4), at(0.6), at(0.2), lambda t, q, v: q[0] - 0.45], span=span, steps=1)
    forward = span[1] > span[0]
    assert crossed == ([0.2, 0.4] if forward else [0.8, 0.6])
    assert solution.t[-1] == pytest.approx(0.5, abs=1e-15)
    assert [len(t) for t in solution.t_events] == ([0, 1, 1, 0, 1, 1] if forward else [1, 1, 0, 1, 0, 0])
    assert solution.status is Status.event


def test_events_at_one_time_change_the_state_in_their_order():
    times_two, plus_one = (
        clock(0.55, change=lambda t, q, v: (q, 2 * v)),
        Event(lambda t, q, v: q[0] - 0.55, change=lambda t, q, v: (q, v + 1)),
    )
    assert drift([times_two, plus_one]).v[-1, 0] == pytest.approx(3.0, abs=1e-14)
    assert drift([plus_one, times_two]).v[-1, 0] == pytest.approx(4.0, abs=1e-14)


def test_two_zeros_in_one_step_are_found_where_a_sample_lies_between():
    pair = Event(lambda t, q, v: (q[0] - 0.42) * (q[0] - 0.43), samples=4)
    assert drift(pair, steps=1).t_events[0].size == 0
    found = drift(Event(pair.function, samples=199), steps=1).t_events[0]
    np.testing.assert_allclose(found, [0.42, 0.43], rtol=1e-14)


def test_an_event_of_the_interpolant_alone_stops_nothing():
    """At the turning point the dense output may pass a level that the steps' own ends do not reach."""
    solver = HHT(SYSTEMS["jax"], alpha=0.0)
    plain = solver.solve((0.0, 0.4), Q0, V0, step=0.1)
    top = plain(np.linspace(0.0, 0.4, 4001)).q[:, 0].max()
    for below in (1e-5, 1e-7, 1e-9):
        level = Event(lambda t, q, v, below=below: q[0] - top + below, terminal=5, samples=64)
        stopped = HHT(SYSTEMS["jax"], alpha=0.0, events=level).solve((0.0, 0.4), Q0, V0, step=0.1)
        assert stopped.status is Status.success, stopped.message


# Changes of state


def test_a_change_is_projected_onto_both_levels_in_the_norm_of_the_mass():
    kick = clock(0.25, change=lambda t, q, v: (1.1 * q, v + np.array([1.0, 2.0])))
    solution = HHT(SYSTEMS["jax"], events=kick).solve((0.0, 0.5), Q0, V0, step=0.01)
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    q, v = solution.q[row], solution.v[row] + np.array([1.0, 2.0])
    np.testing.assert_allclose(solution.q[row + 1], q, atol=1e-13)  # the closest point of the circle to 1.1 q
    np.testing.assert_allclose(solution.v[row + 1], v - q * (q @ v), atol=1e-13)
    assert np.max(np.abs(np.sum(solution.q**2, 1) - 1)) < 1e-13


@pytest.mark.parametrize("how", [{"step": 0.03}, {"rtol": 1e-6}], ids=str)
def test_a_force_that_flips_at_a_declared_time_costs_no_accuracy(how):
    """Row P11 of the acceptance matrix: an event there makes the step land and begin anew."""
    flipping = NumpySystem(force=lambda t, q, v: np.array([1.0 if t < 0.5 else -1.0]))
    ends = []
    for events in (None, clock(0.5, change=lambda t, q, v: (q, v))):
        ends.append(HHT(flipping, events=events).solve((0.0, 1.0), [0.0], [0.0], **how).q[-1, 0])
    assert abs(ends[1] - 0.25) < 1e-13
    assert abs(ends[1] - 0.25) < abs(ends[0] - 0.25)


def test_prescribed_steps_keep_their_grid_after_an_event():
    solution = HHT(FREE, events=clock(0.25, change=lambda t, q, v: (q, v))).solve((0.0, 1.0), [0.0], [1.0], step=0.1)
    assert set(np.arange(11) / 10) <= set(solution.t)
    assert len(solution.t) == 13
    assert len(solution.steps_data.t) == solution.counters.steps_accepted == 11
    np.testing.assert_allclose(solution.steps_data.h[2:4], 0.05, atol=1e-15)


def test_dense_output_is_that_of_its_side_of_a_change_and_the_new_state_at_it():
    solution = HHT(SYSTEMS["jax"], events=wall()).solve((0.0, 0.7), Q0, V0, step=0.01)
    at = solution.t_events[0][0]
    (row,) = np.flatnonzero(np.diff(solution.t) == 0.0)
    assert np.array_equal(solution(at).v, solution.v[row + 1])
    before, after = solution(np.nextafter(at, 0.0)), solution(np.nextafter(at, 1.0))
    np.testing.assert_allclose(before.v, solution.v[row], atol=1e-13)
    np.testing.assert_allclose(after.v, solution.v[row + 1], atol=1e-13)
    asked = HHT(SYSTEMS["jax"], events=wall()).solve((0.0, 0.7), Q0, V0, step=0.01, t_eval=[0.5, at, 0.65])
    assert np.array_equal(asked.v[1], solution.v[row + 1])
    assert np.array_equal(asked.lam[1], solution.lam[row + 1])
    np.testing.assert_allclose(asked.q, solution([0.5, at, 0.65]).q, rtol=0, atol=0)


# What is not asked for


def test_without_events_nothing_is_looked_for_and_with_recorded_ones_no_step_changes(monkeypatch):
    for how in ({"step": 0.02}, {"rtol": 1e-4}):
        watched = HHT(SYSTEMS["jax"], events=[height, lambda t, q, v: v[1]]).solve((0.0, 0.7), Q0, V0, **how)
        assert watched.counters.event_evaluations > 0
        with monkeypatch.context() as patch:
            patch.setattr("solvers.hht.watch.scan", None)
            plain = HHT(SYSTEMS["jax"]).solve((0.0, 0.7), Q0, V0, **how)
        assert same_bits(watched, plain)
        assert plain.counters.event_evaluations == 0
        assert plain.t_events == plain.q_events == plain.v_events == ()
        assert watched.counters.residual_evaluations == plain.counters.residual_evaluations


def test_every_call_of_an_event_function_is_counted():
    calls = []
    solution = drift(Event(lambda t, q, v: calls.append(t) or q[0] - 0.35, terminal=True))
    assert solution.counters.event_evaluations == len(calls)


# Failures and wrong use


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("after", [-1.0, 0.5])
def test_a_value_that_is_not_finite_ends_the_run_and_names_the_event(value, after):
    bad = Event(lambda t, q, v: value if t > after else 1.0, name="sensor")
    solution = drift([height, bad])
    assert solution.status is Status.nonfinite_callback
    assert "'sensor'" in solution.message
    assert solution.t[-1] == max(0.0, after)
    assert [len(t) for t in solution.t_events] == [0, 0]


class Own(Exception):
    """An exception of the user's."""


@pytest.mark.parametrize("kind", [Own, KeyboardInterrupt, SystemExit, MemoryError])
@pytest.mark.parametrize("where", ["function", "change"])
def test_an_exception_of_an_event_reaches_the_caller_with_what_was_found(kind, where):
    error = kind()

    def fail(t, q, v):
        if t > 0.6:
            raise error
        return (q, v) if where == "change" else 1.0

    event = Event(fail) if where == "function" else clock(0.65, change=fail)
    with pytest.raises(kind) as caught:
        drift([lambda t, q, v: q[0] - 0.25, event])
    assert caught.value is error
    partial = error.partial_solution
    assert 0.5 <= partial.t[-1] < 0.7
    np.testing.assert_allclose(partial.t_events[0], [0.25], rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "status", "text"),
    [
        (lambda t, q, v: (q, np.array([np.nan, 0.0])), Status.nonfinite_callback, r"v from the change of event 'hit'\[0\]"),
        (lambda t, q, v: (0 * q, v), Status.inconsistent_initial, "after the change by event 'hit' at t = 0.25"),
    ],
)
def test_a_change_that_leads_nowhere_is_a_status_with_the_rows_before_it(change, status, text):
    solution = HHT(SYSTEMS["numpy"], events=clock(0.25, change=change, name="hit")).solve((0.0, 1.0), Q0, V0, step=0.1)
    assert solution.status is status, solution.message
    pytest.raises(AssertionError, match=text).__exit__(None, None, None) if False else None
    assert __import__("re").search(text, solution.message)
    assert solution.t[-1] == pytest.approx(0.25, abs=1e-15)


def never(*arguments):
    raise AssertionError("a callback was called")


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: Event(3.0), TypeError, "function must be callable"),
        (lambda: Event(never, change=(1, 2)), TypeError, "change must be callable"),
        (lambda: Event(never, direction=2), hb.ProblemError, "direction must be"),
        (lambda: Event(never, direction="up"), hb.ProblemError, "direction must be"),
        (lambda: Event(never, terminal=-1), hb.ProblemError, "terminal"),
        (lambda: Event(never, terminal=1.5), TypeError, "terminal"),
        (lambda: Event(never, samples=0), hb.ProblemError, "samples"),
        (lambda: Event(never, name=3), TypeError, "name"),
        (lambda: HHT(FREE, events=[never, 3.0]), TypeError, r"events\[1\]"),
        (lambda: HHT(FREE, events="height"), TypeError, "events"),
    ],
)
def test_wrong_use_is_refused_by_name_before_any_callback(make, error, text):
    with pytest.raises(error, match=text):
        make()


@pytest.mark.parametrize("value", [None, "x", True, 1j, [1.0], np.ones(1), np.ones(2)], ids=repr)
def test_an_event_function_must_return_one_number(value):
    with pytest.raises(TypeError, match="event 'sensor' must return one real number"):
        drift(Event(lambda t, q, v: value, name="sensor"))


@pytest.mark.parametrize("value", [None, 3.0, ([1.0],), ([1.0, 2.0], [1.0]), ([1.0], 2.0), ([1.0], ["x"])], ids=repr)
def test_a_change_must_return_two_vectors(value):
    with pytest.raises((TypeError, ValueError), match="the change of event 'hit'"):
        drift(clock(0.5, change=lambda t, q, v: value, name="hit"))


@pytest.mark.parametrize("value", [np.float32, np.float64, np.asarray, int], ids=lambda kind: kind.__name__)
def test_an_event_function_may_return_any_real_number(value):
    found = drift(Event(lambda t, q, v: value(np.sign(q[0] - 0.25)))).t_events[0]
    np.testing.assert_allclose(found, [0.25], rtol=1e-14)


def test_events_get_read_only_copies_that_stay_as_they_were():
    kept = []

    def keep(t, q, v):
        kept.append((q, v, q.copy(), v.copy()))
        return q[0] - 0.3

    HHT(SYSTEMS["numpy"], events=Event(keep, change=lambda t, q, v: (keep(t, q, v), (q, v))[1])).solve(
        (0.0, 1.0), Q0, V0, step=0.05
    )
    assert len(kept) > 100
    assert all(np.array_equal(q, q1) and np.array_equal(v, v1) for q, v, q1, v1 in kept)
    with pytest.raises(ValueError, match="read-only"):
        drift(lambda t, q, v: q.fill(0.0) or 1.0)


def test_scipy_s_attributes_of_a_plain_callable_are_read_and_nothing_is_written():
    def falls(t, q, v):
        return 0.4 - q[0]

    falls.terminal, falls.direction = True, -1.0
    before = dict(vars(falls))
    solution = drift([falls, height])
    assert solution.status is Status.event
    assert "'falls'" in solution.message
    assert vars(falls) == before
    falls.direction = 1.0
    assert drift(falls).status is Status.success


def test_one_event_in_two_solves_solvers_and_threads_keeps_no_common_record():
    event = Event(lambda t, q, v: q[0] - 0.3, terminal=2)

    def run(route):
        return HHT(SYSTEMS[route], events=event).solve((0.0, 1.5), Q0, V0, step=0.02)

    serial = {route: run(route) for route in SYSTEMS}
    with ThreadPoolExecutor(2) as pool:
        for _ in range(3):
            for route, again in zip(SYSTEMS, pool.map(run, SYSTEMS), strict=True):
                assert same_bits(again, serial[route])
                assert again.t_events[0].tobytes() == serial[route].t_events[0].tobytes()
                assert again.t_events[0].size == 2


def test_a_budget_that_is_spent_on_the_way_to_an_event_is_named():
    level = Event(lambda t, q, v: q[0] - 0.3, terminal=True)
    full = HHT(SYSTEMS["jax"], events=level).solve((0.0, 1.0), Q0, V0, step=0.02)
    most = full.counters.residual_evaluations - 2
    cut = HHT(SYSTEMS["jax"], events=level).solve((0.0, 1.0), Q0, V0, step=0.02, max_evaluations=most)
    assert cut.status is Status.evaluation_budget
    assert cut.t[-1] < full.t[-1]
    failed = HHT(pendulum(force=lambda t, q, v: np.full(2, np.nan)), events=level).solve((0.0, 1.0), Q0, V0, step=0.1)
    assert [t.size for t in failed.t_events] == [0]
