"""Access to sections of the loops' memory, calls by address, and small loops.

``z`` is a :class:`~solvers.kernel.memory.Memory`.  Of a pair of sections, for two factorisations, ``name + lu`` is one.
"""

from __future__ import annotations

import ctypes
import math
from functools import lru_cache
from typing import Any

from hhtbench.lowering.compile.loops import intrinsic
from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled, inlined

_SOURCE = "solvers.kernel.intrinsics"


@lru_cache
def _function_of(count: int) -> Any:
    return ctypes.PYFUNCTYPE(None, *[ctypes.c_void_p] * count)


def _invoke(address: int, pointers: tuple[int, ...]) -> None:
    _function_of(len(pointers))(int(address))(*map(int, pointers))


def _view(array: Any, start: int, count: int) -> Any:
    return array[start : start + count]


invoke: Any = intrinsic(_SOURCE, "invoke", _invoke)  #: (address, pointers) -> None
view: Any = intrinsic(_SOURCE, "view", _view)  #: (array of 8-byte entries, start, count) -> a part of it


@inlined
def part(z: Any, name: Any) -> Any:
    """View of a section of floats."""
    return view(z.w, z.i[2 * name], z.i[2 * name + 1])


@inlined
def indices(z: Any, name: Any) -> Any:
    """View of a section of integers."""
    return view(z.i, z.i[2 * (mem.INTEGER + name)], z.i[2 * (mem.INTEGER + name) + 1])


@inlined
def address(z: Any, name: Any) -> Any:
    """Machine address of a section of floats."""
    return z.i[mem.BASE] + 8 * z.i[2 * name]


@inlined
def index_address(z: Any, name: Any) -> Any:
    """Machine address of a section of integers."""
    return z.i[mem.INTEGER_BASE] + 8 * z.i[2 * (mem.INTEGER + name)]


@compiled
def put(vector: Any, at: Any, source: Any) -> Any:
    """Copy ``source`` into ``vector`` from index ``at``; returns the index behind it."""
    for i in range(source.size):
        vector[at + i] = source[i]
    return at + source.size


@compiled
def largest(x: Any) -> Any:
    """Largest magnitude in ``x``; NaN if an entry is."""
    size = 0.0
    for i in range(x.size):
        if not abs(x[i]) <= size:
            size = abs(x[i])
            if size != size:
                return size
    return size


@compiled
def finite(x: Any) -> Any:
    """True if ``x`` holds neither NaN nor infinity."""
    count = 0  # sums of integers are vectorised
    for i in range(x.size):
        count += 0 if abs(x[i]) < math.inf else 1
    return count == 0


@inlined
def call(z: Any, code: Any, out: Any, arguments: Any) -> None:
    """Call a system's function by its address; ``out`` is a section of floats, ``arguments`` are addresses."""
    if z.i[mem.CALLS_PYTHON]:
        call_python(z, code, out, arguments)
    else:
        invoke(z.i[code], (address(z, out), z.i[code + 1]) + arguments)  # noqa: RUF005 - Numba unpacks no tuples


@inlined
def call_python(z: Any, code: Any, out: Any, arguments: Any) -> None:
    """Call a function in Python by its address; after an exception or an interrupt the result is NaN."""
    erase(part(z, out))
    invoke(z.i[code], (address(z, out), z.i[code + 1]) + arguments)  # noqa: RUF005 - Numba unpacks no tuples


@compiled
def erase(x: Any) -> None:
    """Fill ``x`` with NaN."""
    for i in range(x.size):
        x[i] = math.nan


@compiled
def weighted_rms(x: Any, weights: Any) -> Any:
    """Root mean square of x over ``weights``; infinity if it is not finite."""
    total = 0.0
    for i in range(x.size):
        ratio = x[i] / weights[i]
        total += ratio * ratio  # a square by ** rounds otherwise in Python, once in a thousand
    return math.sqrt(total / x.size) if math.isfinite(total) else math.inf


@compiled
def spend(z: Any, counts: Any) -> Any:
    """Count one evaluation of the residual; False if the budget is spent."""
    if counts[mem.RESIDUALS] >= z.i[mem.EVALUATIONS]:
        return False
    counts[mem.RESIDUALS] += 1
    return True
