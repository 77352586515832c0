"""One attempt at a step: known values, guess, Newton's iteration, the end of the step, and its acceptance."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.hht.equations.formulas import EXTRAPOLATION, HIGHEST, MUCH_SHORTER, TINY
from solvers.hht.linear.matrix import early
from solvers.hht.step.calls import view
from solvers.hht.step.compiled import compiled, moves_nothing, rescaled, trapezoidal_start
from solvers.hht.step.memory import (
    ACCELERATION_LEVEL,
    ALPHA,
    ATTEMPT,
    C_ACCELERATION,
    C_END,
    C_INVERSE_MASS,
    C_SHORTEST,
    CALLS_PYTHON,
    CONSTANTS,
    CONTRACTION,
    CONVERGED,
    EARLY,
    END,
    END_INVERSE_MASS,
    FACTOR,
    H_TRIED,
    INVERSE_MASS,
    KIND,
    KIND_INVERSE,
    KNOWN,
    LAM,
    MU,
    NONFINITE,
    NONFINITES,
    NUMBER,
    O_LAM0,
    O_LAM1,
    O_MU,
    O_R1,
    O_RK,
    PLACE,
    RATE,
    RECORD,
    RESCALE_A,
    RESIDUALS,
    RESTARTS,
    SHORTEST,
    SIZE_Q,
    SIZE_V,
    SLOT,
    SPENT,
    STEP,
    T_END,
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
from solvers.hht.step.newton import damped, newton, whole
from solvers.hht.step.sections import address, call, finite, half, largest, part, put

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
    """Unknowns to begin with: extrapolated from steps of this length, else those of the last."""
    x, last, earlier, number = part(z, X), part(z, X_LAST), part(z, X_EARLIER), part(z, NUMBER)
    size, count = x.size, int(number[KNOWN]) - 1
    if count > 0 and number[H] == h:
        weights = WEIGHTS_OF[best_degree(last, earlier, count)]
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
def best_degree(last: Any, earlier: Any, count: Any) -> Any:
    """The degree of the extrapolation that would have met the last unknowns best."""
    size = last.size
    if count < HIGHEST:
        return best_degree_of_few(last, earlier, count)
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
def best_degree_of_few(last: Any, earlier: Any, count: Any) -> Any:
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
    """How an attempt at a step of h [s] to t1 ended; what it found is in X, END and ATTEMPT.

    A first failure is retried from the plain guess with fresh matrices, by whole and then by damped increments: one value
    that is not finite, or a bad extrapolation, costs a retry and not the run.
    """
    number, tried = part(z, NUMBER), part(z, ATTEMPT)
    size_q, size_v, speed, acceleration = number[SIZE_Q], number[SIZE_V], largest(part(z, V)), largest(part(z, VDOT))
    tried[H_TRIED], tried[T_END] = h, t1
    if z.i[M] > 0 and moves_nothing(h, speed, acceleration, size_q, size_v) and shortest(z, counts):
        return CONVERGED
    step = part(z, STEP)
    step[0], step[1] = h, t1
    step[2], step[3], step[4] = start_weights(z, h)
    early(z)
    accelerated = abs(h) * max(acceleration, largest(part(z, F)), largest(part(z, A)))
    typical_q, typical_v = max(size_q, abs(h) * size_v, TINY), max(size_v, accelerated, TINY)
    kept = int(number[FACTOR])
    guess(z, h)
    ended, slot, rate = newton(z, kept, h, typical_q, typical_v, counts)
    ended = finished(z, ended, t1, counts)
    if ended not in (CONVERGED, SPENT):
        counts[RESTARTS] += 1
        early(z)  # it may have held the one value that was not finite
        restart_guess(z, h, counts)
        ended, slot, rate = whole(z, kept, h, typical_q, typical_v, counts)
        ended = finished(z, ended, t1, counts)
    if ended not in (CONVERGED, SPENT):
        early(z)
        plain_guess(z, part(z, X))
        ended, slot, rate = damped(z, kept, h, typical_q, typical_v, counts)
        ended = finished(z, ended, t1, counts)
    tried[SLOT], tried[CONTRACTION] = slot, rate
    return ended


@compiled
def restart_guess(z: Any, h: Any, counts: Any) -> None:
    """The plain guess; after a far shorter step the multipliers are roundoff over its h^2, and found anew."""
    if z.i[M] + z.i[P] > 0 and 0.0 < abs(part(z, NUMBER)[H]) < MUCH_SHORTER * abs(h):
        number, place = part(z, NUMBER), part(z, PLACE)
        place[0] = number[T]
        put(place, put(place, 1, part(z, Q)), part(z, V))
        if acceleration_level(z, address(z, LAM), address(z, MU), counts):
            found, n, m = part(z, ACCELERATION_LEVEL), z.i[N], z.i[M]
            put(part(z, VDOT), 0, found[1 : 1 + n])
            put(part(z, LAM), 0, found[1 + n : 1 + n + m])
            put(part(z, MU), 0, found[1 + n + m :])
    plain_guess(z, part(z, X))


@compiled
def acceleration_level(z: Any, lam: Any, mu: Any, counts: Any) -> Any:
    """Whether the acceleration level at PLACE determines v' and multipliers, near those at two addresses, (H16)."""
    counts[RESIDUALS] += 1
    part(z, ACCELERATION_LEVEL)[0] = 0.0
    at = address(z, PLACE)
    call(z, C_ACCELERATION, ACCELERATION_LEVEL, (at, at + 8, at + 8 + 8 * z.i[N], lam, mu))
    return part(z, ACCELERATION_LEVEL)[0] > 0.0


