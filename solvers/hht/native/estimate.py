"""The local error of a step in a compiled loop: what :class:`solvers.hht.estimate.Estimator` does, by the same laws."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.laws import EPS, GAUSS, NOTHING, ROUNDOFF
from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import allowed, compiled, cubic, relative_part, relative_tolerance
from solvers.hht.native.newton import change_of, solve
from solvers.hht.native.parts import address, part, put, top
from solvers.hht.native.tables import (
    ACCELERATION,
    ATOL,
    BEFORE,
    BETA,
    C_LEVELS,
    C_RAW,
    CHANGE,
    CONSTANTS,
    END,
    END_INVERSE,
    ERROR,
    FACTOR,
    FACTOR_H,
    GAMMA,
    HAS_ROLLING,
    INCREMENT,
    LAM,
    LAST,
    LEVELS,
    MEMORY,
    MU,
    NUMBER,
    O_LAM0,
    O_LAM1,
    O_MU,
    O_RK,
    ONCE,
    PLACE,
    RAW,
    RAW_GIVEN,
    RIGHT,
    ROLLING,
    RTOL,
    SIZE_Q,
    SIZE_V,
    STEP,
    VARIABLE,
    WEIGHTS,
    A,
    F,
    H,
    M,
    N,
    P,
    Q,
    T,
    V,
    X,
)


@compiled
def describe(z: Any, h: Any, t1: Any) -> None:
    """Fill what :func:`solvers.hht.local_error.raw_errors` takes, in its order."""
    n, m, p, x, end, given = z.i[N], z.i[M], z.i[P], part(z, X), part(z, END), part(z, RAW_GIVEN)
    memory, last_h, a, f, step = part(z, MEMORY), part(z, NUMBER)[H], part(z, A), part(z, F), part(z, STEP)
    rolling = p > 0 and memory[HAS_ROLLING] > 0.0
    given[0], given[1] = h, memory[LAST]
    given[2] = 1.0 if last_h == 0.0 else h / (h + last_h)
    given[3] = h / (6 * (h + memory[LAST])) if rolling else 0.0
    given[4] = t1
    k = put(given, 5, end[: 2 * n])
    k = put(given, k, part(z, V))
    for i in range(n):
        given[k + i] = step[2] * a[i] + step[3] * f[i] + step[4] * x[i]
    k = put(given, k + n, end[2 * n : 4 * n])
    k = put(given, k, part(z, BEFORE))
    k = put(given, k, part(z, ACCELERATION))
    if m > 0:
        k = put(given, k, end[5 * n + m + p : 7 * n + m + p])
        k = put(given, k, part(z, LAM))
        k = put(given, k, x[z.i[O_LAM0] : z.i[O_LAM0] + m])
        k = put(given, k, x[z.i[O_LAM1] : z.i[O_LAM1] + m])
    if p > 0:
        k = put(given, k, x[z.i[O_RK] : z.i[O_RK] + n])
        k = put(given, k, part(z, ROLLING))
        k = put(given, k, part(z, MU))
        k = put(given, k, x[z.i[O_MU] : z.i[O_MU] + p])
    if z.i[VARIABLE]:
        put(given, k, part(z, END_INVERSE))


@compiled
def imbalance(z: Any, slot: Any, acceleration: Any, scale: Any) -> None:
    """The change of q1, v1 that an imbalance of accelerations (n,) over ``scale`` makes, into CHANGE."""
    right, n = part(z, RIGHT), z.i[N]
    for i in range(right.size):
        right[i] = acceleration[i] / scale if i < n else 0.0
    solve(z, slot, right, part(z, INCREMENT))
    change_of(z, slot, part(z, INCREMENT), part(z, CHANGE))


@compiled
def answer(z: Any, slot: Any, sign: Any, position: Any) -> None:
    """Changes of q1, v1 that make up for ``sign`` times what is in LEVELS, into CHANGE."""
    right, off, h, m = part(z, RIGHT), part(z, LEVELS), part(z, FACTOR_H)[slot], z.i[M]
    for i in range(right.size):
        right[i] = 0.0
    for i in range(m):
        right[z.i[O_LAM0] + i] = sign * off[i] * (2 / (h * h)) if position else 0.0
        right[z.i[O_LAM1] + i] = sign * off[m + i] / h
    for i in range(z.i[P]):
        right[z.i[O_MU] + i] = sign * off[2 * m + i] / h
    solve(z, slot, right, part(z, INCREMENT))
    change_of(z, slot, part(z, INCREMENT), part(z, CHANGE))


@compiled
def look(z: Any, t: Any) -> None:
    """The constraint levels at t and the q, v in PLACE."""
    part(z, PLACE)[0] = t
    at = address(z, PLACE)
    invoke(z.i[C_LEVELS], (address(z, LEVELS), z.i[C_LEVELS + 1], at, at + 8, at + 8 + 8 * z.i[N]))


@compiled
def filtered(z: Any, slot: Any, t1: Any, h: Any) -> Any:
    """The errors over WEIGHTS, filtered by the matrix in ``slot``: their root mean square."""
    n, raw, made, o = z.i[N], part(z, RAW), part(z, FACTOR_H)[slot], part(z, CONSTANTS)
    error, once, change, increment = part(z, ERROR), part(z, ONCE), part(z, CHANGE), part(z, INCREMENT)
    imbalance(z, slot, raw[:n], o[BETA] * (made / h) * (made / h))
    for i in range(n):
        error[i] = change[i]
        if z.i[O_RK] >= 0:
            error[i] -= 0.5 * made * made * increment[z.i[O_RK] + i]
    scale = made * o[GAMMA]
    imbalance(z, slot, raw[n : 2 * n], scale)
    put(once, 0, change[n:])
    imbalance(z, slot, once, scale)
    put(error, n, change[n:])
    if z.i[M] + z.i[P] > 0:
        place, end = part(z, PLACE), part(z, END)
        for i in range(n):
            place[1 + i], place[1 + n + i] = end[i] + error[i], end[n + i]
        look(z, t1)
        answer(z, slot, -1.0, False)
        for i in range(n):
            error[n + i] += change[n + i]
    return weighted_rms(error, part(z, WEIGHTS))


@compiled
def weighted_rms(x: Any, weights: Any) -> Any:
    """Root mean square of x over ``weights``, :func:`solvers.hht.laws.rms`; infinity where it is not finite."""
    total = 0.0
    for i in range(x.size):
        total += (x[i] / weights[i]) ** 2
    return math.sqrt(total / x.size) if math.isfinite(total) else math.inf


@compiled
def between(z: Any, slot: Any, h: Any, size_q: Any, least: Any) -> Any:
    """How far dense output is off the constraints inside the step, over the tolerances, (H28)."""
    n, end, q, v, place = z.i[N], part(z, END), part(z, Q), part(z, V), part(z, PLACE)
    if z.i[M] + z.i[P] == 0 or EPS * size_q > ROUNDOFF * abs(h) * least:
        return 0.0
    for i in range(n):
        place[1 + i], place[1 + n + i] = cubic(GAUSS, h, q[i], end[i], v[i], end[n + i])
    look(z, part(z, NUMBER)[T] + GAUSS * h)
    answer(z, slot, 1.0, True)
    return weighted_rms(part(z, CHANGE), part(z, WEIGHTS))


@compiled
def estimate(z: Any, h: Any, t1: Any, slot: Any) -> Any:
    """The size of the attempt's error, (H26); f + r at its end is the last third of RAW."""
    n, end, q, v, number = z.i[N], part(z, END), part(z, Q), part(z, V), part(z, NUMBER)
    rtol, atol, weights = part(z, RTOL), part(z, ATOL), part(z, WEIGHTS)
    describe(z, h, t1)
    invoke(z.i[C_RAW], (address(z, RAW), z.i[C_RAW + 1], address(z, RAW_GIVEN)))
    of_q = of_v = least = math.inf
    size_q, size_v = max(number[SIZE_Q], top(end[:n])), max(number[SIZE_V], top(end[n : 2 * n]))
    for i in range(n):
        weights[i] = allowed(rtol[i], atol[i], q[i], end[i])
        weights[n + i] = allowed(rtol[n + i], atol[n + i], v[i], end[n + i])
        least = min(least, weights[n + i])
        if size_q > NOTHING:
            of_q = min(of_q, relative_part(size_q, rtol[i], atol[i]))
        if size_v > NOTHING:
            of_v = min(of_v, relative_part(size_v, rtol[n + i], atol[n + i]))
    relative = math.sqrt(relative_tolerance(of_q, of_v))
    size, kept = 0.0, int(number[FACTOR])
    for k in range(2):  # the step's matrix, and the one before it if there is another
        used = slot if k == 0 else kept
        if k == 0 or (kept >= 0 and kept != slot):
            size = max(size, filtered(z, used, t1, h) / relative)
    if not math.isfinite(size):
        return math.inf
    return max(size, between(z, slot, h, size_q, least))
