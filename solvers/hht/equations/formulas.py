"""The scalar and vector formulas between the steps' equations: plain numbers and arrays in, plain ones out.

One source: Python calls these functions as they are, the loops compile the same ones.
Hence no keyword arguments, and operations that take an array (n,) as well as one of its entries.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from solvers.kernel.memory import HIGHEST
from solvers.kernel.numbers import EPS, TINY

MUCH_SHORTER = 0.01  # of the last step: many growths of 1.5 followed by one such shrink are unstable in the stiff limit
GAUSS = 0.5 + 0.5 / math.sqrt(3.0)  # of the step: there v of dense output errs most; in the middle not at all
ROUNDOFF = 0.01  # of the tolerance of v: what roundoff may contribute to it between steps
THREE_DIGITS = 1e-3  # of accelerations: what roundoff may make of multipliers that are extrapolated
NOTHING = 1e-300  # a size up to it is none
REMAINDER = 1e-3  # of the step that was asked for: what is shorter is an end of the interval just ahead
NOISE = 30.0  # times: errors made of roundoff vary by so much over the steps of a run
CERTAIN = 5.0  # times what is allowed: roundoff that no step can be below; with 2.5 times many steps still pass
NEGLIGIBLE = 1e-10  # of a step: what the rounding of times may change its length by, many of one length all alike
SHORT = 1e-8  # of the time in which the fastest motion seen crosses the size of q: g over h^2 keeps half its digits
EXTRAPOLATION = tuple(  # weights of this and of k earlier steps: polynomials of degree k
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
    """Whether a step of h [s] is so long that roundoff of q over h^2 leaves its multipliers three digits, (H55)."""
    return EPS * size_q <= THREE_DIGITS * h * h * acceleration


def trapezoidal_start(alpha: float, f0: Any) -> tuple[Any, float]:
    """a0 (n,) of the first step but for its part in a1, and the weight of that, (H12) by (H6)."""
    return (1.0 / (1.0 + alpha)) * f0, alpha / (1.0 + alpha)


def crosses(before: float, now: float, direction: int) -> bool:
    """Whether a function that goes from ``before`` to ``now`` has an event: a change of sign, or a zero that is reached.

    ``direction`` as in :class:`~solvers.hht.events.event.Event`.  It leaves a zero without one.
    """
    if before == 0.0 or (now != 0.0 and (now > 0.0) == (before > 0.0)):
        return False
    return direction == 0 or (direction < 0) == (before > 0.0)


def third_difference(steps: Any, x: Any) -> Any:
    """The divided difference of four ``x`` over the three ``steps`` between, times the last of these cubed, (H59)."""
    first, last, h = steps
    before = ((x[2] - x[1]) / last - (x[1] - x[0]) / first) / (first + last)
    after = ((x[3] - x[2]) / h - (x[2] - x[1]) / last) / (last + h)
    return h * h * h * (after - before) / (first + last + h)


def cubic(s: Any, h: Any, q0: Any, rise: Any, v0: Any, v1: Any) -> tuple[Any, Any]:
    """q and v at the part ``s`` of a step of ``h`` [s] in which q rises by ``rise``, (H17)."""
    q = q0 + s * (h * v0 + s * (3 * rise - h * (2 * v0 + v1) + s * (h * (v0 + v1) - 2 * rise)))
    v = v0 + s * (2 * (3 * rise / h - 2 * v0 - v1) + 3 * s * (v0 + v1 - 2 * rise / h))
    return q, v


def smooth_rise(h: Any, q0: Any, q1: Any, v0: Any, v1: Any) -> Any:
    """q1 - q0, or h (v0 + v1)/2 where they differ by roundoff of q: over h that is no velocity, (H17)."""
    rise = q1 - q0
    bent = rise - 0.5 * h * (v0 + v1)
    return rise - bent * (np.abs(bent) <= 2.0 * EPS * np.maximum(np.abs(q0), np.abs(q1)))


def allowed(rtol: Any, atol: Any, before: Any, after: Any) -> Any:
    """Largest allowed errors over a step from ``before`` to ``after``, the weights of (H26)."""
    return np.maximum(rtol * np.maximum(np.abs(before), np.abs(after)) + atol, TINY)


def relative_part(size: float, rtol: Any, atol: Any) -> Any:
    """Tolerances over the typical ``size`` of q or of v, for (H26)."""
    return rtol + atol / size


def relative_tolerance(of_q: float, of_v: float) -> float:
    """The tolerance as a number without unit, at most 1, (H26)."""
    return max(TINY, min(1.0, of_q, of_v))


def roundoff_of(q: Any, v: Any, h: float) -> tuple[Any, Any]:
    """Roundoff of q and of v, which in a step of h [s] is also a difference of q over h."""
    return EPS * np.abs(q), np.maximum(EPS * np.abs(v), EPS * np.abs(q) / abs(h))


def representable(t: float, h: float) -> float:
    """h [s], or the nearest length by which times at ``t`` can advance, where their spacing is no negligible part of it.

    Steps that are used with another length than times advance by integrate another problem.  Not everywhere: lengths that
    differ by roundoff are other lengths, and cost the factorisation and the extrapolation of earlier steps.
    """
    if EPS * abs(t) <= NEGLIGIBLE * abs(h):
        return h
    rounded = (t + h) - t
    return h if rounded == 0.0 else rounded  # a step that cannot be made is told with the length that was asked for


def fit(t: float, h: float, stop: float, least: float = 0.0) -> tuple[float, float]:
    """(h, t + h) not past ``stop``; what is left after it is a step or nothing; no step is halved below ``least`` [s]."""
    left = stop - t
    if abs(h) >= abs(left) * (1 - 1e-9):
        return left, stop
    if 2 * abs(h) > abs(left) >= 2 * least:
        h = left / 2
    return h, t + h


def growth(o: Any, error: float, last_error: float, rejected: bool) -> float:
    """What the next step is longer than an accepted one with ``error`` (H26).

    ``o`` holds the constants of :class:`~solvers.hht.control.controller.ControlOptions`; ``last_error`` < 0: there is none.
    """
    error = max(error, o.least)
    plain = (o.target / error) ** (1 / 3)
    factor = plain
    if last_error >= 0.0:
        factor = (o.target / error) ** o.integral * (max(last_error, o.least) / o.target) ** o.proportional
    if rejected:
        return min(1.0, factor)
    return 1.0 if o.keep[0] <= plain <= o.keep[1] else min(max(factor, o.shrink), o.growth)
