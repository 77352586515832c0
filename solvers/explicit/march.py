"""Compiled loop of an explicit Runge-Kutta method: stages, projection, error control, output rows.

Error norms, controller and first step are SciPy's, so that both can be compared step by step; the error
is that of the step before its projection.  Stages do not notice a kink of a prescribed motion and estimate no error:
such a step is rejected by how far the projection moves it.
Accelerations come from the same machine code as HHT's, through the same memory.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from hhtbench.lowering.compile.loops import FloatArray, FloatMatrix, IntArray, entries
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import acceleration_level
from solvers.kernel.compiled import KERNEL, compiled, spacing
from solvers.kernel.memory import Memory
from solvers.kernel.projection import onto_constraints
from solvers.kernel.sections import address, call, finite, indices, part, put, view, weighted_rms

SAFETY, SHRINK, GROWTH = 0.9, 0.2, 10.0  # constants of SciPy's controller
FAR, TENTH = 100.0, 0.1  # projections further than so many tolerances, or sizes, are jumps; smooth problems reach half
NOISE = 1e-9  # relative moves up to which a projection may be roundoff of constraints with large constants
SPACINGS = 10.0  # shortest step in spacings of floating-point times

called = entries(Path(__file__).with_name("compiled"), *KERNEL, Path(__file__))


class Method(NamedTuple):
    """An embedded Runge-Kutta method of s stages, first same as last (FSAL)."""

    a: FloatMatrix  #: (s, s)
    b: FloatArray  #: (s,)
    c: FloatArray  #: (s,)
    errors: FloatMatrix  #: (2, s + 1) weights of the slopes in the error, and in a second estimate or zero
    exponent: float  #: exponent of the error in the controller


class Room(NamedTuple):
    """Work arrays of a run beside the kernel's memory, which holds RTOL, ATOL and the state y = [q; v] as Q and V."""

    slopes: FloatMatrix  #: (s + 1, 2n) y' at the stages and at the end
    stage: FloatArray  #: (2n,) y at a stage, and at the end before the projection
    end: FloatArray  #: (2n,) y at the accepted step's end, while rows inside it are computed
    mass: FloatArray  #: (n*n,) mass matrix
    sizes: FloatArray  #: (2n,) typical sizes of q and v, by which violations are measured
    times: FloatArray  #: (2,) the problem's times [s] at the loop's 0 and at its stop
    progress: IntArray  #: STEPS and ROWS of one call, OUTPUTS: evaluations for rows, and flags:


# OF_TIMES: rows at output times; BEGUN: the first step is chosen; PENDING: the last step still lacks rows.
STEPS, ROWS, OUTPUTS, OF_TIMES, BEGUN, PENDING = range(6)


@called
def march(z: Memory, k: Method, o: Room, stop: float, most: int, asked: FloatArray, rows: FloatMatrix) -> Any:
    """Take at most ``most`` steps towards ``stop`` [s], writing ``rows`` [t, y] while there is room; the ending code.

    One row per step, or only at the times ``asked``, which are ordered in the direction of the motion.
    """
    number, made, size = part(z, mem.NUMBER), o.progress, 2 * z.i[mem.N]
    y, end, counts = view(z.w, z.i[2 * mem.Q], size), part(z, mem.END)[:size], indices(z, mem.COUNTED)
    made[STEPS] = made[ROWS] = made[OUTPUTS] = 0
    if not made[BEGUN]:
        ended = begin(z, k, o, stop, counts)
        if ended != mem.CONVERGED:
            return ended
        made[BEGUN] = 1
    while number[mem.T] != stop and made[STEPS] < most:
        if not made[PENDING]:
            ended = controlled(z, k, o, stop, counts)
            if ended != mem.CONVERGED:
                return ended
            put(o.end, 0, end)
        made[PENDING] = 1
        t1 = part(z, mem.ATTEMPT)[mem.T_END]
        if o.progress[OF_TIMES]:
            ended = rows_inside(z, k, o, stop, asked, rows, counts)
            if ended != mem.CONVERGED:
                return ended
            if made[ROWS] < asked.size and abs(asked[made[ROWS]]) <= abs(t1):
                return mem.CONVERGED  # there was no room for all of them
        else:
            keep(o, rows, t1, o.end)
        put(y, 0, o.end)
        put(o.slopes[0], 0, o.slopes[k.b.size])
        number[mem.T] = t1
        made[PENDING] = 0
        made[STEPS] += 1
    return mem.CONVERGED


