"""Derivatives from differences for callables that declare none, coloured where a pattern is given.

Three kinds: first order (one extra point a column) where only Newton's convergence depends on it; second-order central
for the same where the function is made of differences itself, whose noise first order would blow up to 1e-4; fourth-order
central where the derivative enters the equations and its error is the drift floor.  ``scipy.differentiate`` is
not used: it adapts its step with tens of evaluations per entry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from scipy.optimize._numdiff import group_columns

EPS = float(np.finfo(np.float64).eps)
NESTED = 2  # order for functions that hold a difference error of about 1e-12 themselves
STEP = {1: 2.0**-26, NESTED: 2.0**-13, 4: 2.0**-10}  # near eps**(1/2), 1e-12**(1/3), eps**(1/5): truncation against noise
SECOND_STEP = 2.0**-9  # near eps**(1/6), the same for the fourth-order second difference
COMMON = 1e-2, 1e2  # where the largest coordinate is in between, those near zero may count as of size one
ALIKE = 1e-4  # relative difference of derivatives by two steps, neither of which is too long or too short


def derivative(function: Callable[[Any], Any], x: Any, order: int, pattern: Any = None, *, least: float = 1.0) -> np.ndarray:
    """Jacobian of ``function`` at ``x`` (n,), shape (rows, n), by differences of ``order`` 1, 2 or 4.

    ``pattern`` (rows, n) of booleans lets columns without a common row share their evaluations.  ``least``: the size of what
    is smaller, see :func:`least_size`.
    """
    x = np.asarray(x, dtype=np.float64)
    steps = STEP[order] * np.maximum(least, np.abs(x))
    steps = (x + steps) - x  # exactly representable
    base = function(x) if order == 1 else None
    if pattern is None:
        columns = [_along(function, x, steps * (np.arange(x.size) == j), order, base) / steps[j] for j in range(x.size)]
        return np.stack(columns, axis=1)
    pattern = np.asarray(pattern, dtype=bool)
    groups = group_columns(pattern, np.arange(x.size))  # in the order given: the fewest groups for a chain
    result = np.zeros(pattern.shape)
    for group in range(groups.max() + 1):
        members = groups == group
        change = _along(function, x, steps * members, order, base)
        result += np.where(pattern & members, change[:, None] / steps, 0.0)
    return result


def uncommon_decade(q: Any) -> int | None:
    """The power of ten of the largest of ``q`` (n,), on which steps of differences then depend; None where it is common."""
    largest = float(np.max(np.abs(q), initial=0.0))
    common = COMMON[0] <= largest <= COMMON[1] or not 0.0 < largest < np.inf
    return None if common else math.floor(math.log10(largest))


def least_size(functions: Iterable[Callable[[Any], Any]], q: Any) -> float:
    """What a coordinate that is zero, or nearly, counts as in steps of differences: one, or the largest of ``q`` (n,).

    The larger of them by which derivatives of the ``functions`` of q do not depend on the steps: mechanisms of micrometres
    in metres bend within a step that one asks for, and beside 1e6 one is roundoff.
    """
    if uncommon_decade(q) is None:
        return 1.0
    largest = float(np.max(np.abs(q)))
    larger, smaller = max(1.0, largest), min(1.0, largest)
    with np.errstate(all="ignore"):
        return larger if all(_is_smooth(function, q, larger) for function in functions) else smaller


def _is_smooth(function: Callable[[Any], Any], q: Any, least: float) -> bool:
    """Whether shorter steps give the same derivative; where the function is not defined around q they do not."""
    for order in (1, 4):
        try:
            one, other = (derivative(function, q, order, least=size) for size in (least, least / 4.0))
        except Exception:  # noqa: BLE001 - whatever a user's function raises beside its domain
            return False
        if not np.max(np.abs(one - other), initial=0.0) <= ALIKE * np.max(np.abs(other), initial=0.0):
            return False
    return True


def derivative_along(function: Callable[[float], Any], t: float, q: Any, v: Any, *, least: float = 1.0) -> np.ndarray:
    """Derivative at 0 of ``function(e)``, a curve through (t + e, q + e v); fourth order."""
    e = _step_along(STEP[4], t, q, v, least)
    return _along(function, 0.0, e, 4) / e


def second_derivative_along(function: Callable[[float], Any], t: float, q: Any, v: Any, *, least: float = 1.0) -> np.ndarray:
    """Second derivative at 0 of ``function(e)``, a curve through (t + e, q + e v); fourth order, error about 1e-9."""
    e = _step_along(SECOND_STEP, t, q, v, least)
    near = function(e) + function(-e)
    far = function(2 * e) + function(-2 * e)
    return (16 * near - far - 30 * function(0.0)) / (12 * e * e)


def _step_along(relative: float, t: float, q: Any, v: Any, least: float) -> float:
    """A step in time that moves t by at most ``relative`` and no coordinate by more than that times its size."""
    size = np.maximum(least, np.abs(np.asarray(q, dtype=np.float64)))
    speed = float(np.max(np.abs(v) / size, initial=0.0))
    e = relative / max(1.0, speed)
    return (t + e) - t or e  # exactly representable, also at a late t


def _along(function: Callable[[Any], Any], x: Any, step: Any, order: int, base: Any = None) -> np.ndarray:
    """Change of ``function`` from ``x`` over ``step``, if it were linear."""
    if order == 1:
        return np.asarray(function(x + step)) - base
    near = np.asarray(function(x + step)) - np.asarray(function(x - step))
    if order == NESTED:
        return near / 2
    far = np.asarray(function(x + 2 * step)) - np.asarray(function(x - 2 * step))
    return (8 * near - far) / 12
