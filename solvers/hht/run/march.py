"""The compiled loop over steps: everything between two states that needs no Python."""

from __future__ import annotations

from typing import Any

from hhtbench.lowering.compile.loops import FloatArray, FloatMatrix
from solvers.hht.control.controller import ControlOptions, advance, conclude
from solvers.hht.control.estimate import estimate
from solvers.hht.events.scan import scan
from solvers.hht.sources import called
from solvers.hht.step.attempt import attempt
from solvers.kernel import memory as mem
from solvers.kernel.linear.matrix import early, renew
from solvers.kernel.memory import Memory
from solvers.kernel.sections import indices, part, put, view


@called
def march(z: Memory, o: ControlOptions, stop: float, lengths: FloatArray, ends: FloatArray, rows: FloatMatrix) -> Any:
    """Take at most ``len(rows)`` accepted steps; returns their number, and the ending code in ENDED.

    Of ``lengths`` (k,) [s] to ``ends`` (k,), or under error control towards ``stop`` [s] with an error (H26) of at most 1.
    """
    counts, z.i[mem.ENDED] = indices(z, mem.COUNTED), mem.CONVERGED
    for i in range(rows.shape[0]):
        if z.i[mem.CONTROLLED] and part(z, mem.NUMBER)[mem.T] == stop:
            return i
        k = 0 if z.i[mem.CONTROLLED] else i
        z.i[mem.ENDED] = advance(z, o, stop, lengths[k], ends[k], rows[i], counts)
        if z.i[mem.ENDED] != mem.CONVERGED:
            return i
    return rows.shape[0]


@called
def try_step(z: Memory, h: float, t1: float) -> Any:
    """Attempt a step of h [s] to t1 without accepting it; returns the ending code and keeps the factorisation."""
    ended = attempt(z, h, t1, True, indices(z, mem.COUNTED))
    if ended == mem.CONVERGED:
        part(z, mem.NUMBER)[mem.FACTOR] = part(z, mem.ATTEMPT)[mem.SLOT]
    return ended


@called
def look(z: Memory) -> Any:
    """Scan the attempt for events; returns the code of :func:`~solvers.hht.events.scan.scan`."""
    return scan(z, indices(z, mem.COUNTED))


@called
def take(z: Memory, row: FloatMatrix, located: bool) -> None:
    """Accept the attempt; if root location ``located`` its end, with a new matrix there and its error."""
    tried, counts, spare = part(z, mem.ATTEMPT), indices(z, mem.COUNTED), 1 - max(int(part(z, mem.NUMBER)[mem.FACTOR]), 0)
    if located:
        early(z)
        made = renew(z, spare, tried[mem.H_TRIED], counts) == mem.CONVERGED
        tried[mem.SLOT], tried[mem.CONTRACTION] = spare if made else part(z, mem.NUMBER)[mem.FACTOR], 0.0
    if located and z.i[mem.CONTROLLED]:
        tried[mem.ERROR_SIZE] = estimate(z, counts)
    conclude(z, row[0], counts)


@called
def remake(z: Memory, made_at: FloatArray) -> Any:
    """Recompute the factorisation of a saved state into the first place; the state in memory is lost."""
    size, counts = part(z, mem.X).size, indices(z, mem.COUNTED)
    at = 2 * size + 1
    put(part(z, mem.X), 0, made_at[:size])
    put(part(z, mem.PREVIOUS), 0, made_at[size:at])
    put(view(z.w, z.i[2 * mem.STEP], made_at.size - at), 0, made_at[at:])
    early(z)
    return renew(z, 0, made_at[at], counts)
