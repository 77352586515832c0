"""Derivatives from differences for callables that declare none, coloured where a pattern is given.

Two kinds: first order (one extra point a column) where only Newton's convergence depends on it, fourth-order
central where the derivative enters the equations and its error is the drift floor.  ``scipy.differentiate`` is
not used: it adapts its step with tens of evaluations per entry.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize._numdiff import group_columns

EPS = float(np.finfo(np.float64).eps)
STEP = {1: EPS ** (1 / 2), 4: EPS ** (1 / 5)}  # balance truncation against roundoff for each order
SECOND_STEP = EPS ** (1 / 6)  # the same for the fourth-order second difference


def derivative(function: Callable[[Any], Any], x: Any, order: int, pattern: Any = None) -> np.ndarray:
    """Jacobian of ``function`` at ``x`` (n,), shape (rows, n), by differences of ``order`` 1 or 4.

    ``pattern`` (rows, n) of booleans lets columns without a common row share their evaluations.
    """
    x = np.asarray(x, dtype=np.float64)
    steps = STEP[order] * np.maximum(1.0, np.abs(x))
    steps = (x + steps) - x  # exactly representable
    if pattern is not None:
        return _coloured(function, x, steps, order, np.asarray(pattern, dtype=bool))
    base = function(x) if order == 1 else None
    columns = [_along(function, x, steps * (np.arange(x.size) == j), order, base) / steps[j] for j in range(x.size)]
    return np.stack(columns, axis=1) if columns else np.zeros((np.size(function(x)), 0))


def second_derivative_along(function: Callable[[float], Any], t: float, q: Any, v: Any) -> np.ndarray:
    """Second derivative at 0 of ``function(e)``, a curve through (t + e, q + e v); fourth order, error about 1e-9."""
    speed = float(np.max(np.abs(v), initial=0.0))
    e = SECOND_STEP * max(1.0, float(np.max(np.abs(q), initial=0.0))) / max(1.0, speed)
    e = (t + e) - t if t + e != t else e
    near = function(e) + function(-e)
    far = function(2 * e) + function(-2 * e)
    return (16 * near - far - 30 * function(0.0)) / (12 * e * e)


def _along(function: Callable[[Any], Any], x: np.ndarray, step: np.ndarray, order: int, base: Any) -> np.ndarray:
    if order == 1:
        return np.asarray(function(x + step)) - base
    near = np.asarray(function(x + step)) - np.asarray(function(x - step))
    far = np.asarray(function(x + 2 * step)) - np.asarray(function(x - 2 * step))
    return (8 * near - far) / 12


def _coloured(function: Callable[[Any], Any], x: np.ndarray, steps: np.ndarray, order: int, pattern: np.ndarray) -> np.ndarray:
    groups = group_columns(pattern)
    base = function(x) if order == 1 else None
    result = np.zeros(pattern.shape)
    for group in range(groups.max() + 1):
        members = groups == group
        change = _along(function, x, steps * members, order, base)
        result += np.where(pattern & members, change[:, None] / steps, 0.0)
    return result
