"""Whether nothing happens in a step: the looks that :mod:`solvers.hht.events` takes, in a compiled loop."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.native.calls import invoke
from solvers.hht.native.compiled import compiled, cubic
from solvers.hht.native.parts import address, indices, part, put
from solvers.hht.native.tables import (
    DIRECTIONS,
    END,
    EVENT,
    EVENT_CODE,
    EVENT_ENDS,
    EVENT_VALUES,
    LOOKS,
    NUMBER,
    PLACE,
    SAMPLES,
    N,
    Q,
    T,
    V,
)


@compiled
def quiet(z: Any, t1: Any, counts: Any) -> Any:
    """Whether no event function changes its sign in the attempt, in the direction asked for; the host engine finds where."""
    values, ends, directions, samples = (
        part(z, EVENT_VALUES),
        part(z, EVENT_ENDS),
        indices(z, DIRECTIONS),
        indices(z, SAMPLES),
    )
    for e in range(directions.size):
        before, looks = values[e], samples[e] + 1
        for k in range(1, looks + 1):
            value = look_at(z, e, t1, k, looks)
            counts[LOOKS] += 1
            if not math.isfinite(value):
                return False
            if before != 0.0 and not before * value > 0.0:
                falls = before > 0.0
                if directions[e] == 0 or (directions[e] < 0) == falls:
                    return False
            before = value
        ends[e] = before
    put(values, 0, ends)
    return True


@compiled
def look_at(z: Any, e: Any, t1: Any, k: Any, looks: Any) -> Any:
    """The value of event ``e`` at look ``k`` of ``looks`` along the step, the last at its end."""
    n, place, end, q, v, t0 = z.i[N], part(z, PLACE), part(z, END), part(z, Q), part(z, V), part(z, NUMBER)[T]
    h = t1 - t0
    place[0] = t1 if k == looks else t0 + k / looks * h
    s = (place[0] - t0) / h
    for i in range(n):
        if k == looks:
            place[1 + i], place[1 + n + i] = end[i], end[n + i]
        else:
            place[1 + i], place[1 + n + i] = cubic(s, h, q[i], end[i], v[i], end[n + i])
    at, code = address(z, PLACE), indices(z, EVENT_CODE)
    invoke(code[2 * e], (address(z, EVENT), code[2 * e + 1], at, at + 8, at + 8 + 8 * n))
    return part(z, EVENT)[0]
