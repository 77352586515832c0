"""Options, tolerances, budgets, intervals and output times (rows O1 to O7, S1 to S9)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.subject import Declined
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import PENDULUM, Q0, V0, Rod, apart, ends, never, over, problem, refuses

UNCALLED = hb.NumpySystem(force=never, constraint=never)
STATUS = hb.Status
Bad = list[tuple[dict[str, Any], str]]


def _refused(asked: Asked, bad: Bad) -> Finding:
    """Every request refused by the name of its argument, before a function is called."""
    given = problem(UNCALLED, Q0, V0, (0.0, 1.0))
    return every({str(request): refuses(partial(asked.solve, given, **request), name) for request, name in bad})


@row("O1", "rtol or atol negative, NaN, inf, text, wrong length, both zero", "refused by name")
def bad_tolerances(asked: Asked) -> Finding:
    """HHT takes one number per component, the libraries one number alone: a vector is declined there, by name."""
    bad: Bad = [({"rtol": x}, "rtol") for x in (-1e-6, np.nan, np.inf, "tight", [[1e-6]], [1e-6, -1e-6])]
    bad += [({"rtol": 1e-6, "atol": x}, "atol") for x in (-1.0, np.nan, "x", [[1e-6]], [1e-6, np.nan])]
    bad += [({"rtol": 0.0, "atol": 0.0}, "rtol and atol")]
    if asked.is_hht:
        bad += [({"rtol": [1e-6] * 3}, "rtol"), ({"rtol": 1e-6, "atol": [1e-6] * 3}, "atol")]
    return _refused(asked, bad)


def _warned(call: Callable[[], Any]) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return "; ".join(str(x.message) for x in caught)


@row("O2", "rtol 1e-20", "raised to the floor, with a warning")
def tiny_rtol(asked: Asked) -> Finding:
    """The warning."""
    told = _warned(lambda: asked.solve(over(PENDULUM, 0.0, 1e-3), rtol=1e-20, atol=1e-3))
    return Finding(measured=told or "no warning", holds="below roundoff" in told)


@row("O3", "rtol 1e3", "a warning that it is larger than 0.1")
def large_rtol(asked: Asked) -> Finding:
    """The warning."""
    told = _warned(lambda: asked.solve(over(PENDULUM, 0.0, 0.1), rtol=1e3))
    return Finding(measured=told or "no warning", holds="larger than 0.1" in told)


@row("O4", "h, h_max negative, zero, NaN; h longer than the interval", "refused by name; taken as the interval")
def bad_steps(asked: Asked) -> Finding:
    """Options of HHT and fields of a request."""
    system = Rod()
    bad: list[tuple[dict[str, Any], str]] = [({"step": x}, "step") for x in (-0.1, 0.0, np.nan, np.inf, "0.1")]
    faults = {str(r): refuses(partial(asked.solve, problem(UNCALLED, Q0, V0), **r), name) for r, name in bad}
    if not asked.is_hht:
        return every(faults, "prescribed steps themselves are declined")
    for name in ("max_step", "first_step", "min_step"):
        for value in (-0.1, 0.0, np.nan):
            faults[f"{name}={value}"] = refuses(partial(asked.hht, system, **{name: value}), name)
    long = asked.hht(system).solve((0.0, 0.01), Q0, V0, step=5.0)
    one = asked.hht(system).solve((0.0, 0.01), Q0, V0, steps=1)
    return every(faults | {"longer": "" if np.array_equal(long.q, one.q) else "another result"})


@row("O5", "max_num_steps 0, 20, None", "0 refused; 20: max_steps with 20 steps of output; counts over the whole interval")
def budget_of_steps(asked: Asked) -> Finding:
    """With output at every step and at a few times."""
    given = problem(Rod(), Q0, V0, (0.0, 3.0))
    faults = {"0": refuses(lambda: asked.solve(given, rtol=1e-6, max_num_steps=0), "max_num_steps")}
    for way, request in asked.ways().items():
        cut = asked.solve(given, **request, max_num_steps=20)
        fault = ends(cut, STATUS.max_steps)
        faults[f"20 {way}"] = fault or ("" if cut.t.size == 21 else f"{cut.t.size} rows")
        few = asked.solve(given, **request, max_num_steps=20, t_eval=[0.0, 1e-3, 3.0])
        fault = ends(few, STATUS.max_steps)
        counted = few.counters.steps_accepted
        faults[f"20, few rows {way}"] = fault or ("" if counted == 20 else f"{counted} steps")
        faults[f"None {way}"] = ends(asked.solve(given, **request, max_num_steps=None), STATUS.success)
    return every(faults)


SLACK = 0.1  # s: a step, the rows, and waiting for the core


@row("O6", "max_seconds 0.2 on an endless problem, compiled and not yet", "deadline within 0.2 s and one step", long=True)
def deadline(asked: Asked) -> Finding:
    """A system of a class of its own, so that nothing is compiled the first time; the solver's modules are imported."""

    class Fresh(Rod):
        """The rod once more."""

    given = problem(Fresh(), Q0, V0, (0.0, 1e9))
    asked.solve(problem(Rod(), Q0, V0, (0.0, 0.1)), rtol=1e-3)
    taken, faults = [], {}
    for case in ("first solve", "second", "third"):
        began = time.perf_counter()
        found = asked.solve(given, rtol=1e-8, max_seconds=0.2)
        taken.append(time.perf_counter() - began)
        faults[case] = ends(found, STATUS.deadline)
        if case == "first solve":
            asked.solve(given, rtol=1e-8, max_num_steps=5)
    return every(faults, ", ".join(f"{x:.2f} s" for x in taken), in_time=max(taken) <= 0.2 + SLACK)


