"""The local error of a step in a compiled loop: what :class:`solvers.hht.estimate.Estimator` does, by the same laws."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.kernels import solve_pair_into
from solvers.hht.laws import EPS, GAUSS, NOTHING, ROUNDOFF
from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import allowed, compiled, cubic, relative_part, relative_tolerance
from solvers.hht.native.parts import address, half, half_of_pivots, indices, part, put, top
from solvers.hht.native.tables import (
    ACCELERATION,
    ANSWERS,
    ATOL,
    BEFORE,
    BETA,
    BLOCKS,
    C_LEVELS,
    C_RAW,
    CHANGES,
    COLUMNS,
    CONSTANTS,
    COUPLED,
    COUPLINGS,
    END,
    END_INVERSE,
    ERROR,
    FACTOR,
    FACTOR_H,
    GAMMA,
    HAS_ROLLING,
    INVERSE_MATRIX,
    LAM,
    LAST,
    LEVELS,
    MAP_COLUMNS,
    MAP_STARTS,
    MAPS,
    MEMORY,
    MU,
    NUMBER,
    O_LAM0,
    O_LAM1,
    O_MU,
    O_RK,
    PLACE,
    RAW,
    RAW_GIVEN,
    RIGHTS,
    ROLLING,
    ROWS,
    RTOL,
    SIZE,
    SIZE_Q,
    SIZE_V,
    SMALL,
    STARTS,
    STEP,
    STORAGE,
    VARIABLE,
    WEIGHTS,
    WORKS,
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
        a0 = a[i] if step[2] == 1.0 else step[3] * f[i] + step[2] * (a[i] - f[i])
        given[k + i] = a0 + step[4] * x[i]
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
def respond(z: Any, slot: Any) -> None:
    """What the two right-hand sides in RIGHTS make of the unknowns, into ANSWERS, and of q1 and v1, into CHANGES."""
    rights, answers, changes, n = part(z, RIGHTS), part(z, ANSWERS), part(z, CHANGES), z.i[N]
    if z.i[SMALL]:
        columns, size = half(z, INVERSE_MATRIX, slot), z.i[SIZE]
        for i in range(2 * size):
            answers[i] = 0.0
        for j in range(size):
            for i in range(size):
                answers[2 * i] += columns[j * size + i] * rights[2 * j]
                answers[2 * i + 1] += columns[j * size + i] * rights[2 * j + 1]
    else:
        solve_pair_into(
            rights,
            indices(z, ROWS),
            indices(z, COLUMNS),
            half(z, STORAGE, slot),
            half_of_pivots(z, slot),
            indices(z, BLOCKS),
            indices(z, STARTS),
            indices(z, COUPLED),
            half(z, COUPLINGS, slot),
            part(z, WORKS),
            answers,
        )
    starts, columns, maps = indices(z, MAP_STARTS), indices(z, MAP_COLUMNS), half(z, MAPS, slot)
    for i in range(2 * n):
        first = second = 0.0
        for e in range(starts[i], starts[i + 1]):
            first += maps[e] * answers[2 * columns[e]]
            second += maps[e] * answers[2 * columns[e] + 1]
        changes[2 * i], changes[2 * i + 1] = first, second


@compiled
def make_up(z: Any, slot: Any, which: Any, sign: Any, position: Any) -> None:
    """Put ``sign`` times what is in LEVELS into the constraint rows of the right-hand side ``which``."""
    rights, off, h, m = part(z, RIGHTS), part(z, LEVELS), part(z, FACTOR_H)[slot], z.i[M]
    for i in range(m):
        if position:
            rights[2 * (z.i[O_LAM0] + i) + which] = sign * off[i] * (2 / (h * h))
        rights[2 * (z.i[O_LAM1] + i) + which] = sign * off[m + i] / h
    for i in range(z.i[P]):
        rights[2 * (z.i[O_MU] + i) + which] = sign * off[2 * m + i] / h


@compiled
def look(z: Any, t: Any) -> None:
    """The constraint levels at t and the q, v in PLACE."""
    part(z, PLACE)[0] = t
    at = address(z, PLACE)
    invoke(z.i[C_LEVELS], (address(z, LEVELS), z.i[C_LEVELS + 1], at, at + 8, at + 8 + 8 * z.i[N]))


@compiled
def filtered(z: Any, slot: Any, t1: Any, h: Any, inside: Any) -> Any:
    """The errors over WEIGHTS, filtered by the matrix in ``slot``: their root mean square.

    And where ``inside`` how far dense output is off the constraints inside the step, over the tolerances, (H28); else 0.
    """
    n, raw, made, o = z.i[N], part(z, RAW), part(z, FACTOR_H)[slot], part(z, CONSTANTS)
    error, rights, answers, changes = part(z, ERROR), part(z, RIGHTS), part(z, ANSWERS), part(z, CHANGES)
    in_q, in_v = o[BETA] * (made / h) * (made / h), made * o[GAMMA]
    for i in range(rights.size):
        rights[i] = 0.0
    for i in range(n):
        rights[2 * i], rights[2 * i + 1] = raw[i] / in_q, raw[n + i] / in_v
    respond(z, slot)
    for i in range(n):
        error[i] = changes[2 * i]
        if z.i[O_RK] >= 0:
            error[i] -= 0.5 * made * made * answers[2 * (z.i[O_RK] + i)]
    for i in range(n):  # v is filtered once more, together with what the error of q makes of it across the constraints
        rights[2 * i], rights[2 * i + 1] = changes[2 * (n + i) + 1] / in_v, 0.0
    if z.i[M] + z.i[P] > 0:
        place, end = part(z, PLACE), part(z, END)
        for i in range(n):
            place[1 + i], place[1 + n + i] = end[i] + error[i], end[n + i]
        look(z, t1)
        make_up(z, slot, 0, -1.0, False)
    if inside:
        look_inside(z, h)
        make_up(z, slot, 1, 1.0, True)
    respond(z, slot)
    off = 0.0
    for i in range(n):
        error[n + i] = changes[2 * (n + i)]
    weights = part(z, WEIGHTS)
    size = weighted_rms(error, weights)
    if inside:
        for i in range(2 * n):
            error[i] = changes[2 * i + 1]
        off = weighted_rms(error, weights)
    return size, off


@compiled
def weighted_rms(x: Any, weights: Any) -> Any:
    """Root mean square of x over ``weights``, :func:`solvers.hht.laws.rms`; infinity where it is not finite."""
    total = 0.0
    for i in range(x.size):
        total += (x[i] / weights[i]) ** 2
    return math.sqrt(total / x.size) if math.isfinite(total) else math.inf


@compiled
def look_inside(z: Any, h: Any) -> None:
    """The constraint levels of dense output inside the step, where its v errs most."""
    n, end, q, v, place = z.i[N], part(z, END), part(z, Q), part(z, V), part(z, PLACE)
    for i in range(n):
        place[1 + i], place[1 + n + i] = cubic(GAUSS, h, q[i], end[i], v[i], end[n + i])
    look(z, part(z, NUMBER)[T] + GAUSS * h)


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
    inside = z.i[M] + z.i[P] > 0 and EPS * size_q <= ROUNDOFF * abs(h) * least  # else v there is roundoff over h
    kept = int(number[FACTOR])
    found, off = filtered(z, slot, t1, h, inside)
    size = found / relative
    if kept >= 0 and kept != slot:  # the matrix before it: stiffness met in this very step is no filter
        found, _ = filtered(z, kept, t1, h, False)
        size = max(size, found / relative)
    return max(size, off) if math.isfinite(size) else math.inf
