"""Which events are found, where, and in what order (row E1 of the acceptance matrix)."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import AT_REST, FREE, HOW, clock, drift, height
from tests.hht.scenes import ALPHAS, GRAVITY, JAX_PENDULUM, Q0, SYSTEMS, V0, pendulum_at, same_bits


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
        assert repr(float(solution.t[-1])) in solution.message
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


@pytest.mark.parametrize("off", [-1e-16, 1e-16])
def test_a_start_that_misses_the_zero_by_roundoff_counts_as_on_it(off):
    ball = HHT(FREE, events=height).solve((0.0, 1.0), [off], [GRAVITY / 4], step=0.1)
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


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_zero_at_the_start_is_none_and_two_in_a_step_are_found_by_samples(how):
    """Of a tangent nothing is promised but that the run goes on."""
    at_start, tangent = Event(lambda t, q, v: q[0]), Event(lambda t, q, v: (q[0] - 0.5) ** 2)
    two = Event(lambda t, q, v: (q[0] - 0.3) * (q[0] - 0.304), samples=20)
    solution = drift([at_start, tangent, two], **how)
    assert solution.success and solution.t_events[0].size == 0
    np.testing.assert_allclose(solution.t_events[2], [0.3, 0.304], atol=1e-9)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_a_numbered_occurrence_is_terminal_and_every_solve_counts_anew(how):
    wave = Event(lambda t, q, v: np.sin(np.pi * (q[0] - 0.1)), terminal=3)
    solver = HHT(AT_REST, events=wave, max_step=0.5)  # nothing else limits the step where no force acts
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


def test_the_state_at_a_terminal_event_is_on_its_far_side_but_for_nothing_more_than_roundoff():
    """So a motion that goes on from there does not meet it again."""
    for level in np.linspace(0.1, 0.8, 15):
        falling = Event(lambda t, q, v, level=level: q[0] - level, direction=-1, terminal=True)
        solution = HHT(SYSTEMS["numpy"], events=falling).solve((0.0, 1.0), Q0, V0, step=0.05)
        assert -1e-15 < solution.q[-1, 0] - level <= 0.0


@pytest.mark.parametrize("linsolver", ["auto", "dense", "band", "sparse"])
@pytest.mark.parametrize("how", [{"step": 0.02}, {"rtol": 1e-3}], ids=str)
def test_trial_steps_for_an_event_of_the_interpolant_alone_leave_no_bit_behind(how, linsolver):
    """Dense output leaves the circle between steps, and no step's end does: the step stands, and so does its matrix."""
    plain = HHT(JAX_PENDULUM, linsolver=linsolver).solve((0.0, 2.0), Q0, V0, **how)
    off = np.sum(plain(np.linspace(0.0, 2.0, 2001)).q ** 2, axis=1) - 1.0
    level = 0.3 * off[np.argmax(np.abs(off))]
    circle = Event(lambda t, q, v: q @ q - 1.0 - level, terminal=True, samples=16)
    watched = HHT(JAX_PENDULUM, linsolver=linsolver, events=circle).solve((0.0, 2.0), Q0, V0, **how)
    assert watched.counters.residual_evaluations > plain.counters.residual_evaluations, "there were trials"
    assert watched.success and not watched.t_events[0].size
    assert same_bits(watched, plain)