@row("O7", "an unknown option", "TypeError that names it")
def unknown_option(asked: Asked) -> Finding:
    """Of a solve and of a solver."""
    given = problem(UNCALLED, Q0, V0)
    return every(
        {
            "solve": refuses(lambda: asked.solve(given, stepp=0.1), "stepp"),
            "solver": refuses(lambda: asked.solver(alhpa=-0.1), "alhpa"),
        }
    )


@row("S1", "t1 == t0", "success, one row, no step")
def empty_interval(asked: Asked) -> Finding:
    """The row is the start."""
    faults = {}
    for way, request in asked.ways().items():
        found = asked.solve(problem(Rod(), Q0, V0, (0.5, 0.5)), **request)
        fault = ends(found, STATUS.success)
        good = np.array_equal(found.t, [0.5]) and np.array_equal(found.q, [Q0]) and not found.counters.steps_accepted
        faults[way] = fault or ("" if good else f"{found.t.size} rows, {found.counters.steps_accepted} steps")
    return every(faults)


@row("S2", "t1 < t0", "backward; forward and back returns within 100 tolerances")
def backward(asked: Asked) -> Finding:
    """At fixed steps the error of the way there stands for the tolerance."""
    worst = 0.0
    for request in asked.ways().values():
        there = asked.solve(problem(Rod(), Q0, V0, (0.0, 0.5)), **request)
        back = asked.solve(problem(Rod(), there.q[-1], there.v[-1], (0.5, 0.0)), **request)
        exact = asked.solve(problem(Rod(), Q0, V0, (0.0, 0.5)), **{**request, **_finer(request)})
        tolerance = request.get("rtol", max(apart(there, exact), 1e-12))
        if not back.success:
            return Finding(measured=ends(back, STATUS.success), holds=False)
        moved = max(np.abs(back.q[-1] - Q0).max(), np.abs(back.v[-1] - V0).max())
        worst = max(worst, float(moved) / tolerance)
    return bounded(worst, 100.0, "returned within so many tolerances:")


def _finer(request: dict[str, Any]) -> dict[str, Any]:
    return {"step": request["step"] / 10} if "step" in request else {"rtol": request["rtol"] / 100}


@row("S3", "t0 = 1e9, -1e9, interval of 1 s; h = 0.01, and rtol 1e-5 and 1e-7", "as at t0 = 0, within 1e-7")
def far_origins(asked: Asked) -> Finding:
    """Times are 1.2e-7 s apart there, and steps differ by it."""
    faults, worst, ways = {}, 0.0, dict(asked.ways())
    ways |= {f"{way} rtol=1e-07": {**x, "rtol": 1e-7} for way, x in asked.ways().items() if "rtol" in x}
    for way, request in ways.items():
        here = asked.solve(problem(Rod(), Q0, V0, (0.0, 1.0)), **request)
        for origin in (1e9, -1e9):
            there = asked.solve(problem(Rod(), Q0, V0, (origin, origin + 1.0)), **request)
            difference = apart(there, here)
            worst = max(worst, difference)
            fault = ends(there, STATUS.success)
            faults[f"{origin:g} {way}"] = fault or ("" if difference <= 1e-7 else f"off by {difference:.1e}")
    return every(faults, f"largest difference {worst:.1e}")


@row("S4", "t0 = 1e15, interval of 1 s; h below the spacing of times", "time_resolution; no step with t + h == t")
def beyond_the_resolution(asked: Asked) -> Finding:
    """Doubles are 1/8 s apart there."""
    faults = {}
    for way, request in asked.ways().items():
        found = asked.solve(problem(Rod(), Q0, V0, (1e15, 1e15 + 1.0)), **request)
        stands = found.t.size > 1 and not np.all(np.diff(found.t) > 0)
        faults[way] = ends(found, STATUS.time_resolution) or ("time stands still" if stands else "")
    return every(faults)


ULP = (1.0, float(np.nextafter(1.0, 2.0))), (1.0, float(np.nextafter(1.0, 0.0)))
SPANS = ((0.0, 5e-324), (0.0, 1e-300), (0.0, 1e-15), *ULP)