@compiled
def begin(z: Any, k: Any, o: Any, stop: Any, counts: Any) -> Any:
    """Slope at the start and length of the first step, Hairer, Norsett, Wanner section II.4; returns the ending code."""
    size, control, scale = o.stage.size, part(z, mem.CONTROL), part(z, mem.WEIGHTS)
    y, rtol, atol, slopes = view(z.w, z.i[2 * mem.Q], size), part(z, mem.RTOL), part(z, mem.ATOL), o.slopes
    put(part(z, mem.END), 0, y)
    if projected(z, o, o.times[0]) == mem.CONVERGED:  # the violation of a start is no jump
        put(y, 0, part(z, mem.END)[:size])
    ended = slope(z, slopes[0], o.times[0], y, counts)
    if ended != mem.CONVERGED:
        return ended
    for j in range(size):
        scale[j] = atol[j] + abs(y[j]) * rtol[j]
    large, fast = weighted_rms(y, scale), weighted_rms(slopes[0], scale)
    h = min(1e-6 if large < 1e-5 or fast < 1e-5 else 0.01 * large / fast, abs(stop))
    signed = math.copysign(h, stop)
    for j in range(size):
        o.stage[j] = y[j] + signed * slopes[0, j]
    ended, suggested = slope(z, slopes[1], clock(o, stop, signed), o.stage, counts), math.inf
    if ended == mem.SPENT:
        return ended
    if ended == mem.CONVERGED:
        for j in range(size):
            slopes[1, j] -= slopes[0, j]
        bent = weighted_rms(slopes[1], scale) / h
        largest = max(fast, bent)
        suggested = max(1e-6, h * 1e-3) if largest <= 1e-15 else (0.01 / largest) ** -k.exponent
    control[mem.H_NEXT] = min(100 * h, suggested, abs(stop))
    return mem.CONVERGED


@compiled
def keep(o: Any, rows: Any, t: Any, y: Any) -> None:
    """Write (t, y) to the next row."""
    row = rows[o.progress[ROWS]]
    row[0] = t
    put(row, 1, y)
    o.progress[ROWS] += 1


@compiled
def rows_inside(z: Any, k: Any, o: Any, stop: Any, asked: Any, rows: Any, counts: Any) -> Any:
    """Compute rows at output times within the accepted step, each by a shorter step from its start: as accurate."""
    t, t1, made, end = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)[mem.T_END], o.progress, part(z, mem.END)
    while made[ROWS] < min(rows.shape[0], asked.size) and abs(asked[made[ROWS]]) <= abs(t1):
        time = asked[made[ROWS]]
        if time == t1:
            keep(o, rows, time, o.end)
            continue
        before = counts[mem.RESIDUALS]
        ended = stages(z, k, o, time - t, counts)
        if ended == mem.CONVERGED:
            ended = projected(z, o, clock(o, stop, time))
        made[OUTPUTS] += counts[mem.RESIDUALS] - before
        if ended != mem.CONVERGED:
            return ended
        keep(o, rows, time, end[: o.end.size])
    return mem.CONVERGED


@compiled
def controlled(z: Any, k: Any, o: Any, stop: Any, counts: Any) -> Any:
    """Attempt steps, shorter each time, until the error of one is below 1; returns the ending code."""
    control, tried, t = part(z, mem.CONTROL), part(z, mem.ATTEMPT), part(z, mem.NUMBER)[mem.T]
    least = SPACINGS * spacing(abs(t))
    length, rejected, failed = max(control[mem.H_NEXT], least), False, mem.NO_ADVANCE
    while length >= least:
        t1 = t + math.copysign(length, stop - t)
        if abs(t1) > abs(stop):
            t1 = stop
        h = t1 - t
        tried[mem.H_TRIED], tried[mem.T_END] = h, t1
        ended = attempt(z, k, o, h, clock(o, stop, t1), counts)
        if ended == mem.SPENT:
            return mem.SPENT
        size = error_size(z, k, o, h) if ended == mem.CONVERGED else math.inf
        if size < 1.0 and moved_far(z, o, h):
            size = math.inf
        if not size < math.inf:  # also NaN, where squares of the error overflow
            size = math.inf
        factor = SAFETY * size**k.exponent if size > 0.0 else GROWTH
        if size < 1.0:
            factor = min(GROWTH, factor)
            control[mem.H_NEXT] = abs(h) * (min(1.0, factor) if rejected else factor)
            return mem.CONVERGED
        failed = ended if ended != mem.CONVERGED else mem.TOO_LARGE
        counts[mem.REJECTED] += 1
        length, rejected = abs(h) * max(SHRINK, factor), True
    return failed


@compiled
def attempt(z: Any, k: Any, o: Any, h: Any, t1: Any, counts: Any) -> Any:
    """Attempt a step of h [s] to the problem's t1: y into END, its slope last; returns the ending code."""
    ended = stages(z, k, o, h, counts)
    if ended == mem.CONVERGED:
        put(o.stage, 0, part(z, mem.END)[: o.stage.size])
        ended = projected(z, o, t1)
    return slope(z, o.slopes[k.b.size], t1, part(z, mem.END), counts) if ended == mem.CONVERGED else ended


