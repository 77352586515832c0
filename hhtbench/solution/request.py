"""What a caller asks of a solver: tolerances or steps, outputs, budgets."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector, check_interval, positive_integer, real_array, real_number, real_vector
from hhtbench.protocol.errors import ProblemError, did_you_mean
from hhtbench.protocol.printing import exact
from hhtbench.solution.filled import Filled
from hhtbench.solution.result import Solution

MOST_STEPS = 2**53  # prescribed: floats count so far
RTOL_FLOOR = 10 * float(np.finfo(np.float64).eps)  # below it roundoff, not the method, decides the error
ADDS_UP = 1e-9  # largest relative difference between the sum of given step lengths and the interval's length
RTOL = 1e-4  # default of a request with neither tolerances nor steps: engineering accuracy
RTOL_CEILING = 0.1  # above it a solution has no correct digit


@dataclass(frozen=True, kw_only=True)
class Request(Filled):
    """Tolerances (``rtol, atol``) or steps (``step`` or ``steps``), output times and budgets of a solve.

    ``step=h`` takes ``N = ceil(span / h)`` equal steps of ``span / N``; ``steps=N`` takes N equal steps; ``steps=array``
    takes the given lengths, which must add up to the span; ``steps=solution`` takes those of an earlier
    :class:`~hhtbench.Solution`, so that results are smooth in the parameters.  ``step``, ``steps`` and the tolerances
    exclude one another.  Budgets count over the whole span.
    """

    rtol: Any = None  #: relative tolerance: a number, or one per component for solvers that take it so
    atol: Any = None  #: absolute tolerance: a number or one per component
    step: float | None = None  #: constant step [s], positive; its sign follows from the interval
    steps: Any = None  #: number of equal steps, or their lengths [s]; of a Solution its lengths are stored
    t_eval: Vector | None = None  #: output times [s], sorted along the interval; None: every step
    dense_output: bool = False  #: prepare ``solution(t)`` of library solvers, at a cost per step; HHT always has it
    keep_steps: bool = (
        False  #: store the ends of all steps in ``ends`` beside rows at t_eval; HHT stores them in ``interpolant``
    )
    calc_initcond: bool = False  #: project an inconsistent q0, v0 onto both constraint levels instead of refusing it
    max_num_steps: int | None = None  #: most accepted steps; None: no limit beyond the request's own steps
    max_evaluations: int | None = None  #: most residual evaluations
    max_seconds: float | None = None  #: most wall-clock time [s]
    options: Mapping[str, Any] = field(default_factory=dict)  #: options of one solver

    def __post_init__(self) -> None:
        own = self.__dict__
        for name, (default, check) in CHECKS.items():
            if own[name] is not default:
                own[name] = check(name, own[name])
        if self.rtol is not None and self.atol is not None and has_zero(self.rtol) and has_zero(self.atol):
            raise ProblemError("rtol and atol must not both be zero; give one of them a positive value.")
        by_error = self.rtol is not None or self.atol is not None
        if (self.step is not None) + (self.steps is not None) + by_error > 1:
            given = [name for name in ("step", "steps") if getattr(self, name) is not None] + ["rtol/atol"] * by_error
            raise ProblemError(f"{' and '.join(given)} exclude one another; give one of them.")

    @property
    def fixed(self) -> bool:
        """True when the steps are given, not chosen by error control."""
        return self.step is not None or self.steps is not None


def make_request(also: tuple[str, ...] = (), /, **keywords: Any) -> Request:
    """A Request from keywords; an unknown name is a ``TypeError`` that lists the known ones, and those that go ``also``."""
    if unknown := keywords.keys() - NAMES:
        known = (*also, *KNOWN)
        hint = did_you_mean(min(unknown), known) or " An option of a solver is a part of its name: 'hht(alpha=-0.1)'."
        raise TypeError(f"unknown request option {', '.join(sorted(unknown))}; known: {', '.join(known)}.{hint}")
    return Request(**keywords)


def with_tolerance(request: Request) -> tuple[Request, str]:
    """Return ``request`` and ""; if it has neither tolerances nor steps, set ``rtol = 1e-4`` and return a note on that."""
    if request.fixed or request.rtol is not None or request.atol is not None:
        return request, ""
    return request.but(rtol=RTOL), f"No tolerance was given: rtol = {RTOL:g} was taken."


@dataclass(frozen=True, kw_only=True)
class StepPlan:
    """Prescribed steps over one interval; equal steps need no array of times."""

    t0: float
    t1: float
    count: int
    lengths: Vector | None  #: (count,) signed, or None for equal steps
    ends: Vector | None  #: (count,) end times, or None for equal steps

    def length(self, index: int) -> float:
        """Signed length [s] of step ``index``, as prescribed and not as the difference of two rounded times."""
        return float(self.lengths[index]) if self.lengths is not None else (self.t1 - self.t0) / self.count

    def end(self, index: int) -> float:
        """End time [s] of step ``index``; the last one is t1 exactly."""
        if index == self.count - 1:
            return self.t1
        if self.ends is not None:
            return float(self.ends[index])
        return self.t0 + (self.t1 - self.t0) * ((index + 1) / self.count)

    def ahead(self, first: int, count: int) -> tuple[Vector, Vector]:
        """Lengths and end times (k,) of up to ``count`` steps from step ``first``, as :meth:`length` and :meth:`end`."""
        last = min(first + count, self.count)
        if self.lengths is not None and self.ends is not None:
            lengths, ends = self.lengths[first:last].copy(), self.ends[first:last].copy()
        else:
            lengths = np.empty(last - first)
            lengths.fill((self.t1 - self.t0) / self.count)  # in a fifth of the time that np.full takes
            ends = self.t0 + (self.t1 - self.t0) * (np.arange(first + 1, last + 1) / self.count)
        if last == self.count and last > first:
            ends[-1] = self.t1
        return lengths, ends


def plan_steps(request: Request, t0: float, t1: float) -> StepPlan:
    """Return the prescribed steps of ``request`` over [t0, t1]; ``t1 < t0`` runs backward."""
    check_interval("the interval", t0, t1)
    span = t1 - t0
    if request.step is not None:
        steps = abs(span) / request.step * (1 - 1e-12)  # 1e-12: 0.1 / 0.001 is 100 steps, not 101
        if steps > MOST_STEPS:
            raise ProblemError(f"step={request.step:g} s makes more than 2**53 steps of {abs(span):g} s; give a longer one.")
        count = max(1, math.ceil(steps))
        return StepPlan(t0=t0, t1=t1, count=count, lengths=None, ends=None)
    if isinstance(request.steps, int):
        return StepPlan(t0=t0, t1=t1, count=request.steps, lengths=None, ends=None)
    if request.steps is None:
        raise ProblemError("the steps are not prescribed; give step=h, steps=N or steps=array of lengths.")
    try:
        total = math.fsum(request.steps)
    except OverflowError:
        total = math.inf
    if abs(total - abs(span)) > ADDS_UP * abs(span):
        raise ProblemError(
            f"steps must add up to the interval's length {exact(abs(span))} s; they add up to {exact(total)} s."
        )
    lengths = np.copysign(request.steps, span)
    return StepPlan(t0=t0, t1=t1, count=len(lengths), lengths=lengths, ends=t0 + np.cumsum(lengths))


def check_output_times(t_eval: Vector, t0: float, t1: float) -> None:
    """Raise unless ``t_eval`` runs from t0 towards t1 within the interval (equal neighbours are allowed)."""
    direction = -1.0 if t1 < t0 else 1.0
    if t_eval.size > 1 and np.any(direction * np.diff(t_eval) < 0):
        raise ProblemError("t_eval must be sorted along the interval; sort it.")
    low, high = min(t0, t1), max(t0, t1)
    for t in (float(t_eval[0]), float(t_eval[-1])):
        if not low <= t <= high:
            raise ProblemError(f"t_eval must lie within [{exact(low)}, {exact(high)}] s; got {exact(t)}.")


def _tolerance(name: str, value: Any) -> Any:
    if type(value) is float and 0.0 <= value < math.inf:  # most requests; ten times faster
        return value
    array = real_array(name, value)
    if array.ndim > 1:
        raise ProblemError(f"{name} must be a number or one number per component (n,); got shape {array.shape}.")
    if np.any(array < 0):
        raise ProblemError(f"{name} must not be negative; got {array.min():g}.")
    return float(array) if array.ndim == 0 else array


def _rtol(name: str, value: Any) -> Any:
    rtol = _tolerance(name, value)
    if type(rtol) is float and (rtol == 0.0 or RTOL_FLOOR <= rtol <= RTOL_CEILING):
        return rtol
    array = np.asarray(rtol)
    small = array[(array > 0) & (array < RTOL_FLOOR)]
    if small.size:
        text = f"rtol={small.max():g} is below roundoff; {RTOL_FLOOR:.2g} is used."
        warnings.warn(text, UserWarning, stacklevel=4)
        array = np.where(array > 0, np.maximum(array, RTOL_FLOOR), array)
    if np.any(array > RTOL_CEILING):
        text = f"rtol={array.max():g} is larger than {RTOL_CEILING}: no digit will be right."
        warnings.warn(text, UserWarning, stacklevel=4)
    return float(array) if array.ndim == 0 else array


def has_zero(tolerance: Any) -> bool:
    """True if a tolerance, a number or an array (n,), has a zero entry."""
    return tolerance == 0.0 if type(tolerance) is float else not tolerance.all()


def _seconds(name: str, value: Any) -> float:
    number = real_number(name, value, unit=" [s]")
    if number <= 0:
        raise ProblemError(f"{name} must be positive [s]; got {number}.")
    return number


def _steps(name: str, value: Any) -> int | Vector:
    if isinstance(value, Solution):
        return _lengths_of(value)
    if isinstance(value, (int, np.integer)) or np.ndim(value) == 0:
        count = positive_integer(name, value)
        if count > MOST_STEPS:
            raise ProblemError(f"steps must be at most 2**53; got {count}.")
        return count
    lengths = real_vector(name, value)
    if lengths.size == 0 or np.any(lengths <= 0):
        raise ProblemError("steps must be a whole number, an array of positive lengths [s], or an earlier solution.")
    return lengths


def _lengths_of(earlier: Solution) -> Vector:
    """Return the step lengths (k,) [s] of an earlier solution; a step cut at an event is joined again, so it may move."""
    if not earlier.success:
        raise ProblemError(
            f"steps must be those of a solution that has succeeded; this one ended with {earlier.status.label}."
        )
    if (made := earlier.steps_data) is not None:
        cut = np.isin(made.t[:-1], np.concatenate(earlier.t_events or ([],)))
        return np.add.reduceat(np.abs(made.h), np.flatnonzero(np.append(True, ~cut)))
    if earlier.ends is None:
        raise ProblemError("steps must be those of a solution that has kept its steps; solve it with keep_steps=True.")
    return np.abs(np.diff(earlier.ends.t))


def _output_times(name: str, value: Any) -> Vector:
    times = real_vector(name, value)
    if times.size == 0:
        raise ProblemError("t_eval must hold at least one time; leave it out for output at every step.")
    return times


def _switch(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False; got {value!r}.")
    return bool(value)


KNOWN = tuple(f.name for f in fields(Request))
NAMES = set(KNOWN)
CHECKS: dict[str, tuple[Any, Callable[[str, Any], Any]]] = {  # field -> default and the check of any other value
    "rtol": (None, _rtol),
    "atol": (None, _tolerance),
    "step": (None, _seconds),
    "steps": (None, _steps),
    "t_eval": (None, _output_times),
    "dense_output": (False, _switch),
    "keep_steps": (False, _switch),
    "calc_initcond": (False, _switch),
    "max_seconds": (None, _seconds),
    "max_num_steps": (None, positive_integer),
    "max_evaluations": (None, positive_integer),
}
