"""Sections of the loops' memory, and small loops over them; ``z`` is a :class:`~solvers.hht.native.tables.Memory`."""

from __future__ import annotations

from typing import Any

from solvers.hht.native.calls import view
from solvers.hht.native.compiled import compiled, inlined
from solvers.hht.native.tables import BASE, FLOATS, PIVOTS

INTEGER = len(FLOATS)


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
    return view(z.i, z.i[2 * (INTEGER + name)], z.i[2 * (INTEGER + name) + 1])


@inlined
def address(z: Any, name: Any) -> Any:
    """Where a section of floats begins in the machine's memory."""
    return z.i[BASE] + 8 * z.i[2 * name]


@inlined
def half_address(z: Any, name: Any, slot: Any) -> Any:
    """Where one of the two slots of a section begins in the machine's memory."""
    return z.i[BASE] + 8 * (z.i[2 * name] + slot * (z.i[2 * name + 1] // 2))


@compiled
def put(vector: Any, at: Any, source: Any) -> Any:
    """Copy ``source`` into ``vector`` from ``at``; returns the place behind it."""
    for i in range(source.size):
        vector[at + i] = source[i]
    return at + source.size


@compiled
def top(x: Any) -> Any:
    """Largest magnitude in ``x``; NaN if there is one."""
    size = 0.0
    for i in range(x.size):
        if not abs(x[i]) <= size:
            size = abs(x[i])
            if size != size:
                return size
    return size


@inlined
def half_of_pivots(z: Any, slot: Any) -> Any:
    """The pivots of one of the two slots."""
    count = z.i[2 * (INTEGER + PIVOTS) + 1] // 2
    return view(z.i, z.i[2 * (INTEGER + PIVOTS)] + slot * count, count)
