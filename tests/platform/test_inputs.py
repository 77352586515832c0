"""Rows of the matrix of hostile input that the problem and the request answer by themselves."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.request import RTOL_FLOOR, check_output_times, make_request, plan_steps

SYSTEM = NumpySystem(force=lambda t, q, v: -q)


def _problem(**changes):
    return Problem(**{"name": "p", "system": SYSTEM, "t_span": (0.0, 1.0), "q0": [1.0, 2.0], "v0": [0.0, 0.0], **changes})


HOSTILE = [
    [np.nan, 1.0],
    [np.inf, 1.0],
    None,
    "ab",
    ["a", "b"],
    [1j, 0.0],
    np.ma.array([1.0, 2.0], mask=[True, False]),
    np.array([object(), 1.0], dtype=object),
    [[1.0], [1.0, 2.0]],
    [True, False],
]


@pytest.mark.parametrize("name", ["q0", "v0"])
@pytest.mark.parametrize("value", HOSTILE, ids=lambda value: "object" if "object at" in repr(value) else repr(value))
def test_start_that_is_not_finite_real_numbers_is_refused_by_name(name, value):  # I4
    with pytest.raises((ProblemError, TypeError), match=name):
        _problem(**{name: value})


@pytest.mark.parametrize(
    "value",
    [
        np.array([1, 2]),
        [1, 2],
        (1.0, 2.0),
        np.array([1, 2], dtype=np.float32),
        np.asfortranarray([[1.0, 2.0], [3.0, 4.0]])[0],
        np.arange(4.0)[1:3],
        np.array([1.0, 9.0, 2.0])[::2],
    ],
    ids=lambda value: f"{type(value).__name__}",
)
def test_every_kind_of_real_vector_gives_the_same_private_copy(value):  # I5
    before = np.array(value)
    problem = _problem(q0=value)
    assert problem.q0.dtype == np.float64
    assert problem.q0.flags.c_contiguous
    assert problem.q0.tolist() == [1.0, 2.0]
    assert not np.shares_memory(problem.q0, np.asarray(value))
    assert np.array_equal(np.array(value), before)


def test_start_is_a_read_only_copy():  # I5
    mine = np.array([1.0, 2.0])
    mine.setflags(write=False)
    problem = _problem(q0=mine)
    assert problem.q0 is not mine
    with pytest.raises(ValueError, match="read-only"):
        problem.q0[0] = 5.0


@pytest.mark.parametrize(
    ("v0", "shape"),
    [([[0.0, 0.0]], r"\(1, 2\)"), ([[0.0], [0.0]], r"\(2, 1\)"), ([0.0] * 3, r"\(3,\)"), ([0.0], r"\(1,\)"), (0.0, r"\(\)")],
)
def test_start_of_the_wrong_shape_is_refused_with_both_shapes(v0, shape):  # I6
    with pytest.raises(ProblemError, match=rf"v0 must have shape \(2,\); got {shape}"):
        _problem(v0=v0)


@pytest.mark.parametrize("q0", [[[1.0, 2.0]], 1.0, []])
def test_coordinates_that_are_no_vector_are_refused(q0):  # I6
    with pytest.raises(ProblemError, match="q0 must"):
        _problem(q0=q0)


@pytest.mark.parametrize("name", ["rtol", "atol"])
@pytest.mark.parametrize("value", [-1e-6, np.nan, np.inf, "1e-6", [1e-6, -1e-6], [[1e-6, 1e-6]], 1j])
def test_tolerance_that_is_none_is_refused_by_name(name, value):  # O1
    with pytest.raises((ProblemError, TypeError), match=name):
        make_request(**{name: value})


def test_tolerances_must_not_both_be_zero():  # O1
    with pytest.raises(ProblemError, match="rtol and atol must not both be zero"):
        make_request(rtol=0.0, atol=0.0)


def test_rtol_below_roundoff_is_raised_to_the_floor_with_a_warning():  # O2
    with pytest.warns(UserWarning, match="below roundoff"):
        assert make_request(rtol=1e-20).rtol == RTOL_FLOOR


def test_rtol_above_a_tenth_is_warned_about_and_an_ordinary_one_is_not():  # O3
    with pytest.warns(UserWarning, match=r"larger than 0\.1"):
        make_request(rtol=1e3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_request(rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["step", "max_seconds"])
@pytest.mark.parametrize("value", [-0.1, 0.0, np.nan, np.inf, "0.1", True, [0.1, 0.1]])
def test_step_and_deadline_must_be_positive_numbers(name, value):  # O4, O6
    with pytest.raises((ProblemError, TypeError), match=name):
        make_request(**{name: value})


def test_step_longer_than_the_span_is_taken_as_the_span():  # O4
    plan = plan_steps(make_request(step=5.0), 0.0, 1.0)
    assert (plan.count, plan.length(0), plan.end(0)) == (1, 1.0, 1.0)


@pytest.mark.parametrize("name", ["max_num_steps", "max_evaluations", "steps"])
@pytest.mark.parametrize("value", [0, -1, 2.5, "3", True])
def test_budget_must_be_a_whole_number_of_at_least_one(name, value):  # O5
    with pytest.raises((ProblemError, TypeError), match=f"{name} must be"):
        make_request(**{name: value})


def test_budget_may_be_left_open():  # O5
    assert make_request(max_num_steps=None).max_num_steps is None
    assert make_request(max_num_steps=np.int64(20)).max_num_steps == 20


def test_unknown_option_is_a_type_error():  # O7
    with pytest.raises(TypeError, match="unknown request option tolerance; known: rtol"):
        make_request(tolerance=1e-3)


@pytest.mark.parametrize("two", [{"step": 0.1, "steps": 3}, {"step": 0.1, "rtol": 1e-3}, {"steps": 3, "atol": 1e-3}])
def test_steps_and_tolerances_exclude_one_another(two):
    with pytest.raises(ProblemError, match="exclude one another"):
        make_request(**two)


@pytest.mark.parametrize("span", [(0.0, np.nan), (0.0, np.inf), ("a", "b"), (1.0,), (0.0, 1.0, 2.0), "01", None, 1.0])
def test_interval_must_be_two_finite_times(span):  # S7
    with pytest.raises((ProblemError, TypeError), match="t_span"):
        _problem(t_span=span)


@pytest.mark.parametrize("value", [[0.0, np.nan], [], "ab", [[0.0, 1.0]], 0.5])
def test_output_times_must_be_a_vector_of_finite_times(value):  # S8
    with pytest.raises((ProblemError, TypeError), match="t_eval"):
        make_request(t_eval=value)


def test_output_times_must_run_along_the_interval_and_may_repeat():  # S8
    check_output_times(np.array([0.0, 0.5, 0.5, 1.0]), 0.0, 1.0)
    check_output_times(np.array([1.0, 0.5, 0.5, 0.0]), 1.0, 0.0)
    for wrong in ([0.5, 0.2], [-0.1, 0.5], [0.5, 1.1]):
        with pytest.raises(ProblemError, match="t_eval must"):
            check_output_times(np.array(wrong), 0.0, 1.0)


def test_a_parameter_may_default_to_an_array_or_a_list():
    class Springs(System):
        k: object = parameter(np.array([1.0, 2.0]))
        d: object = parameter([0.5, 0.25])

        def force(self, t, q, v):
            return -self.k * q - self.d * v

    assert np.asarray(Springs().force(0.0, np.ones(2), np.ones(2))).tolist() == [-1.5, -2.25]
    assert Springs(k=3).k.dtype == np.float64
