"""Scalar and vector formulas of step control, dense output and events, shared by Python and the compiled loops.

Plain numbers and arrays only: no keyword arguments, and operations that take an array (n,) as well as one of its entries.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from solvers.kernel.memory import HIGHEST
from solvers.kernel.numbers import EPS, TINY

MUCH_SHORTER = 0.01  # step ratio below which a is reset: growths of 1.5 and one such shrink are unstable if stiff
GAUSS = 0.5 + 0.5 / math.sqrt(3.0)  # point of the step where the error of dense output's v is largest
ROUNDOFF = 0.01  # largest share of v's tolerance that roundoff may contribute between steps
THREE_DIGITS = 1e-3  # largest relative roundoff of multipliers that are extrapolated
NOTHING = 1e-300  # sizes up to this count as zero
REMAINDER = 1e-3  # relative to the step proposed: a shorter one only completes the interval
NOISE = 30.0  # factor by which errors made of roundoff vary over the steps of a run
CERTAIN = 5.0  # roundoff over tolerance from which no step can succeed; at 2.5 many still do
NEGLIGIBLE = 1e-10  # relative change of a step by the rounding of times that is ignored
SHORT = 1e-8  # step relative to size_q / size_v at which g over h^2 keeps half its digits
EXTRAPOLATION = tuple(  # weights of this and k earlier steps for extrapolation of degree k
    np.array([-((-1.0) ** j) * math.comb(k + 1, j) for j in range(1, k + 2)]) for k in range(HIGHEST)
)


def rescaled(a: Any, f: Any, h: float, last: float) -> Any:
    """a0 (n,) for a step h [s] after one of ``last`` [s], (H11): near f(t + alpha h); f itself for a far shorter one."""
    if last == h:
        return a
    if abs(h) < MUCH_SHORTER * abs(last):
        return f
    return f + (h / last) * (a - f)  # (H11)


def tells_multipliers(h: float, size_q: float, acceleration: float) -> bool:
    """True if roundoff of q over h^2 leaves the multipliers of a step of h [s] three digits, (H55)."""
    return EPS * size_q <= THREE_DIGITS * h * h * acceleration


def trapezoidal_start(alpha: float, f0: Any) -> tuple[Any, float]:
    """(part of the first step's a0 (n,) that is known, weight of a1 in a0), (H12) by (H6)."""
    return (1.0 / (1.0 + alpha)) * f0, alpha / (1.0 + alpha)


def crosses(before: float, now: float, direction: int) -> bool:
    """True if a function going from ``before`` to ``now`` has an event: it changes sign or reaches zero.

    ``direction`` as in :class:`~hhtbench.protocol.events.Event`.  Leaving a zero is no event.
    """
    if before == 0.0 or (now != 0.0 and (now > 0.0) == (before > 0.0)):
        return False
    return direction == 0 or (direction < 0) == (before > 0.0)


def third_difference(steps: Any, x: Any) -> Any:
    """Divided difference of four values ``x`` with the three ``steps`` between, times the cube of the last step, (H59)."""
    first, last, h = steps
    before = ((x[2] - x[1]) / last - (x[1] - x[0]) / first) / (first + last)
    after = ((x[3] - x[2]) / h - (x[2] - x[1]) / last) / (last + h)
    return h * h * h * (after - before) / (first + last + h)


def cubic(s: Any, h: Any, q0: Any, rise: Any, v0: Any, v1: Any) -> tuple[Any, Any]:
    """q and v at the fraction ``s`` of a step of ``h`` [s] in which q rises by ``rise``, (H17)."""
    q = q0 + s * (h * v0 + s * (3 * rise - h * (2 * v0 + v1) + s * (h * (v0 + v1) - 2 * rise)))
    v = v0 + s * (2 * (3 * rise / h - 2 * v0 - v1) + 3 * s * (v0 + v1 - 2 * rise / h))
    return q, v


def smooth_rise(h: Any, q0: Any, q1: Any, v0: Any, v1: Any) -> Any:
    """q1 - q0, replaced by h (v0 + v1)/2 where they differ only by roundoff of q, (H17)."""
    rise = q1 - q0
    bent = rise - 0.5 * h * (v0 + v1)
    return rise - bent * (np.abs(bent) <= 2.0 * EPS * np.maximum(np.abs(q0), np.abs(q1)))


def allowed(rtol: Any, atol: Any, before: Any, after: Any) -> Any:
    """Tolerances of the errors of a step from ``before`` to ``after``, the weights of (H26)."""
    return np.maximum(rtol * np.maximum(np.abs(before), np.abs(after)) + atol, TINY)


def relative_part(size: float, rtol: Any, atol: Any) -> Any:
    """Tolerances relative to the typical ``size`` of q or of v, for (H26)."""
    return rtol + atol / size


def relative_tolerance(of_q: float, of_v: float) -> float:
    """Dimensionless tolerance of the step, at most 1, (H26)."""
    return max(TINY, min(1.0, of_q, of_v))


def roundoff_of(q: Any, v: Any, h: float) -> tuple[Any, Any]:
    """Roundoff of q and of v; that of v includes the roundoff of q over h [s]."""
    return EPS * np.abs(q), np.maximum(EPS * np.abs(v), EPS * np.abs(q) / abs(h))


def representable(t: float, h: float) -> float:
    """h [s], or the nearest difference of floating-point times at ``t`` where their spacing is not negligible.

    A step whose length differs from the advance of time integrates another problem.  Elsewhere h stays as it is, since
    lengths that differ by roundoff would cost the factorisation and the extrapolation from earlier steps.
    """
    if EPS * abs(t) <= NEGLIGIBLE * abs(h):
        return h
    rounded = (t + h) - t
    return h if rounded == 0.0 else rounded  # a step that cannot be made is reported with the length asked for


def fit(t: float, h: float, stop: float, least: float = 0.0) -> tuple[float, float]:
    """(h, t + h) shortened so that ``stop`` is hit without a tiny last step; no step is halved below ``least`` [s]."""
    left = stop - t
    if abs(h) >= abs(left) * (1 - 1e-9):
        return left, stop
    if 2 * abs(h) > abs(left) >= 2 * least:
        h = left / 2
    return h, t + h


def growth(o: Any, error: float, last_error: float, rejected: bool) -> float:
    """Factor of the next step's length after an accepted step with ``error`` (H26): PI control.

    ``o`` holds the constants of :class:`~solvers.hht.control.controller.ControlOptions`; ``last_error`` < 0: unknown.
    """
    error = max(error, o.least)
    plain = (o.target / error) ** (1 / 3)
    factor = plain
    if last_error >= 0.0:
        factor = (o.target / error) ** o.integral * (max(last_error, o.least) / o.target) ** o.proportional
    if rejected:
        return min(1.0, factor)
    return 1.0 if o.keep[0] <= plain <= o.keep[1] else min(max(factor, o.shrink), o.growth)
