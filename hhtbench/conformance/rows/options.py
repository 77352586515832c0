"""Rows O1 to O7, S1 to S9: options, tolerances, budgets, intervals and output times."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane
from hhtbench.conformance.rows.judging import Cases, apart, arrives, ends, refuses, row, warns, within
from hhtbench.conformance.scenes.rod import Q0, UNCALLED, V0, Rod, problem
from hhtbench.conformance.subject import Declined, Subject
from hhtbench.protocol.printing import exact

STATUS = hb.Status
BAD_TOLERANCES: list[tuple[dict[str, Any], str]] = [
    *(({"rtol": x}, "rtol") for x in (-1e-6, np.nan, np.inf, "tight", [[1e-6]], [1e-6, -1e-6])),
    *(({"rtol": 1e-6, "atol": x}, "atol") for x in (-1.0, np.nan, "x", [[1e-6]], [1e-6, np.nan])),
    ({"rtol": 0.0, "atol": 0.0}, "rtol and atol"),
]
TOO_LONG: list[tuple[dict[str, Any], str]] = [({"rtol": [1e-6] * 3}, "rtol"), ({"rtol": 1e-6, "atol": [1e-6] * 3}, "atol")]


@row("O1", "rtol or atol negative, NaN, inf, text, wrong length, both zero", "refused by name")
def bad_tolerances(subject: Subject) -> Cases:
    """Yield the cases of row O1: rtol or atol negative, NaN, inf, text, wrong length, both zero.

    HHT takes one number per component, the libraries one number alone: a vector is declined there, by name.
    """
    for request, name in BAD_TOLERANCES + TOO_LONG * subject.is_hht:
        yield str(request), refuses(partial(subject.ask, UNCALLED, (0.0, 1.0), **request), name)


@row("O2", "rtol 1e-20", "raised to the floor, with a warning")
def tiny_rtol(subject: Subject) -> Cases:
    """Yield the case of row O2: rtol = 1e-20 over a millisecond."""
    yield "", warns(lambda: subject.ask(Rod(), (0.0, 1e-3), rtol=1e-20, atol=1e-3), "below roundoff")


@row("O3", "rtol 1e3", "a warning that it is larger than 0.1")
def large_rtol(subject: Subject) -> Cases:
    """Yield the case of row O3: rtol = 1e3 over a tenth of a second."""
    yield "", warns(lambda: subject.ask(Rod(), (0.0, 0.1), rtol=1e3), "larger than 0.1")


@row("O4", "h, h_max negative, zero, NaN; h longer than the interval", "refused by name; taken as the interval")
def bad_steps(subject: Subject) -> Cases:
    """Yield the cases of row O4: invalid steps as options of HHT and fields of a request."""
    for x in (-0.1, 0.0, np.nan, np.inf, "0.1"):
        yield f"step={x}", refuses(partial(subject.ask, UNCALLED, step=x), "step")
    if not subject.is_hht:
        return
    for name in ("max_step", "first_step", "min_step"):
        for value in (-0.1, 0.0, np.nan):
            yield f"{name}={value}", refuses(partial(subject.hht, Rod(), **{name: value}), name)
    long, one = (subject.hht(Rod()).solve((0.0, 0.01), Q0, V0, **x) for x in ({"step": 5.0}, {"steps": 1}))
    yield "longer", "" if np.array_equal(long.q, one.q) else "another result"


@row("O5", "max_num_steps 0, 20, None; few evaluations, no time", "0 refused; the status; 20 steps in the interval")
def budgets(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row O5: budgets of steps, evaluations and time, with output at every step and at few times."""
    given = problem(Rod(), (0.0, 3.0))
    yield "0", refuses(lambda: subject.ask(given, rtol=1e-6, max_num_steps=0), "max_num_steps")
    cut = subject.ask(given, **request, max_num_steps=20)
    rows = "" if cut.t.size == 21 else f"{cut.t.size} rows"
    yield "20", ends(cut, STATUS.max_steps, words=("20 steps",)) or rows
    few = subject.ask(given, **request, max_num_steps=20, t_eval=[0.0, 1e-3, 3.0])
    counted = few.counters.steps_accepted
    yield "20, few rows", ends(few, STATUS.max_steps) or ("" if counted == 20 else f"{counted} steps")
    yield "None", arrives(subject.ask(given, **request, max_num_steps=None))
    evaluations = subject.ask(given, **request, max_evaluations=9)
    yield "evaluations", ends(evaluations, STATUS.evaluation_budget, words=("9 evaluations",))
    yield "seconds", ends(subject.ask(given, **request, max_seconds=1e-9), STATUS.deadline, words=("seconds",))