@compiled
def shortest(z: Any, counts: Any) -> Any:
    """Whether a step that moves q by less than its roundoff is made along v and the acceleration, (H21)."""
    counts[RESIDUALS] += 1
    number, n, x, end, found = part(z, NUMBER), z.i[N], part(z, X), part(z, END), part(z, SHORTEST)
    found[0] = 0.0
    call(z, C_SHORTEST, SHORTEST, (address(z, NUMBER), address(z, ATTEMPT)))
    if not found[0] > 0.0:
        return False
    known = found.size - 1 - part(z, END_INVERSE_MASS).size
    put(end, 0, found[1 : 1 + known])
    put(part(z, END_INVERSE_MASS), 0, found[1 + known :])
    for i in range(known, end.size):
        end[i] = 0.0
    if number[KNOWN] > 0.0:
        put(x, 0, part(z, X_LAST))
    else:
        plain_guess(z, x)
    multipliers = found[1 + 4 * n : 1 + 4 * n + z.i[M]]
    put(x, z.i[O_LAM0], multipliers)
    put(x, z.i[O_LAM1], multipliers)
    if z.i[P] > 0:
        put(x, z.i[O_MU], found[1 + 4 * n + z.i[M] : 1 + 4 * n + z.i[M] + z.i[P]])
    tried = part(z, ATTEMPT)
    tried[SLOT], tried[CONTRACTION] = -1.0, 0.0
    return True


@compiled
def finished(z: Any, ended: Any, t1: Any, counts: Any) -> Any:
    """The state after a step whose unknowns converged, into END; how the attempt ended in the end."""
    if ended == CONVERGED:
        x, given, known = address(z, X), address(z, STEP), address(z, EARLY)
        if z.i[KIND] == KIND_INVERSE:
            call(z, C_END, END, (x, x, x, given, known))
        else:
            call(z, C_END, END, (x, given, known))
        if z.i[VARIABLE]:
            place = part(z, PLACE)
            place[0] = t1
            put(place, 1, part(z, END)[: z.i[N]])
            call(z, C_INVERSE_MASS, END_INVERSE_MASS, (address(z, PLACE), address(z, PLACE) + 8))
        if not finite(part(z, END_INVERSE_MASS)) or (z.i[CALLS_PYTHON] and not finite(part(z, END))):
            ended = NONFINITE
    if ended == NONFINITE:
        counts[NONFINITES] += 1
    return ended


@compiled
def accept(z: Any, row: Any) -> None:
    """Make the end of the attempt the state, and write it to ``row`` as :class:`~solvers.hht.history.History` keeps it."""
    n, m, p, x, end, number = z.i[N], z.i[M], z.i[P], part(z, X), part(z, END), part(z, NUMBER)
    tried = part(z, ATTEMPT)
    h, t1, slot = tried[H_TRIED], tried[T_END], int(tried[SLOT])
    row[0], row[1] = t1, h
    same = number[KNOWN] > 0.0 and number[H] == h and slot >= 0
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
        put(part(z, INVERSE_MASS), 0, part(z, END_INVERSE_MASS))
    number[T], number[H], number[KNOWN] = t1, h, known
    if slot >= 0:
        half(z, RECORD, slot)[RATE] = tried[CONTRACTION]
        number[FACTOR] = slot
    number[SIZE_Q], number[SIZE_V] = max(number[SIZE_Q], largest(end[:n])), max(number[SIZE_V], largest(end[n : 2 * n]))
