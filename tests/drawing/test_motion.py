import math

import numpy as np
import pytest

from hhtbench import Status
from hhtbench.drawing.motion import find_course, telling_end
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion


def test_motion_on_a_circle_is_shown_once_round(rotor):
    course = find_course(rotor())
    assert course.source == "closed solution"
    assert course.t[-1] == pytest.approx(2 * math.pi, rel=0.05)


def test_seconds_are_shown_from_the_start_as_asked(rotor):
    assert find_course(rotor(), seconds=11.5).t[[0, -1]].tolist() == [0.0, 11.5]


@pytest.mark.parametrize("seconds", [0.0, -1.0, 20.5])
def test_seconds_outside_the_interval_are_refused(rotor, seconds):
    with pytest.raises(ProblemError, match=r"above 0 and at most 20.*t_end"):
        find_course(rotor(), seconds=seconds)


def test_swing_is_shown_to_its_other_side():
    t = np.linspace(0.0, 30.0, 600)
    angle = 1.2 * np.cos(np.pi * t)
    places = np.stack([np.sin(angle), -np.cos(angle)], axis=1)[:, None]
    assert telling_end(t, places) == pytest.approx(1.0, abs=0.06)


def test_motion_along_a_level_line_is_shown_there_and_back():
    t = np.linspace(0.0, 30.0, 600)
    places = np.stack([np.cos(np.pi * t), 0 * t], axis=1)[:, None]
    assert 1.9 < telling_end(t, places) < 2.6


def test_fast_shaking_on_the_way_does_not_shorten_what_is_shown():
    t = np.linspace(0.0, 3.0, 600)
    places = np.stack([t, 0.04 * np.sin(80 * t) + t**2 / 10], axis=1)[:, None]
    assert telling_end(t, places) == 3.0


def test_motion_that_comes_to_rest_is_shown_until_then():
    t = np.linspace(0.0, 1000.0, 600)
    places = np.stack([np.exp(-t / 20), t * 0], axis=1)[:, None]
    assert 40 < telling_end(t, places) < 120


def test_what_does_not_move_is_shown_over_its_whole_interval():
    assert telling_end(np.linspace(0.0, 7.0, 20), np.zeros((20, 2, 2))) == 7.0


def test_without_closed_solution_the_states_come_from_a_solver(rotor):
    course = find_course(rotor(exact=None), seconds=6.0)
    assert course.source.startswith("collocation(form=index1)")
    assert not course.stopped
    np.testing.assert_allclose(course.q[-1], [math.cos(6.0), math.sin(6.0)], atol=1e-5)


def test_named_solver_is_used_even_where_a_closed_solution_is_known(rotor):
    assert find_course(rotor(), "scipy(method=DOP853)", 6.0).source.startswith("scipy(method=DOP853)")


def test_states_stop_where_the_solver_stops_and_say_so(rotor, monkeypatch):
    _stop_solvers(monkeypatch, rows=200)
    course = find_course(rotor(exact=None), seconds=6.0)
    assert len(course.t) == 200
    assert f"stopped at t = {course.t[-1]:.4g} s: step_too_small" in course.stopped


def test_only_the_start_is_left_where_nothing_is_known(rotor, monkeypatch):
    _stop_solvers(monkeypatch, rows=0)
    course = find_course(rotor(exact=None))
    assert course.q.tolist() == [[1.0, 0.0]]
    assert "made no step: step_too_small; only the start is drawn" in course.stopped


def _stop_solvers(monkeypatch, rows):
    """Solvers that give the first ``rows`` output rows of the circle and stop."""
    from types import SimpleNamespace

    def stops(problem, solver, *, t_eval, **request):
        t = t_eval[:rows]
        q = np.stack([np.cos(t), np.sin(t)], axis=1)
        return SimpleNamespace(t=t, q=q, status=Status.step_too_small, success=False)

    monkeypatch.setattr("hhtbench.drawing.motion.solve", stops)


def test_backward_interval_is_drawn_backward(rotor):
    course = find_course(rotor(t_span=(0.0, -20.0), exact=lambda t: Motion([math.cos(t), math.sin(t)], [0, 0], [], [])))
    assert course.t[-1] == pytest.approx(-2 * math.pi, rel=0.05)
