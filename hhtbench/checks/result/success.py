"""Check a reported success: types, shapes, times, finiteness, start, work, constraints, rows that do not move.

Each check returns "" or the objection, beginning with the name of the check.  None integrates:
together they take some microseconds, and :func:`check_success` applies them to every success that ``hb.solve`` returns.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields, replace
from typing import Any

import numpy as np

from hhtbench.checks.phases import phases_of
from hhtbench.checks.result.levels import Rows, sizes_of, violated
from hhtbench.lowering import CONSISTENT, ConstraintLevels, derive
from hhtbench.protocol.arguments import Vector, all_finite
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Clock
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Ends, Solution, Status

SAME_TIME = 1e-9  # largest distance of a row from its output time, over the interval
SAME_START = 1e-6  # largest distance of the first row from the start, over the size (or twice the relative tolerance)
REPORTED = 0.9  # smallest number of step ends over the counted steps
COUNTED = tuple(field.name for field in fields(Counters) if field.name != "provenance")
EMPTY = np.zeros(0)
MOVED = 0.1  # first-order motion over the interval, in typical sizes, above which rows must not stand still


def check_success(problem: Problem, request: Request, solution: Any, clock: Clock | None = None) -> str:
    """Return why a returned success cannot be one; "" if there is no objection, or if it is no success.

    Functions of a NumPy system are called at few rows, and no more once the time of ``clock`` is over.
    """
    doubt = doubt_about(problem, request, solution)
    if doubt or not solution.success:
        return doubt
    if solution.phases:
        doubts = (_doubt_in_phase(*one, request, clock) for one in phases_of(problem, solution))
        return next(filter(None, doubts), "")
    return _doubt_in_phase(problem, solution, request, clock)


def _doubt_in_phase(problem: Problem, solution: Solution, request: Request, clock: Clock | None) -> str:
    """The checks that need the system of a motion."""
    doubt = wrong_columns(problem, solution) or _moved_start(problem, request, solution)
    if not doubt and not (all_finite(solution.lam) and all_finite(solution.mu)):
        from hhtbench.checks.result.unknown import unknown_without_reason  # few results have unknown multipliers

        doubt = unknown_without_reason(problem, solution, clock)
    doubt = doubt or violated(problem, request, (solution.t, solution.q, solution.v), clock=clock)
    return doubt or (_rests(problem, solution) if solution.q[0].tobytes() == solution.q[-1].tobytes() else "")


def wrong_columns(problem: Problem, solution: Solution) -> str:
    """Name the multipliers that do not have one column per constraint; "" if all have."""
    structure = derive(problem.system, problem.t_span[0], problem.q0, problem.v0).structure
    for name, wanted in (("lam", structure.m), ("mu", structure.p)):
        found = getattr(solution, name).shape[1]
        if found != wanted:
            return f"shapes: {name} has {found} columns; the system has {wanted} such constraints."
    return ""


def _moved_start(problem: Problem, request: Request, solution: Solution) -> str:
    """State that a consistent start was moved although ``calc_initcond`` must leave it; "" if it was not."""
    place = problem.t_span[0], problem.q0, problem.v0
    if not request.calc_initcond:
        return ""
    levels = ConstraintLevels(derive(problem.system, *place)).at(*place)
    if not levels.hold(problem.q0, problem.v0, CONSISTENT):
        return ""
    return _start(problem, replace(request, calc_initcond=False), (solution.t, solution.q, solution.v))


def doubt_about(problem: Problem, request: Request, solution: Any) -> str:
    """Return why a returned success cannot be one, from the result alone; "" if there is no objection or no success."""
    if not isinstance(solution, Solution) or not isinstance(solution.status, Status):
        return f"type: a Solution with a Status was expected; the solver returned {type(solution).__name__}."
    if not solution.success:
        return ""
    complete, motion = solution.status is Status.success, (solution.t, solution.q, solution.v)
    return (
        _shapes(problem, solution)
        or _finite(solution)
        or _order(problem, solution.t)
        or (_end(problem, request, solution.t) if complete else "")
        or _output_times(problem, request, solution.t, complete)
        or _start(problem, request, motion)
        or ("" if complete else _event(problem, request, solution))
        or _counters(request, solution)
        or ("" if solution.ends is None else _ends(problem, request, solution))
    )


def too_few(ends: Ends, counters: Counters) -> bool:
    """True if ``ends`` cannot be all ends of the counted steps; far from t = 0, times may be rounded to one."""
    gap = float(np.abs(np.diff(ends.t)).min(initial=np.inf))
    return ends.t.size < REPORTED * (counters.steps_accepted or 0) and gap > 4 * np.spacing(np.abs(ends.t).max())


def _ends(problem: Problem, request: Request, solution: Solution) -> str:
    ends = solution.ends
    if not isinstance(ends, Ends):
        return f"type: ends must be an Ends; it is {type(ends).__name__}."
    n, k = problem.q0.size, len(ends.t) if isinstance(ends.t, np.ndarray) else 0
    shapes = {"ends.t": (ends.t, (k,)), "ends.q": (ends.q, (k, n)), "ends.v": (ends.v, (k, n))}
    for name, (value, wanted) in shapes.items():
        if not (k and isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.shape == wanted):
            return f"shapes: {name} must be an array of float64, {wanted}, with a row for every end of a step."
    found = _finite(ends) or _order(problem, ends.t)
    last, (t0, t1) = solution.t[-1], problem.t_span
    if not found and (last - ends.t[-1]) * np.sign(t1 - t0) > SAME_TIME * _span(problem):
        return f"ends of steps: the last is at t = {exact(ends.t[-1])}, and the last row at t = {exact(last)}."
    if not found and (ends.t[-1] - t1) * np.sign(t1 - t0) > SAME_TIME * _span(problem):
        return f"ends of steps: the last is at t = {exact(ends.t[-1])}, and the interval ends at t = {exact(t1)}."
    if not found and too_few(ends, solution.counters):
        return f"ends of steps: {k} are reported, and {solution.counters.steps_accepted} steps were accepted."
    return found or _start(problem, request, (ends.t, ends.q, ends.v))


def _shapes(problem: Problem, solution: Solution) -> str:
    for name in ("t", "q", "v", "lam", "mu"):
        value = getattr(solution, name)
        if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
            kind = f"{type(value).__name__} of {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
            return f"shapes: {name} must be an array of float64; it is {kind}."
    if solution.t.ndim != 1:
        return f"shapes: t must be (rows,); it is {solution.t.shape}."
    rows, n = solution.t.size, problem.q0.size
    for name, value in (("q", solution.q), ("v", solution.v)):
        if value.shape != (rows, n):
            return f"shapes: {name} must be {(rows, n)}, rows and coordinates; it is {value.shape}."
    for name, value in (("lam", solution.lam), ("mu", solution.mu)):
        if value.ndim != 2 or len(value) != rows:
            return f"shapes: {name} must have {rows} rows, one for each time; it is {value.shape}."
    return ""


def _finite(rows: Solution | Ends) -> str:
    """Name the first of t, q, v that is not finite, or multiplier that is infinite (a Solution's may be NaN); "" if none."""
    for name in ("t", "q", "v", "lam", "mu"):
        value = getattr(rows, name, EMPTY)
        if all_finite(value):
            continue
        good = np.isfinite(value) | (np.isnan(value) if name in ("lam", "mu") else False)
        if not good.all():
            row = int(np.argmin(good.reshape(len(value), -1).all(axis=1)))
            return f"finiteness: {name} is not finite in row {row} of {len(value)}."
    return ""


def _order(problem: Problem, t: Vector) -> str:
    first, last = problem.t_span
    back = t[1:] < t[:-1] if last > first else t[1:] > t[:-1]
    if not np.count_nonzero(back):  # in a fifth of the time of any()
        return ""
    i = int(np.argmax(back))
    return f"order of times: after t = {exact(t[i])} comes t = {exact(t[i + 1])}."


def _end(problem: Problem, request: Request, t: Vector) -> str:
    if not t.size:
        return "end: success was reported, but there are no rows."
    end = problem.t_span[1]
    last = end if request.t_eval is None else float(request.t_eval[-1])
    if t[-1] == last:
        return ""
    what = "the interval ends" if last == end else "the last row was asked for"
    return f"end: success was reported, but the last time is {exact(t[-1])} and {what} at {exact(last)}."


def _output_times(problem: Problem, request: Request, t: Vector, complete: bool) -> str:
    asked = request.t_eval
    if asked is None:
        return ""
    if complete and t.size != asked.size:
        return f"output times: {t.size} of {asked.size} rows were given."
    count = min(t.size if complete else t.size - 1, asked.size)  # the last row may be that of an event
    if t[:count].tobytes() == asked[:count].tobytes():
        return ""
    off = np.abs(t[:count] - asked[:count]) > SAME_TIME * _span(problem)
    if not off.any():
        return ""
    i = int(np.argmax(off))
    return f"output times: row {i} was asked for at {exact(asked[i])} and given at {exact(t[i])}."


def _start(problem: Problem, request: Request, motion: Rows) -> str:
    if not motion[0].size or motion[0][0] != problem.t_span[0] or request.calc_initcond:
        return ""
    for name, rows, first in (("q", motion[1], problem.q0), ("v", motion[2], problem.v0)):
        if rows[0].tolist() == first.tolist():
            continue
        allowed = SAME_START if request.rtol is None else max(SAME_START, 2.0 * float(np.max(request.rtol)))
        off = np.abs(rows[0] - first)
        if float(off.max()) > allowed * max(1.0, float(np.abs(first).max())):
            i = int(np.argmax(off))
            return f"start: {name}[{i}] is {rows[0, i]:.6g} in the first row and {first[i]:.6g} in the problem."
    return ""


def _event(problem: Problem, request: Request, solution: Solution) -> str:
    last, ahead = solution.t[-1] if solution.t.size else np.nan, np.sign(problem.t_span[1] - problem.t_span[0])
    room = SAME_TIME * _span(problem)
    beyond = np.inf if request.t_eval is not None else room  # rows at given times end before the event
    at_last = [np.any((ahead * (times - last) >= -room) & (ahead * (times - last) <= beyond)) for times in solution.t_events]
    return "" if any(at_last) else "end: a terminal event is reported, and none is reported at the last row."


def _counters(request: Request, solution: Solution) -> str:
    counters, complete = solution.counters, solution.status is Status.success
    for name in COUNTED:
        value = getattr(counters, name)
        whole = type(value) is int or (isinstance(value, (int, np.integer)) and not isinstance(value, bool))
        if value is not None and not (whole and value >= 0):
            return f"counters: {name} is {value!r}; a whole number from 0 on was expected, or None: not reported."
    least, evaluations = max(counters.steps_accepted or 0, 1), counters.residual_evaluations
    if complete and evaluations is not None and evaluations < least:
        few = f"{evaluations} evaluations of the forces are too few for {least} steps"
        return f"counters: {few}; None stands for what is not reported."
    steps = counters.steps_accepted or solution.t.size  # 0 where a plugin has left it as it was
    if request.t_eval is None and solution.t.size - 1 - sum(map(len, solution.t_events)) > steps:
        return f"counters: {solution.t.size} rows at the ends of steps are too many for {steps} steps."
    return ""


def _span(problem: Problem) -> float:
    return abs(problem.t_span[1] - problem.t_span[0])


def _rests(problem: Problem, solution: Solution) -> str:
    """State that all rows are one state although it is no equilibrium; else ""."""
    t, q, v = solution.t, solution.q, solution.v
    if t[0] == t[-1] or not (np.all(q == q[0]) and np.all(v == v[0])):
        return ""
    from hhtbench.lowering.dynamics.kkt import AccelerationLevel  # hardly a result rests

    rates, size = [v[0]], np.split(sizes_of(problem, q, v), 2)
    dynamics = derive(problem.system, float(t[0]), q[0], v[0])
    with suppress(NonFiniteValue):
        found = AccelerationLevel(dynamics).solve(float(t[0]), q[0].copy(), v[0].copy())
        rates += [found.vdot] if found.converged else []
    way = max(float(np.max(np.abs(rate) / s)) for rate, s in zip(rates, size, strict=False)) * abs(float(t[-1] - t[0]))
    if way <= MOVED:
        return ""
    return (
        f"motion: All rows are the state at t = {exact(t[0])}, which leads away by {way:.2g} of its size over the interval."
    )
