"""What events cost, what wrong use and failures say, and what stays the user's own (rows C11, E1, E2)."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import FREE, clock, drift, height
from tests.hht.scenes import Q0, SYSTEMS, V0, pendulum


def test_every_call_of_an_event_function_is_counted():
    calls = []
    solution = drift(Event(lambda t, q, v: calls.append(t) or q[0] - 0.35, terminal=True))
    assert solution.counters.event_evaluations == len(calls)


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
        (
            lambda t, q, v: (q, np.array([np.nan, 0.0])),
            Status.nonfinite_callback,
            "v from the change of event 'hit'[0] = nan at t = 0.25",
        ),
        (lambda t, q, v: (0 * q, v), Status.inconsistent_initial, "after the change by event 'hit' at t = 0.25"),
    ],
)
def test_a_change_that_leads_nowhere_is_a_status_with_the_rows_before_it(change, status, text):
    solution = HHT(SYSTEMS["numpy"], events=clock(0.25, change=change, name="hit")).solve((0.0, 1.0), Q0, V0, step=0.1)
    assert solution.status is status, solution.message
    assert text in solution.message
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


def test_a_budget_that_is_spent_on_the_way_to_an_event_is_named():
    level = Event(lambda t, q, v: q[0] - 0.3, terminal=True)
    full = HHT(SYSTEMS["jax"], events=level).solve((0.0, 1.0), Q0, V0, step=0.02)
    most = full.counters.residual_evaluations - 2
    cut = HHT(SYSTEMS["jax"], events=level).solve((0.0, 1.0), Q0, V0, step=0.02, max_evaluations=most)
    assert cut.status is Status.evaluation_budget
    assert cut.t[-1] < full.t[-1]
    failed = HHT(pendulum(force=lambda t, q, v: np.full(2, np.nan)), events=level).solve((0.0, 1.0), Q0, V0, step=0.1)
    assert [t.size for t in failed.t_events] == [0]
