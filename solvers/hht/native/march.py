"""Many steps in one compiled loop, prescribed or controlled by the error; it stops where the host engine must look.

``z`` is the :class:`~solvers.hht.native.tables.Memory` that holds state and system, ``counts`` the counters.
"""

from __future__ import annotations

import math
from typing import Any

from hhtbench.lowering.compile.loops import FloatArray, FloatMatrix, IntArray
from solvers.hht.kernels import called
from solvers.hht.laws import CRUMB
from solvers.hht.native.calls import spacing
from solvers.hht.native.compiled import compiled, fit, growth, representable
from solvers.hht.native.estimate import estimate
from solvers.hht.native.parts import part, put
from solvers.hht.native.quiet import quiet
from solvers.hht.native.step import accept, attempt
from solvers.hht.native.tables import (
    ACCELERATION,
    BEFORE,
    CONVERGED,
    FACTOR,
    H_NEXT,
    HAS_ROLLING,
    LAST,
    LAST_ERROR,
    MEMORY,
    NUMBER,
    O_RK,
    RAW,
    REJECTED,
    ROLLING,
    USES,
    Control,
    Memory,
    N,
    P,
    T,
    X,
)


@called
def march(
    z: Memory, c: Control, lengths: FloatArray, ends: FloatArray, rows: FloatMatrix, counts: IntArray, before: IntArray
) -> Any:
    """At most as many steps as there are ``rows``; returns how many were made.

    Of ``lengths`` (k,) [s] to ``ends`` (k,), or towards ``c.stop`` with an error (H26) of at most 1 where ``c.controlled``.
    """
    for i in range(rows.shape[0]):
        if c.controlled and part(z, NUMBER)[T] == c.stop:
            return i
        for k in range(counts.size):
            before[k] = counts[k]
        slot = int(part(z, NUMBER)[FACTOR])
        uses = part(z, USES)[slot] if slot >= 0 else 0.0
        k = 0 if c.controlled else i
        if not one(z, c, lengths[k], ends[k], rows[i], counts):
            for k in range(counts.size):  # the host engine makes this step, and counts it
                counts[k] = before[k]
            if slot >= 0:
                part(z, USES)[slot] = uses
            return i
    return rows.shape[0]


@compiled
def one(z: Any, c: Any, length: Any, end: Any, row: Any, counts: Any) -> Any:
    """The next accepted step, as the host's controls take it; False: the host engine must, from the same state."""
    memory, t = part(z, MEMORY), part(z, NUMBER)[T]
    h, t1, asked, size, rejected = length, end, 0.0, 0.0, 0
    smallest = 0.0
    if c.controlled:
        smallest = abs(representable(t, math.copysign(max(c.min_step, c.spacings * spacing(abs(t))), c.stop - t)))
        h = max(min(memory[H_NEXT], c.max_step), c.min_step)
    while True:
        if c.controlled:
            h = representable(t, math.copysign(h, c.stop - t))
            asked = abs(h)
            h, t1 = fit(t, h, c.stop, c.min_step)
        if t + h == t or t1 == t or (rejected == 0 and abs(h) < CRUMB * asked):
            return False
        ended, slot, rate = attempt(z, h, t1, counts)
        if ended != CONVERGED:
            return False
        if not c.controlled:
            break
        size = estimate(z, h, t1, slot)
        if size <= 1.0:
            break
        counts[REJECTED] += 1
        if abs(h) <= smallest:
            return False
        factor = max(c.shrink, (c.target / size) ** (1 / 3)) if rejected == 0 else c.shrink
        h, rejected = max(abs(h) * factor, smallest), rejected + 1
    if c.watching and not quiet(z, t1, counts):
        return False
    if c.controlled:
        h_next = abs(h) * growth(c, size, memory[LAST_ERROR], rejected > 0)
        remember(z, max(h_next, asked) if abs(h) < asked else h_next, h, size)
    accept(z, h, t1, slot, rate, row)
    return True


@compiled
def remember(z: Any, h_next: Any, h: Any, size: Any) -> None:
    """What the next step's estimate and the controller need, :func:`solvers.hht.estimate.remembered`."""
    n, memory = z.i[N], part(z, MEMORY)
    memory[H_NEXT], memory[LAST], memory[LAST_ERROR] = h_next, h, size
    put(part(z, BEFORE), 0, part(z, ACCELERATION))
    put(part(z, ACCELERATION), 0, part(z, RAW)[2 * n : 3 * n])
    if z.i[P] > 0:
        memory[HAS_ROLLING] = 1.0
        put(part(z, ROLLING), 0, part(z, X)[z.i[O_RK] : z.i[O_RK] + n])