@row(
    "S5",
    "interval of 5e-324, 1e-300, 1e-15, one ulp",
    "success, final state within one ulp of the start; time_resolution where h^2 is no number",
)
def shortest_intervals(asked: Asked) -> Finding:
    """Beyond what 20 m/s^2 can do in the time."""
    faults, declined = dict[str, str](), dict[str, str]()
    for t0, t1 in SPANS:
        for way, request in asked.ways().items():
            case = f"{t0:g}..{t1:.17g} {way}"
            try:
                found = asked.solve(problem(Rod(), Q0, V0, (t0, t1)), **request)
            except Declined as reason:
                faults[case] = declined[case] = f"declined: {reason}"
                continue
            underflows = (t1 - t0) * (t1 - t0) == 0.0
            fault, moved = ends(found, STATUS.success, *[STATUS.time_resolution] * underflows), abs(t1 - t0) * 20
            if found.success:
                near = [
                    np.abs(x[-1] - x0) <= np.maximum(np.spacing(np.abs(x0)), moved)
                    for x, x0 in ((found.q, Q0), (found.v, V0))
                ]
                fault = "" if np.all(near) else "the state has moved"
            faults[case] = fault
    if len(declined) == len(faults):
        raise Declined(next(iter(declined.values())))
    return every(faults)


@row("S6", "interval of 1e300 s; infinite", "max_steps or deadline; inf refused")
def endless(asked: Asked) -> Finding:
    """With 20,000 steps or 2 s allowed."""
    faults = {"inf": refuses(lambda: asked.solve(problem(UNCALLED, Q0, V0, (0.0, np.inf)), rtol=1e-4), "t_span")}
    given = problem(Rod(), Q0, V0, (0.0, 1e300))
    for way, request in asked.ways().items():
        if "step" not in request:
            found = asked.solve(given, **request, max_num_steps=20_000, max_seconds=2.0)
            faults[f"1e300 {way}"] = ends(found, STATUS.max_steps, STATUS.deadline)
        else:
            faults[f"1e300 {way}"] = refuses(partial(asked.solve, given, **request), "step")
    return every(faults)


@row("S7", "NaN, text, one or three values as interval", "refused by name")
def bad_intervals(asked: Asked) -> Finding:
    """Of a problem, and of HHT's own solve."""
    spans: list[Any] = [(0.0, np.nan), ("0", "1"), "01", (0.0,), (0.0, 1.0, 2.0), 1.0, None, (0.0, [1.0, 2.0]), (0.0, 1j)]
    faults = {str(x): refuses(partial(problem, UNCALLED, Q0, V0, x), "t_span") for x in spans}
    if asked.is_hht:
        hht = asked.hht(UNCALLED)
        faults |= {f"solve {x}": refuses(partial(hht.solve, x, Q0, V0, step=0.1), "tspan") for x in spans}
    return every(faults)


@row("S8", "t_eval unsorted, outside, duplicate, NaN, empty", "refused by name; duplicates allowed")
def bad_output_times(asked: Asked) -> Finding:
    """A duplicate gives a row twice."""
    bad: list[Any] = [[0.5, 0.2], [0.5, 1.1], [-0.1, 0.5], [0.5, np.nan], [], 0.5, "all"]
    faults, uncalled = {}, problem(UNCALLED, Q0, V0, (0.0, 1.0))
    for way, request in asked.ways().items():
        for x in bad:
            faults[f"{x} {way}"] = refuses(partial(asked.solve, uncalled, **request, t_eval=x), "t_eval")
        twice = asked.solve(problem(Rod(), Q0, V0, (0.0, 1.0)), **request, t_eval=[0.0, 0.3, 0.3, 1.0])
        same = twice.t.size == 4 and np.array_equal(twice.q[1], twice.q[2])
        faults[f"duplicate {way}"] = ends(twice, STATUS.success) or ("" if same else "rows differ")
    return every(faults)


@row("S9", "last time and rows", "t[-1] == t1 exactly, one row per asked time, strictly monotone")
def last_time(asked: Asked) -> Finding:
    """Forward, backward, from odd starts."""
    faults = {}
    for t0, t1 in ((0.0, 1.0), (0.3, 1.7), (1.0, 0.1), (-1.0, 0.1)):
        for way, request in asked.ways().items():
            found = asked.solve(problem(Rod(), Q0, V0, (t0, t1)), **request)
            good = found.success and found.t[0] == t0 and found.t[-1] == t1 and np.all(np.diff(found.t) * (t1 - t0) > 0)
            asked_for = np.linspace(t0, t1, 7)
            rows = asked.solve(problem(Rod(), Q0, V0, (t0, t1)), **request, t_eval=asked_for)
            faults[f"{t0:g}..{t1:g} {way}"] = "" if good and np.array_equal(rows.t, asked_for) else "other times"
    return every(faults)
