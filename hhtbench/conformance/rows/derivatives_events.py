"""Rows J1 to J5, E1, E2: wrong derivatives, linear algebra, and events."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import tested
from hhtbench.conformance.rows.judging import Cases, apart, ends, refuses, row, within
from hhtbench.conformance.scenes.rod import (
    ALTOGETHER_WRONG,
    Q0,
    SLIGHTLY_WRONG,
    claiming,
    plane,
)
from hhtbench.conformance.subject import Declined, Subject


def _wrong(subject: Subject, changes: dict[str, Any], *others: hb.Status, least: float = 0.0) -> Cases:
    """Yield cases with changed force Jacobians against the right one.

    ``least``: smallest ratio of HHT's iterations to those with the right Jacobian, to show that it is used.
    """
    for way, request in subject.alphas({"step": 0.005}, {"rtol": 1e-6}).items():
        right = subject.ask(claiming(lambda x: x), (0.0, 0.1), **request)
        speed, allowed = np.abs(right.v).max(), 1e-9 if subject.is_hht else 1e-4
        for case, change in changes.items():
            found = subject.ask(claiming(change), (0.0, 0.1), **request)
            off = within(apart(found, right) / speed, allowed, "over the speed, off by")
            yield f"{case} {way}".strip(), off if found.success else ends(found, *others, words=("force_jac",))
            more = (found.counters.newton_iterations or 0) / max(right.counters.newton_iterations or 1, 1)
            if found.success and subject.is_hht:
                yield (
                    f"{case} {way}, iterations",
                    "" if more >= least else f"{more:.2g} times the iterations: it is not used",
                )


@row("J1", "declared force Jacobian wrong by 10 %, twice as large", "result, more iterations")
def slightly_wrong(subject: Subject) -> Cases:
    """Yield the cases of row J1: a declared force Jacobian wrong by 10 %, or twice as large, which HHT uses as declared."""
    return _wrong(subject, SLIGHTLY_WRONG, hb.Status.success, least=1.05)


CRAWLS = {"ida": (("1e6",), "a Jacobian that is wrong by 1e6: at 6.6e-4 to 1.1e-2 s after 20 s")}


@row("J2", "its sign, zero, transposed, 1e6 times", "result by differences, or newton_failed that names it", known=CRAWLS)
def altogether_wrong(subject: Subject) -> Cases:
    """Yield the cases of row J2: a declared force Jacobian with the wrong sign, zero, transposed, or 1e6 times too large."""
    return _wrong(subject, ALTOGETHER_WRONG, hb.Status.newton_failed)


@row("J3", "Jacobians NaN, of the wrong shape", "nonfinite_callback with the name; refused with the shapes")
def broken(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row J3: Jacobians of force and constraint that are NaN or of the wrong shape."""
    zeros, long = np.zeros((2, 2)), (np.zeros((2, 3)), np.zeros((3, 2)))
    for name, nan, wrong in (
        ("force_jacobians", (zeros * np.nan,) * 2, long),
        ("constraint_jacobian", Q0[None, :] * np.nan, long[1]),
    ):
        found = subject.ask(plane(**{name: lambda *x, nan=nan: nan}), **request)
        yield f"{name} NaN", ends(found, hb.Status.nonfinite_callback, words=(name,))
        yield f"{name} shape", refuses(partial(subject.ask, plane(**{name: lambda *x, wrong=wrong: wrong}), **request), name)


J4 = tested(
    "J4",
    "hhtbench check on the faults of J1 to J3",
    "each named, with its worst entry",
    "tests/check/test_check_derivatives.py",
)


J5 = tested(
    "J5",
    "dense, banded, sparse linear algebra",
    "equal to 1e-11",
    "tests/hht/test_linear.py::test_every_kind_of_linear_algebra_gives_the_same_steps",
)
EVENTS, FAILURES = (f"tests/hht/test_{name}.py::test_" for name in ("events", "event_failures"))
E1 = tested(
    "E1",
    "zero at t0; at t1; two in a step; tangent; NaN; raising; jump",
    "none; one; both; any; named; raised; to 1e-9",
    f"{EVENTS}a_zero_at_the_start_is_none_and_two_in_a_step_are_found_by_samples",
    f"{EVENTS}a_zero_exactly_at_the_end_is_one_event",
    f"{EVENTS}a_function_that_jumps_is_located_to_roundoff",
    f"{FAILURES}a_value_that_is_not_finite_ends_the_run_and_names_the_event",
    f"{FAILURES}an_exception_of_an_event_reaches_the_caller_with_what_was_found",
)
FREE = hb.NumpySystem(force=lambda t, q, v: np.zeros(1))  # with v = 1 the coordinate is the time


def _with(subject: Subject, event: hb.Event, **request: Any) -> hb.Solution:
    if not subject.is_hht:
        raise Declined("the adapters have no events")
    return subject.ask(FREE, (0.0, 1.0), q0=[0.0], v0=[1.0], events=event, **request)


@row("E2", "one event function in two solves, two solvers, two threads", "no shared record: times equal")
def shared_event(subject: Subject) -> Cases:
    """Yield the cases of row E2: one event function used in two threads at once, in ten rounds."""
    event = hb.Event(lambda t, q, v: q[0] - 0.37)
    alone = _with(subject, event, rtol=1e-4).t_events[0].tolist()
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda _: _with(subject, event, rtol=1e-4).t_events[0].tolist(), range(20)))
    yield "alone", "" if len(alone) == 1 else f"{len(alone)} events"
    yield "in two threads", within(sum(times != alone for times in found), 0, "others of 20:")