BUDGET, LATEST = 0.2, 0.3  # [s]: for a step, the rows, and waiting for the core


@row("O6", "max_seconds 0.2, compiled and not yet", "deadline within 0.2 s and one step", seconds=LATEST, lane=Lane.slow)
def deadline(subject: Subject) -> Cases:
    """Yield the cases of row O6: max_seconds 0.2, compiled and not yet.

    A system of a class of its own, so that nothing is compiled the first time; the solver's modules are imported.
    """

    class Fresh(Rod):
        """The rod once more."""

    given = problem(Fresh(), (0.0, 1e9))
    subject.ask(Rod(), (0.0, 0.1), rtol=1e-3)
    subject.took.clear()
    yield "first solve", ends(subject.ask(given, rtol=1e-8, max_seconds=BUDGET), STATUS.deadline)
    subject.ask(given, rtol=1e-8, max_num_steps=5)
    subject.took.pop()
    for case in ("second", "third"):
        yield case, ends(subject.ask(given, rtol=1e-8, max_seconds=BUDGET), STATUS.deadline)


@row("O7", "an unknown option", "TypeError that names it")
def unknown_option(subject: Subject) -> Cases:
    """Yield the cases of row O7: an unknown option of a solve and of a solver."""
    yield "solve", refuses(lambda: subject.ask(UNCALLED, stepp=0.1), "stepp")
    yield "solver", refuses(lambda: subject.fresh(alhpa=-0.1), "alhpa")


