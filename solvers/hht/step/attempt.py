"""One attempt at a step: predictor, Newton's iteration with retries, end of the step, its acceptance."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.equations.formulas import EXTRAPOLATION, MUCH_SHORTER
from solvers.hht.sources import rescaled, tells_multipliers, trapezoidal_start
from solvers.hht.step.newton import newton, restarted
from solvers.hht.step.stopping import compute_end, typical_sizes
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import acceleration_level
from solvers.kernel.compiled import compiled
from solvers.kernel.linear.matrix import early
from solvers.kernel.memory import HIGHEST
from solvers.kernel.numbers import TINY
from solvers.kernel.sections import address, call, call_python, finite, largest, part, put, view

FEW_EQUAL = 3  # equal steps before the last below which the times of others are used too, (H46)
LEAP = 1.25  # times the displacement by changing accelerations in a step: more may be another branch, (H58)
MIN_LEAP = 1e-6  # relative to the coordinate: smaller leaps are no branch switch
MIN_LEAP_OF_LARGEST = 1e-8  # the same relative to the largest coordinate
MIN_LEAP_OF_BEND = 0.25  # the same relative to the largest departure of any coordinate from uniform motion
WEIGHTS_OF = tuple(tuple(float(x) for x in weights) + (0.0,) * (HIGHEST - weights.size) for weights in EXTRAPOLATION)


@compiled
def start_weights(z: Any, h: Any) -> Any:
    """Weights of (a - f, f, a1) in a0, (H11), (H12); (1, 1, 0) takes a itself."""
    last = part(z, mem.NUMBER)[mem.H]
    if last == 0.0 and z.i[mem.TRAPEZOIDAL]:
        of_f, from_end = trapezoidal_start(part(z, mem.CONSTANTS)[mem.ALPHA], 1.0)
        return 0.0, of_f, from_end
    if last != 0.0 and z.i[mem.RESCALE_A]:
        return rescaled(1.0, 0.0, h, last), 1.0, 0.0
    return 1.0, 1.0, 0.0


@compiled
def guess(z: Any, h: Any) -> None:
    """Predict the unknowns by extrapolation from earlier steps; else take those of the last step, (H46)."""
    x, last, before, number = part(z, mem.X), part(z, mem.X_LAST), part(z, mem.X_EARLIER), part(z, mem.NUMBER)
    size, count, degree = x.size, int(number[mem.KNOWN]) - 1, 0
    if count < 0:
        plain_guess(z, z.i[2 * mem.LAM])
        return
    equal = equal_steps(z, h)
    if 1 < count > equal < FEW_EQUAL:
        if from_unequal_steps(z, h, count):
            return
    elif equal > 0:
        degree = best_degree(z, equal)
    put(x, 0, last)
    if degree == 0 and z.i[mem.O_LAM0] >= 0:
        put(x, z.i[mem.O_LAM0], last[z.i[mem.O_LAM1] : z.i[mem.O_LAM1] + z.i[mem.M]])
    if degree > 0:
        weights = WEIGHTS_OF[degree]
        for i in range(size):
            total = weights[0] * last[i]
            for k in range(degree):
                total += weights[k + 1] * before[k * size + i]
            x[i] = total


@compiled
def equal_steps(z: Any, h: Any) -> Any:
    """Number of steps before the last that have, as the last, the length ``h``."""
    number, lengths, count = part(z, mem.NUMBER), part(z, mem.H_EARLIER), 0
    while number[mem.H] == h and count < number[mem.KNOWN] - 1.0 and lengths[count] == h:
        count += 1
    return count


@compiled
def from_unequal_steps(z: Any, h: Any, count: Any) -> Any:
    """Extrapolate the unknowns in time from steps of different lengths, (H46); False if the last ones predict as well.

    The degree, 1 or 2, is the one that would have predicted the last unknowns best from the ``count`` steps before.
    """
    x, last, earlier, lengths = part(z, mem.X), part(z, mem.X_LAST), part(z, mem.X_EARLIER), part(z, mem.H_EARLIER)
    size, m, lam0, lam1, h0 = last.size, z.i[mem.M], z.i[mem.O_LAM0], z.i[mem.O_LAM1], part(z, mem.NUMBER)[mem.H]
    h1, h2, h3, three = lengths[0], lengths[1], lengths[2], count > 2
    e0 = e1 = e2 = u = v = w = p = r = s = 0.0
    known = math.nan
    for i in range(size):
        own = share_of_step(z, i)
        if own != known:
            t0, t1, t2 = own * h0, (own - 1.0) * h1, (own - 1.0) * h2 - h1
            t3 = (own - 1.0) * h3 - h1 - h2
            u, v, w = lagrange(t0, t1, t2, 0.0, False)
            if three:
                p, r, s = lagrange(t0, t1, t2, t3, True)
            known = own
        a, b = earlier[i], earlier[size + i]
        e0 = max(e0, abs(last[i] - (earlier[lam1 + i - lam0] if 0 <= lam0 <= i < lam0 + m else a)))
        e1 = max(e1, abs(last[i] - u * a - v * b))
        if three:
            e2 = max(e2, abs(last[i] - p * a - r * b - s * earlier[2 * size + i]))
    degree = 2 if three and e2 < min(e0, e1) else 1
    if degree == 1 and not e1 < e0:
        return False
    known = math.nan
    for i in range(size):
        own = share_of_step(z, i)
        if own != known:
            t1, t2 = (own - 1.0) * h0, (own - 1.0) * h1 - h0
            u, v, w = lagrange(own * h, t1, t2, (own - 1.0) * h2 - h0 - h1, degree == 2)
            known = own
        x[i] = u * last[i] + v * earlier[i] + (w * earlier[size + i] if degree == 2 else 0.0)
    return True


@compiled
def share_of_step(z: Any, i: Any) -> Any:
    """Time in its step, over its length, at which the unknown of index ``i`` approximates a function of time."""
    n, m = z.i[mem.N], z.i[mem.M]
    if i < n:
        return 1.0 + part(z, mem.CONSTANTS)[mem.ALPHA]
    if 0 <= z.i[mem.O_LAM0] <= i < z.i[mem.O_LAM0] + m or 0 <= z.i[mem.O_R0] <= i < z.i[mem.O_R0] + n:
        return 1.0 / 3.0
    if 0 <= z.i[mem.O_LAM1] <= i < z.i[mem.O_LAM1] + m or 0 <= z.i[mem.O_R1] <= i < z.i[mem.O_R1] + n:
        return 2.0 / 3.0
    return 0.5


@compiled
def lagrange(t: Any, a: Any, b: Any, c: Any, quadratic: Any) -> Any:
    """Weights of values at ``a``, ``b`` and, if ``quadratic``, ``c`` in the polynomial through them at ``t``."""
    if not quadratic:
        return (t - b) / (a - b), (t - a) / (b - a), 0.0
    of_a, of_b = (t - b) * (t - c) / ((a - b) * (a - c)), (t - a) * (t - c) / ((b - a) * (b - c))
    return of_a, of_b, 1.0 - of_a - of_b


@compiled
def best_degree(z: Any, count: Any) -> Any:
    """Degree of the extrapolation over ``count`` earlier steps that would have predicted the last unknowns best."""
    last, earlier, lam0, lam1, m = part(z, mem.X_LAST), part(z, mem.X_EARLIER), z.i[mem.O_LAM0], z.i[mem.O_LAM1], z.i[mem.M]
    size = last.size
    e0 = e1 = e2 = e3 = e4 = 0.0
    for i in range(size):  # backward differences: the error of degree k is the one of order k + 1
        b, c, d, e, f = earlier[i], earlier[size + i], earlier[2 * size + i], earlier[3 * size + i], earlier[4 * size + i]
        a, b, c, d, e = last[i] - b, b - c, c - d, d - e, e - f
        e0 = max(e0, abs(last[i] - earlier[lam1 + i - lam0]) if 0 <= lam0 <= i < lam0 + m else abs(a))
        a, b, c, d = a - b, b - c, c - d, d - e
        e1 = max(e1, abs(a))
        a, b, c = a - b, b - c, c - d
        e2 = max(e2, abs(a))
        a, b = a - b, b - c
        e3 = max(e3, abs(a))
        e4 = max(e4, abs(a - b))
    best, least = 0, e0
    if count > 1 and e1 < least:
        best, least = 1, e1
    if count > 2 and e2 < least:
        best, least = 2, e2
    if count > 3 and e3 < least:
        best, least = 3, e3
    return 4 if count > 4 and e4 < least else best


@compiled
def plain_guess(z: Any, level: Any) -> None:
    """Predict the unknowns from the state alone: its accelerations, and [lam, mu, v'] stored at address ``level``."""
    x, f, n, m, p = part(z, mem.X), part(z, mem.F), z.i[mem.N], z.i[mem.M], z.i[mem.P]
    lam, vdot = view(z.w, level, m), view(z.w, level + m + p, n)
    for i in range(x.size):
        x[i] = 0.0
    put(x, 0, part(z, mem.A))
    for i in range(n):
        reaction = vdot[i] - f[i] if m == 0 or p == 0 else 0.0  # of both kinds together only the sum is known
        if z.i[mem.O_R0] >= 0:
            x[z.i[mem.O_R0] + i] = reaction
        if z.i[mem.O_R1] >= 0:
            x[z.i[mem.O_R1] + i] = reaction
        if z.i[mem.O_RK] >= 0:
            x[z.i[mem.O_RK] + i] = reaction
    if z.i[mem.O_LAM0] >= 0:
        put(x, z.i[mem.O_LAM0], lam)
    if z.i[mem.O_LAM1] >= 0:
        put(x, z.i[mem.O_LAM1], lam)
    applied, ahead = part(z, mem.LAM_APPLIED), part(z, mem.LAM_AHEAD)
    for i in range(ahead.size):
        x[z.i[mem.O_LAM0] + i] -= applied[i]  # (H55)
        x[z.i[mem.O_LAM1] + i] -= ahead[i]
    if z.i[mem.O_MU] >= 0:
        put(x, z.i[mem.O_MU], view(z.w, level + m, p))


@compiled
def attempt(z: Any, h: Any, t1: Any, retried: Any, counts: Any) -> Any:
    """Try a step of h [s] to t1; returns its ending code, results in X, END and ATTEMPT.

    If ``retried``, a failure is tried again from the plain guess with fresh matrices: undamped, as turning stiff springs
    need, then damped, as nearly discontinuous friction needs.
    """
    number, tried = part(z, mem.NUMBER), part(z, mem.ATTEMPT)
    size_q, size_v, acceleration = number[mem.SIZE_Q], number[mem.SIZE_V], largest(part(z, mem.VDOT))
    tried[mem.H_TRIED], tried[mem.T_END] = h, t1
    if h * h == 0.0:  # multipliers over h^2 would overflow
        return mem.NO_ADVANCE
    step = part(z, mem.STEP)
    step[0], step[1] = h, t1
    step[2], step[3], step[4] = start_weights(z, h)
    look_ahead(z, acceleration)
    early(z)
    accelerations, typical = max(acceleration, largest(part(z, mem.F)), largest(part(z, mem.A))), part(z, mem.TYPICAL)
    typical[0], typical[1] = typical_sizes(abs(h), size_q, size_v, accelerations)
    tried[mem.ROOT_TOLERANCE] = tried[mem.LEAPS] = 0.0
    level, stored = z.i[2 * mem.LAM], int(number[mem.FACTOR])
    guess(z, h)
    ended, lu, rate = newton(z, stored, h, counts)
    ended = finished(z, ended, t1, counts)
    if ended not in (mem.CONVERGED, mem.SPENT):
        counts[mem.RESTARTS] += 1
    if retried and ended not in (mem.CONVERGED, mem.SPENT):
        early(z)  # it may have held the one value that was not finite
        level = multipliers_anew(z, h, counts)
        plain_guess(z, level)
        ended, lu, rate = restarted(z, stored, h, False, counts)
        ended = finished(z, ended, t1, counts)
    if retried and ended not in (mem.CONVERGED, mem.SPENT):
        early(z)
        plain_guess(z, level)
        ended, lu, rate = restarted(z, stored, h, True, counts)
        ended = finished(z, ended, t1, counts)
    tried[mem.SLOT], tried[mem.CONTRACTION] = lu, rate
    return ended


@compiled
def look_ahead(z: Any, acceleration: Any) -> None:
    """Extrapolate the multipliers of (H55) to the step's end, if the method does; ``acceleration``: largest |v'| now."""
    ahead, number = part(z, mem.LAM_AHEAD), part(z, mem.NUMBER)
    if ahead.size == 0:
        return
    known = number[mem.H] == 0.0 or tells_multipliers(number[mem.H], number[mem.SIZE_Q], acceleration)
    put(ahead, 0, view(z.w, z.i[2 * (mem.LAM if known else mem.LAM_APPLIED)], ahead.size))


@compiled
def multipliers_anew(z: Any, h: Any, counts: Any) -> Any:
    """Address of [lam, mu, v'] for a guess; solved for again after a far shorter step, where they are roundoff over h^2.

    Only the guess uses them: error estimates compare with those of the last step.
    """
    place, last = part(z, mem.PLACE), abs(part(z, mem.NUMBER)[mem.H])
    if z.i[mem.M] + z.i[mem.P] > 0 and 0.0 < last < MUCH_SHORTER * abs(h):
        place[0] = part(z, mem.NUMBER)[mem.T]
        put(place, put(place, 1, part(z, mem.Q)), part(z, mem.V))
        if acceleration_level(z, z.i[2 * mem.LAM], counts):
            return z.i[2 * mem.ACCELERATION_LEVEL] + 1
    return z.i[2 * mem.LAM]


@compiled
def finished(z: Any, ended: Any, t1: Any, counts: Any) -> Any:
    """Compute the state at the end of the step into END and check it; returns the final ending code.

    Also after a failure: the place shows which function is not finite.
    """
    compute_end(z)
    if ended == mem.CONVERGED and z.i[mem.VARIABLE]:
        place = part(z, mem.PLACE)
        place[0] = t1
        put(place, 1, part(z, mem.END)[: z.i[mem.N]])
        call(z, mem.C_INVERSE_MASS, mem.END_INVERSE_MASS, (address(z, mem.PLACE), address(z, mem.PLACE) + 8))
    if ended == mem.CONVERGED and not finite(part(z, mem.END_INVERSE_MASS)):
        ended = mem.NONFINITE
    if ended == mem.CONVERGED and z.i[mem.CALLS_PYTHON] and not finite(part(z, mem.END)):
        ended = mem.NONFINITE
    if ended == mem.CONVERGED and z.i[mem.M] > 0 and switches_branch(z):
        ended = mem.DIVERGED
    if ended == mem.NONFINITE:
        counts[mem.NONFINITES] += 1
    return ended


@compiled
def switches_branch(z: Any) -> Any:
    """True if the step has jumped to another branch of the constraints, where velocities and forces do not lead, (H58)."""
    n, q, v, end, off = z.i[mem.N], part(z, mem.Q), part(z, mem.V), part(z, mem.END), part(z, mem.LEAP)
    tried = part(z, mem.ATTEMPT)
    for i in range(n):
        off[i] = end[i] - q[i] - 0.5 * tried[mem.H_TRIED] * (v[i] + end[n + i])
    if branch_switch(z) < 0:
        return False
    put(part(z, mem.ERROR), 0, off[:n])
    given = address(z, mem.NUMBER), address(z, mem.ERROR), address(z, mem.END), address(z, mem.ATTEMPT)
    call_python(z, mem.C_LEAP, mem.LEAP, given)
    tried[mem.LEAPS] = 1.0 + branch_switch(z)
    return tried[mem.LEAPS] > 0.0


@compiled
def branch_switch(z: Any) -> Any:
    """First coordinate whose entry of LEAP exceeds the bound (H58), or -1."""
    n, tried, typical, q, v = z.i[mem.N], part(z, mem.ATTEMPT), part(z, mem.TYPICAL), part(z, mem.Q), part(z, mem.V)
    end, off, vdot, h = part(z, mem.END), part(z, mem.LEAP), part(z, mem.VDOT), tried[mem.H_TRIED]
    most, share, departed = 0.0, 0.0, 0.0
    for i in range(n):
        bent = abs(h * (end[n + i] - v[i] - h * vdot[i]))
        most, share = max(most, bent), max(share, bent / max(abs(q[i]), abs(end[i]), TINY))
        departed = max(departed, abs(end[i] - q[i] - h * v[i]))
    factor, least = part(z, mem.CONSTANTS)[mem.LEAST_OFF], max(MIN_LEAP_OF_LARGEST * typical[0], MIN_LEAP_OF_BEND * departed)
    for i in range(n):
        bent, size = abs(h * (end[n + i] - v[i] - h * vdot[i])), max(abs(q[i]), abs(end[i]))
        if abs(off[i]) > max(factor * bent, factor * min(most, share * size), MIN_LEAP * size, least):
            return i
    return -1


@compiled
def accept(z: Any, row: Any) -> None:
    """Make the end of the attempt the current state, and write it to ``row`` in the layout of ``run.history.History``."""
    n, m, p, x, end, number = z.i[mem.N], z.i[mem.M], z.i[mem.P], part(z, mem.X), part(z, mem.END), part(z, mem.NUMBER)
    tried = part(z, mem.ATTEMPT)
    h, t1, lu = tried[mem.H_TRIED], tried[mem.T_END], int(tried[mem.SLOT])
    row[0], row[1] = t1, h
    remainder = z.i[mem.CONTROLLED] and tried[mem.ERROR_SIZE] < 0.0  # its unknowns are mostly roundoff
    earlier, last, lengths, size = part(z, mem.X_EARLIER), part(z, mem.X_LAST), part(z, mem.H_EARLIER), x.size
    known = min(number[mem.KNOWN] + 1.0, HIGHEST + 1.0)
    if known > 1.0:
        for i in range(HIGHEST * size - 1, size - 1, -1):
            earlier[i] = earlier[i - size]
        put(earlier, 0, last)
        for k in range(HIGHEST - 1, 0, -1):
            lengths[k] = lengths[k - 1]
        lengths[0] = number[mem.H]
    put(last, 0, x)
    k = put(row, 2, end[: 3 * n])
    start = x[z.i[mem.O_LAM0] : z.i[mem.O_LAM0] + m] if z.i[mem.O_LAM0] >= 0 else part(z, mem.LAM)  # those before the step
    k = put(row, k, start)
    applied = part(z, mem.LAM_APPLIED)
    for i in range(applied.size):
        row[k - m + i] += applied[i]  # (H55)
    put(row, k, end[4 * n : 4 * n + m + p])
    put(view(z.w, z.i[2 * mem.Q], 5 * n + m + p), 0, end[: 5 * n + m + p])
    put(part(z, mem.LAM_BEFORE), 0, part(z, mem.LAM_APPLIED))
    put(part(z, mem.LAM_APPLIED), 0, part(z, mem.LAM_AHEAD))
    if z.i[mem.VARIABLE]:
        put(part(z, mem.INVERSE_MASS), 0, part(z, mem.END_INVERSE_MASS))
    number[mem.T], number[mem.H], number[mem.KNOWN] = t1, h, 1.0 if remainder else known
    record = part(z, mem.RECORD + lu)
    record[mem.RATE] = 1.0 if tried[mem.MADE] > 1.0 else tried[mem.CONTRACTION]  # 1: a matrix at every iterate is needed
    record[mem.KEPT_COST] = tried[mem.COST]
    number[mem.FACTOR] = lu
    number[mem.SIZE_Q] = max(number[mem.SIZE_Q], largest(end[:n]))
    number[mem.SIZE_V] = max(number[mem.SIZE_V], largest(end[n : 2 * n]))
