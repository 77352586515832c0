"""Derivatives by finite differences for callables that declare none, coloured where a pattern is given.

First order (one extra point a column) where only Newton's convergence depends on it; second-order central for
reactions, whose relative error of 4e-11 adds no drift; fourth-order central where constraints are measured or
corrected by the derivative: its error limits the drift, 1e-12 of an entry, and along v some 1e-11 of the fastest
coordinate.  Second derivatives are differences of the function itself, never of its differences.
``scipy.differentiate`` is not used: it adapts its step with tens of evaluations per entry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from scipy.optimize._numdiff import group_columns

EPS = float(np.finfo(np.float64).eps)
STEP = {1: 2.0**-26, 2: 2.0**-17, 4: 2.0**-10}  # near eps**(1/(order + 1)): balances truncation and roundoff
MIXED_STEP = 2.0**-13  # near eps**(1/4), for second differences in Newton's matrix, with error 1e-7
SECOND_STEP = 2.0**-9  # near eps**(1/6), for the fourth-order second difference
COMMON = 1e-2, 1e2  # range of the largest coordinate in which those near zero count as of size one
ALIKE = 1e-4  # relative difference of derivatives by two steps below which both steps are suitable


def derivative(
    function: Callable[[Any], Any],
    x: Any,
    order: int,
    pattern: Any = None,
    *,
    least: float = 1.0,
    step: float | None = None,
) -> np.ndarray:
    """Jacobian of ``function`` at ``x`` (n,), shape (rows, n), by differences of ``order`` 1, 2 or 4.

    With ``pattern`` (rows, n) of booleans, columns without a common row share evaluations.  ``least``: lower bound on
    sizes of coordinates, see :func:`least_size`; ``step``: relative step instead of that of the order.
    """
    x = np.asarray(x, dtype=np.float64)
    steps = _steps(x, step or STEP[order], least)
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
    """Decimal exponent of the largest of ``q`` (n,), if steps of differences depend on it; None in the COMMON range."""
    largest = float(np.max(np.abs(q), initial=0.0))
    common = COMMON[0] <= largest <= COMMON[1] or not 0.0 < largest < np.inf
    return None if common else math.floor(math.log10(largest))


def least_size(functions: Iterable[Callable[[Any], Any]], q: Any) -> float:
    """Lower bound on coordinates' sizes for steps of differences: 1, or the largest of ``q`` (n,).

    The larger of these for which derivatives of ``functions`` do not depend on the step: a step of one is too long for
    mechanisms of micrometres in metres, and is roundoff beside 1e6.
    """
    if uncommon_decade(q) is None:
        return 1.0
    largest = float(np.max(np.abs(q)))
    larger, smaller = max(1.0, largest), min(1.0, largest)
    with np.errstate(all="ignore"):
        return larger if all(_is_smooth(function, q, larger) for function in functions) else smaller


def _is_smooth(function: Callable[[Any], Any], q: Any, least: float) -> bool:
    """True if shorter steps give the same derivative; False also where the function is not defined around q."""
    for order in (1, 4):
        try:
            one, other = (derivative(function, q, order, least=size) for size in (least, least / 4.0))
        except Exception:  # noqa: BLE001 - whatever a user's function raises beside its domain
            return False
        if not np.max(np.abs(one - other), initial=0.0) <= ALIKE * np.max(np.abs(other), initial=0.0):
            return False
    return True


def derivative_along(
    function: Callable[[float], Any], t: float, q: Any, v: Any, order: int = 4, *, least: float = 1.0
) -> np.ndarray:
    """Derivative at 0 of ``function(e)``, a curve through (t + e, q + e v), by differences of ``order`` 2 or 4."""
    e = _step_along(STEP[4] if order == 4 else MIXED_STEP, t, q, v, least)
    return _along(function, 0.0, e, order) / e


def product(function: Callable[[Any], Any], q: Any, v: Any, *, least: float = 1.0) -> np.ndarray:
    """Jacobian of ``function`` at ``q`` times ``v`` (n,); fourth order, with the same relative accuracy for small v."""
    q = np.asarray(q, dtype=np.float64)
    e = STEP[4] / (float(np.max(np.abs(v) / np.maximum(least, np.abs(q)))) or 1.0)
    return _along(lambda s: function(q + s * v), 0.0, e, 4) / e


def second_derivative_along(function: Callable[[float], Any], t: float, q: Any, v: Any, *, least: float = 1.0) -> np.ndarray:
    """Second derivative at 0 of ``function(e)``, a curve through (t + e, q + e v); fourth order, error about 1e-9."""
    e = _step_along(SECOND_STEP, t, q, v, least)
    near = function(e) + function(-e)
    far = function(2 * e) + function(-2 * e)
    return (16 * near - far - 30 * function(0.0)) / (12 * e * e)


def second_derivative(
    function: Callable[[Any], Any], x: Any, weights: Any, pattern: Any = None, *, least: float = 1.0
) -> np.ndarray:
    """Matrix (n, n) of second derivatives at ``x`` (n,) of ``weights`` (rows,) times ``function``.

    With k groups of columns (n without a ``pattern`` (rows, n)) it takes k (k + 3) + 1 evaluations.
    """
    x = np.asarray(x, dtype=np.float64)
    pattern = np.ones((np.size(weights), x.size)) if pattern is None else pattern
    rows, columns = np.nonzero(pattern)
    groups = group_columns(np.asarray(pattern, dtype=bool), np.arange(x.size))
    count, steps = int(groups.max()) + 1, _steps(x, MIXED_STEP, least)
    column = np.full((np.size(weights), count), -1)  # column of each row in each group
    column[rows, groups[columns]] = columns
    moves = [steps * (groups == k) for k in range(count)]
    twice = lambda move: function(x + move) + function(x - move)  # noqa: E731
    base, moved, result = 2.0 * function(x), [twice(move) for move in moves], np.zeros((x.size, x.size))
    for a in range(count):
        for b in range(a + 1):
            there = (column[:, a] >= 0) & (column[:, b] >= 0)
            i, j = column[there, a], column[there, b]
            change = 0.5 * (twice(moves[a] + moves[b]) - moved[a] - moved[b] + base)
            value = (weights * change)[there] / (steps[i] * steps[j])
            np.add.at(result, (i, j), value)
            if a != b:
                np.add.at(result, (j, i), value)
    return result


def _steps(x: Any, relative: float, least: float) -> np.ndarray:
    """Step for each entry of ``x`` (n,)."""
    steps: np.ndarray = (x + relative * np.maximum(least, np.abs(x))) - x  # exactly representable
    return steps


def _step_along(relative: float, t: float, q: Any, v: Any, least: float) -> float:
    """Time step [s], at most ``relative``, along which each q changes by at most ``relative`` times max(|q|, ``least``)."""
    size = np.maximum(least, np.abs(np.asarray(q, dtype=np.float64)))
    speed = float(np.max(np.abs(v) / size, initial=0.0))
    e = relative / max(1.0, speed)
    return (t + e) - t or e  # exactly representable, also at a late t


def _along(function: Callable[[Any], Any], x: Any, step: Any, order: int, base: Any = None) -> np.ndarray:
    """Change of ``function`` from ``x`` over ``step``, to first order."""
    if order == 1:
        return np.asarray(function(x + step)) - base
    near = np.asarray(function(x + step)) - np.asarray(function(x - step))
    if order == 2 or not near.any():  # it does not depend on what the step changes, as most constraints not on time
        return near / 2
    far = np.asarray(function(x + 2 * step)) - np.asarray(function(x - 2 * step))
    return (8 * near - far) / 12
