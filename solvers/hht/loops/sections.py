"""Sections of the loops' memory, and small loops over them; ``z`` is a :class:`~solvers.hht.loops.memory.Memory`."""

from __future__ import annotations

import math
from typing import Any

from solvers.hht.loops import memory as mem
from solvers.hht.loops.calls import invoke, view
from solvers.hht.loops.compiled import compiled, inlined


@inlined
def part(z: Any, name: Any) -> Any:
    """The floats of a section."""
    return view(z.w, z.i[2 * name], z.i[2 * name + 1])


@inlined
def half(z: Any, name: Any, slot: Any) -> Any:
    """One of the two slots of a section of floats."""
    count = z.i[2 * name + 1] // 2
    return view(z.w, z.i[2 * name] + slot * count, count)


@inlined
def indices(z: Any, name: Any) -> Any:
    """The integers of a section."""
    return view(z.i, z.i[2 * (mem.INTEGER + name)], z.i[2 * (mem.INTEGER + name) + 1])


@inlined
def half_of_indices(z: Any, name: Any, slot: Any) -> Any:
    """One of the two slots of a section of integers."""
    count = z.i[2 * (mem.INTEGER + name) + 1] // 2
    return view(z.i, z.i[2 * (mem.INTEGER + name)] + slot * count, count)


@inlined
def address(z: Any, name: Any) -> Any:
    """Where a section of floats begins in the machine's memory."""
    return z.i[mem.BASE] + 8 * z.i[2 * name]


@inlined
def half_address(z: Any, name: Any, slot: Any) -> Any:
    """Where one of the two slots of a section of floats begins in the machine's memory."""
    return z.i[mem.BASE] + 8 * (z.i[2 * name] + slot * (z.i[2 * name + 1] // 2))


@inlined
def index_address(z: Any, name: Any, offset: Any) -> Any:
    """Where an entry of a section of integers stands in the machine's memory."""
    return z.i[mem.INTEGER_BASE] + 8 * (z.i[2 * (mem.INTEGER + name)] + offset)


@compiled
def put(vector: Any, at: Any, source: Any) -> Any:
    """Copy ``source`` into ``vector`` from ``at``; returns the place behind it."""
    for i in range(source.size):
        vector[at + i] = source[i]
    return at + source.size


@compiled
def largest(x: Any) -> Any:
    """Largest magnitude in ``x``; NaN if there is one."""
    size = 0.0
    for i in range(x.size):
        if not abs(x[i]) <= size:
            size = abs(x[i])
            if size != size:
                return size
    return size


@compiled
def finite(x: Any) -> Any:
    """Whether ``x`` holds neither NaN nor infinity."""
    total = 0.0
    for i in range(x.size):
        total += x[i] * 0.0
    return total == 0.0


@inlined
def call(z: Any, code: Any, out: Any, arguments: Any) -> None:
    """Call one of the system's functions by its address; ``out`` is a section of floats, ``arguments`` are addresses."""
    if z.i[mem.CALLS_PYTHON]:
        call_python(z, code, out, arguments)
    else:
        invoke(z.i[code], (address(z, out), z.i[code + 1]) + arguments)  # noqa: RUF005 - Numba unpacks no tuples


@inlined
def call_python(z: Any, code: Any, out: Any, arguments: Any) -> None:
    """The same of a function in Python, which writes its result last: after an exception or an interrupt it is NaN."""
    erase(part(z, out))
    invoke(z.i[code], (address(z, out), z.i[code + 1]) + arguments)  # noqa: RUF005 - Numba unpacks no tuples


@compiled
def erase(x: Any) -> None:
    """Every entry becomes NaN."""
    for i in range(x.size):
        x[i] = math.nan
