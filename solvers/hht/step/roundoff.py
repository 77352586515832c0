"""What roundoff makes of an increment of Newton's iteration, measured where it matters, (H30); counted evaluations."""

from __future__ import annotations

from typing import Any

from solvers.hht.equations.formulas import EPS
from solvers.hht.linear.matrix import correct, early, moved_by
from solvers.hht.loops import memory as mem
from solvers.hht.loops.compiled import compiled, digits, has_digit
from solvers.hht.loops.sections import part, put, view
from solvers.hht.step.stopping import scaled

DRAWN = 2654435761, 15  # bits of products with the golden ratio: a random subset that is the same everywhere


@compiled
def spend(z: Any, counts: Any) -> Any:
    """One more evaluation of the residual; False where none is left."""
    if counts[mem.RESIDUALS] >= z.i[mem.EVALUATIONS]:
        return False
    counts[mem.RESIDUALS] += 1
    return True


@compiled
def corrected(z: Any, slot: Any, code: Any, evaluated: Any, counts: Any) -> Any:
    """A counted correction by ``code``."""
    counts[mem.SOLVES] += 1
    return correct(z, slot, code, evaluated)


@compiled
def is_roundoff(z: Any, slot: Any, moved: Any, counts: Any) -> Any:
    """Whether an increment that a matrix at the iterate did not shrink is of the size that roundoff makes it, (H30)."""
    o, evaluations = part(z, mem.CONSTANTS), 2 * digits(z.i[mem.N])
    if moved <= o[mem.STAGNATION] or counts[mem.RESIDUALS] + evaluations >= z.i[mem.EVALUATIONS]:
        return moved <= o[mem.STAGNATION]
    counts[mem.RESIDUALS] += evaluations
    counts[mem.SOLVES] += evaluations
    in_q, in_v = noise(z, slot, 0, evaluations)
    return moved <= o[mem.NOISE_MARGIN] * scaled(z, in_q, in_v)


@compiled
def noise(z: Any, slot: Any, first: Any, end: Any) -> Any:
    """The largest that roundoff of some entries of q, v, a, f changes in the increment, by its changes of q1 and of v1.

    Looked at is one roundoff of those entries whose number has the binary digit k // 2 equal to k % 2, (H30), for every k
    from ``first`` to ``end``, or for k = -1 a random subset of them; all away from zero, since the roundoff of
    regular values is not of both signs alike.
    """
    n, state, before = z.i[mem.N], view(z.w, z.i[2 * mem.Q], 4 * z.i[mem.N]), part(z, mem.UNDISTURBED)
    increment, full, in_q, in_v = part(z, mem.INCREMENT), part(z, mem.FULL), 0.0, 0.0
    put(before, 0, state)
    put(full, 0, increment)
    for k in range(first, end):
        for i in range(state.size):
            moves = (i * DRAWN[0] >> DRAWN[1]) % 2 == 1 if k < 0 else has_digit(i % n, k // 2, k % 2)
            state[i] = before[i] * (1.0 + EPS) if moves else before[i]
        early(z)
        correct(z, slot, mem.C_RESIDUAL, False)
        for i in range(part(z, mem.X).size):
            increment[i] -= full[i]
        of_q, of_v = moved_by(z, slot, increment)
        in_q, in_v = max(in_q, of_q), max(in_v, of_v)
    put(state, 0, before)
    put(increment, 0, full)
    early(z)
    return in_q, in_v


@compiled
def unmeasured(z: Any) -> None:
    """Neither sizes that increments are measured by are known, nor roundoff."""
    noise = part(z, mem.NOISE)
    part(z, mem.RECIPROCAL)[0] = 0.0
    noise[0] = noise[1] = -1.0
