"""One step in a compiled loop: known values, guess, Newton's iteration, the end of the step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from solvers.hht.laws import EXTRAPOLATION, HIGHEST, MUCH_SHORTER, TINY
from solvers.hht.native.calls import invoke, view
from solvers.hht.native.compiled import compiled, moves_nothing, rescaled, trapezoidal_start
from solvers.hht.native.matrix import early
from solvers.hht.native.newton import damped, newton, whole
from solvers.hht.native.parts import address, part, put, top
from solvers.hht.native.tables import (
    ALPHA,
    C_END,
    C_INVERSE,
    CONSTANTS,
    CONVERGED,
    DIVERGED,
    EARLY,
    ELSEWHERE,
    END,
    END_INVERSE,
    FACTOR,
    INVERSE,
    KNOWN,
    LAM,
    MU,
    NONFINITE,
    NUMBER,
    O_LAM0,
    O_LAM1,
    O_MU,
    O_R1,
    O_RK,
    PLACE,
    RATE,
    RESCALE_A,
    RESTARTS,
    SINGULAR,
    SIZE_Q,
    SIZE_V,
    SMALL,
    STEP,
    TRAPEZOIDAL,
    VARIABLE,
    VDOT,
    X_EARLIER,
    X_LAST,
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

WEIGHTS_OF = tuple(tuple(float(x) for x in weights) + (0.0,) * (HIGHEST - weights.size) for weights in EXTRAPOLATION)


@compiled
def start_weights(z: Any, h: Any) -> Any:
    """Weights of a - f, of f and of a1 in a0, :func:`solvers.hht.weights.start_of_step`; 1 first: a itself."""
    last = part(z, NUMBER)[H]
    if last == 0.0 and z.i[TRAPEZOIDAL]:
        of_f, from_end = trapezoidal_start(part(z, CONSTANTS)[ALPHA], 1.0)
        return 0.0, of_f, from_end
    if last != 0.0 and z.i[RESCALE_A]:
        return rescaled(1.0, 0.0, h, last), 1.0, 0.0
    return 1.0, 1.0, 0.0


@compiled
def guess(z: Any, h: Any) -> None:
    """Unknowns to begin with, as :meth:`solvers.hht.engine.HostEngine._guess` finds them."""
    x, last, earlier, number = part(z, X), part(z, X_LAST), part(z, X_EARLIER), part(z, NUMBER)
    size, count = x.size, int(number[KNOWN]) - 1
    if count > 0 and number[H] == h:
        weights = WEIGHTS_OF[foretold(last, earlier, count)]
        for i in range(size):
            x[i] = weights[0] * last[i]
        for k in range(HIGHEST - 1):
            if weights[1 + k] != 0.0:
                for i in range(size):
                    x[i] += weights[1 + k] * earlier[k * size + i]
    elif number[KNOWN] > 0.0:
        put(x, 0, last)
    else:
        plain_guess(z, x)


@compiled
def foretold(last: Any, earlier: Any, count: Any) -> Any:
    """The degree that would have told the last unknowns best, :func:`solvers.hht.engine.foretold`."""
    size = last.size
    if count < HIGHEST:
        return foretold_by(last, earlier, count)
    e0 = e1 = e2 = e3 = e4 = 0.0
    for i in range(size):  # backward differences: the error of degree k is the one of order k + 1
        b, c, d, e, f = earlier[i], earlier[size + i], earlier[2 * size + i], earlier[3 * size + i], earlier[4 * size + i]
        a, b, c, d, e = last[i] - b, b - c, c - d, d - e, e - f
        e0 = max(e0, abs(a))
        a, b, c, d = a - b, b - c, c - d, d - e
        e1 = max(e1, abs(a))
        a, b, c = a - b, b - c, c - d
        e2 = max(e2, abs(a))
        a, b = a - b, b - c
        e3 = max(e3, abs(a))
        e4 = max(e4, abs(a - b))
    best, least = 0, e0
    if e1 < least:
        best, least = 1, e1
    if e2 < least:
        best, least = 2, e2
    if e3 < least:
        best, least = 3, e3
    return 4 if e4 < least else best


@compiled
def foretold_by(last: Any, earlier: Any, count: Any) -> Any:
    """The same after fewer steps."""
    size, best, least = last.size, 0, np.inf
    for degree in range(count):
        weights, error = WEIGHTS_OF[degree], 0.0
        for i in range(size):
            value = last[i]
            for k in range(degree + 1):
                value -= weights[k] * earlier[k * size + i]
            error = max(error, abs(value))
        if error < least:
            best, least = degree, error
    return best


@compiled
def plain_guess(z: Any, x: Any) -> None:
    """Unknowns from the state alone: its accelerations and multipliers."""
    vdot, f, told = part(z, VDOT), part(z, F), z.i[M] == 0 or z.i[P] == 0
    put(x, 0, part(z, A))
    for i in range(z.i[N]):
        reaction = vdot[i] - f[i] if told else 0.0
        if z.i[O_R1] >= 0:
            x[z.i[O_R1] + i] = reaction
        if z.i[O_RK] >= 0:
            x[z.i[O_RK] + i] = reaction
    if z.i[O_LAM0] >= 0:
        put(x, z.i[O_LAM0], part(z, LAM))
        put(x, z.i[O_LAM1], part(z, LAM))
    if z.i[O_MU] >= 0:
        put(x, z.i[O_MU], part(z, MU))


@compiled
def attempt(z: Any, h: Any, t1: Any, counts: Any) -> Any:
    """(how it ended, slot, worst contraction) of a step of h [s] to t1; what it found is in X and END."""
    number = part(z, NUMBER)
    size_q, size_v, speed, acceleration = number[SIZE_Q], number[SIZE_V], top(part(z, V)), top(part(z, VDOT))
    if z.i[M] > 0 and moves_nothing(h, speed, acceleration, size_q, size_v):
        return ELSEWHERE, -1, 0.0
    step = part(z, STEP)
    step[0], step[1] = h, t1
    step[2], step[3], step[4] = start_weights(z, h)
    early(z)
    guess(z, h)
    accelerated = abs(h) * max(acceleration, top(part(z, F)), top(part(z, A)))
    typical_q, typical_v = max(size_q, abs(h) * size_v, TINY), max(size_v, accelerated, TINY)
    kept = int(number[FACTOR])
    ended, slot, rate = newton(z, kept, h, typical_q, typical_v, counts)
    if ended in (DIVERGED, SINGULAR) and not 0.0 < abs(number[H]) < MUCH_SHORTER * abs(h):
        counts[RESTARTS] += 1  # after a far shorter step the multipliers are roundoff over its h^2: no guess
        plain_guess(z, part(z, X))
        ended, slot, rate = whole(z, kept, h, typical_q, typical_v, counts)
        if ended in (DIVERGED, SINGULAR, NONFINITE):
            plain_guess(z, part(z, X))
            ended, slot, rate = damped(z, kept, h, typical_q, typical_v, counts)
    if ended == CONVERGED:
        finish(z)
        if z.i[VARIABLE]:
            place = part(z, PLACE)
            place[0] = t1
            put(place, 1, part(z, END)[: z.i[N]])
            at = address(z, PLACE)
            invoke(z.i[C_INVERSE], (address(z, END_INVERSE), z.i[C_INVERSE + 1], at, at + 8))
            if not math.isfinite(top(part(z, END_INVERSE))):
                return NONFINITE, -1, 0.0
    return ended, slot, rate


@compiled
def finish(z: Any) -> None:
    """The state after the step, into END."""
    x, given, known = address(z, X), address(z, STEP), address(z, EARLY)
    if z.i[SMALL]:
        invoke(z.i[C_END], (address(z, END), z.i[C_END + 1], x, x, x, given, known))
    else:
        invoke(z.i[C_END], (address(z, END), z.i[C_END + 1], x, given, known))


@compiled
def accept(z: Any, h: Any, t1: Any, slot: Any, rate: Any, row: Any) -> None:
    """Make the end of the attempt the state, and write it to ``row`` as :class:`~solvers.hht.history.History` keeps it."""
    n, m, p, x, end, number = z.i[N], z.i[M], z.i[P], part(z, X), part(z, END), part(z, NUMBER)
    row[0], row[1] = t1, h
    same = number[KNOWN] > 0.0 and number[H] == h
    earlier, last, size = part(z, X_EARLIER), part(z, X_LAST), x.size
    known = min(number[KNOWN] + 1.0, HIGHEST + 1.0) if same else 1.0
    if same:
        for i in range(HIGHEST * size - 1, size - 1, -1):
            earlier[i] = earlier[i - size]
        put(earlier, 0, last)
    put(last, 0, x)
    k = put(row, 2, end[: 3 * n])
    if m > 0:
        k = put(row, k, x[z.i[O_LAM0] : z.i[O_LAM0] + m])
    put(row, k, end[4 * n : 4 * n + m + p])
    put(view(z.w, z.i[2 * Q], 5 * n + m + p), 0, end[: 5 * n + m + p])
    if z.i[VARIABLE]:
        put(part(z, INVERSE), 0, part(z, END_INVERSE))
    part(z, RATE)[slot] = rate
    number[T], number[H], number[KNOWN], number[FACTOR] = t1, h, known, slot
    number[SIZE_Q], number[SIZE_V] = max(number[SIZE_Q], top(end[:n])), max(number[SIZE_V], top(end[n : 2 * n]))