@compiled
def stages(z: Any, k: Any, o: Any, h: Any, counts: Any) -> Any:
    """Compute the slopes of all stages but the first, and y at the step's end before its projection, into END."""
    size, y, end = o.stage.size, view(z.w, z.i[2 * mem.Q], o.stage.size), part(z, mem.END)
    t = part(z, mem.NUMBER)[mem.T] + o.times[0]
    for s in range(1, k.b.size):
        advanced(o, k.a[s], s, y, h, o.stage)
        ended = slope(z, o.slopes[s], t + k.c[s] * h, o.stage, counts)
        if ended != mem.CONVERGED:
            return ended
    advanced(o, k.b, k.b.size, y, h, end)
    scale, rtol, atol = part(z, mem.WEIGHTS), part(z, mem.RTOL), part(z, mem.ATOL)
    for j in range(size):
        scale[j] = atol[j] + max(abs(y[j]), abs(end[j])) * rtol[j]
    return mem.CONVERGED if finite(end[:size]) else mem.NONFINITE


@compiled
def advanced(o: Any, weights: Any, count: Any, y: Any, h: Any, to: Any) -> None:
    """Put y + h times the weighted sum of the first ``count`` slopes into ``to``."""
    size = o.stage.size
    for j in range(size):
        to[j] = 0.0
    for r in range(count):
        weight, slope_r = weights[r], o.slopes[r]
        if weight != 0.0:
            for j in range(size):
                to[j] += weight * slope_r[j]
    for j in range(size):
        to[j] = y[j] + h * to[j]


@compiled
def slope(z: Any, to: Any, t: Any, y: Any, counts: Any) -> Any:
    """Put y' = [v; v'] at the problem's time t [s] and y into ``to``; returns the ending code."""
    n, constraints, place, at = z.i[mem.N], z.i[mem.M] + z.i[mem.P], part(z, mem.PLACE), address(z, mem.PLACE)
    if counts[mem.RESIDUALS] >= z.i[mem.EVALUATIONS]:
        return mem.SPENT
    place[0] = t
    put(place, 1, y[: 2 * n])
    put(to, 0, y[n : 2 * n])
    if constraints > 0:
        if not acceleration_level(z, z.i[2 * mem.LAM], counts):
            return mem.SINGULAR
        put(to, n, part(z, mem.ACCELERATION_LEVEL)[1 + constraints :])
    else:
        counts[mem.RESIDUALS] += 1
        call(z, mem.C_FORCE, mem.FORCE, (at, at + 8, at + 8 + 8 * n))
        put(to, n, part(z, mem.FORCE)[:n])
    if finite(to):
        return mem.CONVERGED
    counts[mem.NONFINITES] += 1
    return mem.NONFINITE


@compiled
def clock(o: Any, stop: Any, t: Any) -> Any:
    """The problem's time [s] at ``t`` of the loop, which starts at 0."""
    return o.times[1] if t == stop else o.times[0] + t


@compiled
def error_size(z: Any, k: Any, o: Any, h: Any) -> Any:
    """Error of the attempt over the tolerances; two estimates combine as in Hairer, Norsett, Wanner, section II.10."""
    scale, a, b = part(z, mem.WEIGHTS), 0.0, 0.0
    for j in range(scale.size):
        first = second = 0.0
        for r in range(k.errors.shape[1]):
            first += k.errors[0, r] * o.slopes[r, j]
            second += k.errors[1, r] * o.slopes[r, j]
        first, second = first / scale[j], second / scale[j]
        a, b = a + first * first, b + second * second
    if a == 0.0 and b == 0.0:
        return 0.0
    return abs(h) * a / math.sqrt((a + 0.01 * b) * scale.size)


@compiled
def moved_far(z: Any, o: Any, h: Any) -> Any:
    """True if the projection moved the step as only a jump of a prescribed motion does, and a shorter step can help.

    That is q or v by more than ``FAR`` tolerances or a ``TENTH`` of its size, and q, or h times v, by more than the
    tolerance of q.  v itself jumps by the impulse however short the step is.
    """
    n, end, scale, far, seen = z.i[mem.N], part(z, mem.END), part(z, mem.WEIGHTS), False, False
    rtol = part(z, mem.RTOL)[0]
    most = min(max(FAR, NOISE / rtol), TENTH / rtol)
    for j in range(n):
        dq, dv = abs(end[j] - o.stage[j]), abs(end[n + j] - o.stage[n + j])
        far = far or dq > most * scale[j] or dv > most * scale[n + j]
        seen = seen or max(dq, abs(h) * dv) > scale[j]
    return far and seen


@compiled
def projected(z: Any, o: Any, t: Any) -> Any:
    """Project y in END onto both constraint levels at the problem's time t [s]; returns the ending code."""
    place, end, accepted = part(z, mem.PLACE), part(z, mem.END), view(z.w, z.i[2 * mem.Q], o.sizes.size)
    for j in range(o.sizes.size):  # constraints carry the roundoff of q and v
        o.sizes[j] = max(o.sizes[j], abs(accepted[j]))
    place[0] = t
    put(place, 1, end[: o.end.size])
    ended = onto_constraints(z, o.mass, o.sizes)
    if ended == mem.CONVERGED:
        put(end, 0, place[1:])
    return ended