@row("S1", "t1 == t0", "success, one row, no step")
def empty_interval(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the case of row S1: t1 == t0, whose only row is the start."""
    found = subject.ask(Rod(), (0.5, 0.5), **request)
    good = np.array_equal(found.t, [0.5]) and np.array_equal(found.q, [Q0]) and not found.counters.steps_accepted
    yield "", arrives(found) or ("" if good else f"{found.t.size} rows, {found.counters.steps_accepted} steps")


@row("S2", "t1 < t0", "backward; forward and back returns within 100 tolerances")
def backward(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S2: t1 < t0.

    At fixed steps the error of the way there stands for the tolerance.
    """
    finer = {"step": request["step"] / 10} if "step" in request else {"rtol": request["rtol"] / 100}
    there, exact = (subject.ask(Rod(), (0.0, 0.5), **{**request, **x}) for x in ({}, finer))
    back = subject.ask(Rod(), (0.5, 0.0), q0=there.q[-1], v0=there.v[-1], **request)
    tolerance = request.get("rtol", max(apart(there, exact), 1e-12))
    moved = max(np.abs(back.q[-1] - Q0).max(), np.abs(back.v[-1] - V0).max())
    yield "", arrives(back) or within(moved / tolerance, 100, "distance over the tolerance:")


@row("S3", "t0 = 1e9, -1e9, interval of 1 s; h = 0.01, and rtol 1e-5 and 1e-7", "as at t0 = 0, within 1e-7")
def far_origins(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S3: t0 = 1e9, -1e9, interval of 1 s; h = 0.01, and rtol 1e-5 and 1e-7.

    Times are 1.2e-7 s apart there, and steps differ by it.
    """
    for more in ({}, {"rtol": 1e-7}) if "rtol" in request else ({},):
        here = subject.ask(Rod(), (0.0, 1.0), **{**request, **more})
        for origin in (1e9, -1e9):
            there = subject.ask(Rod(), (origin, origin + 1.0), **{**request, **more})
            yield f"{origin:g} {'rtol=1e-07' if more else ''}", arrives(there) or within(apart(there, here), 1e-7)


@row("S4", "t0 = 1e15, interval of 1 s; h below the spacing of times", "time_resolution; no step with t + h == t")
def beyond_the_resolution(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S4: t0 = 1e15, interval of 1 s; h below the spacing of times.

    Doubles are 1/8 s apart there.
    """
    found = subject.ask(Rod(), (1e15, 1e15 + 1.0), **request)
    fault = ends(found, STATUS.time_resolution, words=("1000000000000000",))
    yield "", fault or ("" if np.all(np.diff(found.t) > 0) else "time stands still")


SPANS = ((0.0, 5e-324), (0.0, 1e-300), (0.0, 1e-15), (1.0, np.nextafter(1.0, 2.0)), (1.0, np.nextafter(1.0, 0.0)))
TINY = ("0..5e-324", "0..1e-300", "1..1.0000000000000002", "1..0.9999999999999999")


@row(
    "S5",
    "interval of 5e-324, 1e-300, 1e-15, one ulp",
    "success, final state within one ulp of the start; time_resolution where h^2 is no number",
    known={"ida": (TINY, "IDA declines an interval whose end it takes for its start")},
)
def shortest_intervals(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S5: interval of 5e-324, 1e-300, 1e-15, one ulp.

    Beyond what 20 m/s^2 can do in the time.
    """
    for t0, t1 in SPANS:
        case, length = f"{t0:g}..{exact(t1)}", abs(t1 - t0)
        try:
            found = subject.ask(Rod(), (t0, t1), **request)
        except Declined as reason:
            yield case, reason
            continue
        allowed = (np.maximum(np.spacing(np.abs(x0)), 20 * length) for x0 in (Q0, V0))
        moves = (np.abs(x - x0) for x, x0 in ((found.q[-1], Q0), (found.v[-1], V0)))
        near = all(np.all(move <= most) for move, most in zip(moves, allowed, strict=True))
        fault = ends(found, STATUS.success, *[STATUS.time_resolution] * int(length * length == 0.0))
        yield case, fault or ("" if near or not found.success else "the state has moved")


@row("S6", "interval of 1e300 s; infinite", "max_steps or deadline; inf refused")
def endless(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S6: interval of 1e300 s; infinite.

    With 20,000 steps or 2 s allowed.
    """
    yield "inf", refuses(lambda: subject.ask(UNCALLED, (0.0, np.inf), rtol=1e-4), "t_span")
    call = partial(subject.ask, Rod(), (0.0, 1e300), **request, max_num_steps=20_000, max_seconds=2.0)
    yield "1e300", refuses(call, "step") if "step" in request else ends(call(), STATUS.max_steps, STATUS.deadline)


@row("S7", "NaN, text, one or three values as interval", "refused by name")
def bad_intervals(subject: Subject) -> Cases:
    """Yield the cases of row S7: invalid intervals of a problem and of HHT's own solve."""
    spans: list[Any] = [(0.0, np.nan), ("0", "1"), "01", (0.0,), (0.0, 1.0, 2.0), 1.0, None, (0.0, [1.0, 2.0]), (0.0, 1j)]
    for x in spans:
        yield str(x), refuses(partial(problem, UNCALLED, x), "t_span")
        if subject.is_hht:
            yield f"solve {x}", refuses(partial(subject.hht(UNCALLED).solve, x, Q0, V0, step=0.1), "tspan")


@row("S8", "t_eval unsorted, outside, duplicate, NaN, empty", "refused by name; duplicates allowed")
def bad_output_times(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S8: invalid output times; a duplicate gives a row twice."""
    bad: list[Any] = [[0.5, 0.2], [0.5, 1.1], [-0.1, 0.5], [0.5, np.nan], [], 0.5, "all"]
    for x in bad:
        yield str(x), refuses(partial(subject.ask, UNCALLED, (0.0, 1.0), **request, t_eval=x), "t_eval")
    twice = subject.ask(Rod(), (0.0, 1.0), **request, t_eval=[0.0, 0.3, 0.3, 1.0])
    equal = twice.t.size == 4 and np.array_equal(twice.q[1], twice.q[2])
    yield "duplicate", arrives(twice) or ("" if equal else "rows differ")


@row("S9", "last time and rows", "t[-1] == t1 exactly, one row per asked time, strictly monotone")
def last_time(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row S9: last time and rows of runs forward, backward, and from odd starts."""
    for t0, t1 in ((0.0, 1.0), (0.3, 1.7), (1.0, 0.1), (-1.0, 0.1)):
        times = np.linspace(t0, t1, 7)
        found, rows = (subject.ask(Rod(), (t0, t1), **request, t_eval=x) for x in (None, times))
        good = found.success and found.t[0] == t0 and found.t[-1] == t1 and np.all(np.diff(found.t) * (t1 - t0) > 0)
        yield f"{t0:g}..{t1:g}", "" if good and np.array_equal(rows.t, times) else "other times"
