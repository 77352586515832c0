"""What one counted evaluation of the loops computes, so often in a row that it can be timed alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hhtbench.lowering.scalar_compiler import repeater
from solvers.hht.loops import memory as mem
from solvers.hht.loops.sections import address
from solvers.hht.run.loops import Loops


class Call(NamedTuple):
    """One of the system's functions as the loops call it: by its place in the header, with sections of the memory."""

    code: int
    out: int
    arguments: tuple[int, ...]


def evaluation(loops: Loops, counter: str) -> Callable[[int], None] | None:
    """``call(times)`` with what the memory holds, which is that of a step; None for what no function of the system is.

    A residual is that of an iterate, without what a step computes once.  Of a system of up to
    :data:`~solvers.hht.equations.corrections.SMALL` unknowns both hold the solve: code for it is one piece.
    """
    z, small = loops.z, loops.z.i[mem.KIND] == mem.KIND_INVERSE
    between = (mem.INVERSE, mem.MAPS) if small else ()
    calls = {
        "residual_evaluations": [
            Call(mem.C_RESIDUAL, mem.INCREMENT if small else mem.RESIDUAL, (mem.X, *between, mem.STEP, mem.EARLY)),
        ],
        "jacobian_evaluations": [
            Call(mem.C_EARLY_MATRIX, mem.EARLY_MATRIX, (mem.X, mem.STEP)),
            Call(mem.C_MATRIX, mem.FRESH if small else mem.COMPUTED, (mem.X, mem.STEP, mem.EARLY_MATRIX)),
        ],
    }.get(counter)
    if calls is None:
        return None

    def call(times: int) -> None:
        with loops.callbacks:
            for code, out, arguments in calls:
                if z.i[code]:  # functions in Python have no early stage
                    pointers = address(z, out), z.i[code + 1], *(address(z, section) for section in arguments)
                    repeater(len(pointers))(times, *map(int, (z.i[code], *pointers)))
        loops.raise_noted()

    return call
