"""``native``: a derived function of a JAX dynamics as machine code."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hhtbench.counting import preparing
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.flattening import Flat, flat_function, jitted
from hhtbench.lowering.scalar_compiler import disk
from hhtbench.lowering.scalar_compiler.code import Code, compiled, write
from hhtbench.lowering.scalar_compiler.emit import CALL, ENTRY
from hhtbench.lowering.scalar_compiler.machine import load
from hhtbench.lowering.scalar_compiler.reading import Reading, Shapes, pattern_of, read
from hhtbench.lowering.scalar_compiler.reasons import NotNative
from hhtbench.lowering.scalar_compiler.stages import staged

MOST_OPERATIONS = 100_000  # tracing, lowering and generating them takes some ten seconds


@dataclass(frozen=True)
class Native:
    """Machine code of one function with the parameters of one dynamics."""

    address: int  #: of ``void f(double* out, const double* parameters, const double* a0, ...)``, one pointer per argument
    block_address: int  #: of ``void f(void** pointers)`` with all of those in a row
    parameters: np.ndarray  #: (k,) the dynamics' flattened parameters
    size: int  #: entries of the result
    shape: tuple[int, ...]  #: of the result
    varying: np.ndarray  #: (v,) int64, flat places of the entries that depend on arguments or parameters
    constants: np.ndarray  #: (size,) values of the entries that do not; 0.0 at the others
    compact: bool  #: True: ``out`` has the varying entries only; False: all of them
    operations: int  #: scalar operations
    seconds: dict[str, float] = field(default_factory=dict)  #: trace, lower, generate, load
    cached: bool = False  #: no code was generated: it was in memory or on disk


class _Loaded(NamedTuple):
    code: Code
    addresses: tuple[int, ...]
    seconds: dict[str, float]
    cached: bool


_memory, _last = Cache(4096), Cache(1)


def native(
    function: Callable[..., Any],
    dynamics: Any,
    *static: Any,
    shapes: Shapes,
    compact: bool = False,
    stage: str = "whole",
    rows: tuple[int, int] | None = None,
) -> Native:
    """``function(dynamics, *static, *arrays) -> array`` as machine code for float64 arrays of ``shapes``.

    One piece of code serves all parameter values but exact 0, 1 and -1, which are folded: a full mass matrix that is
    diagonal costs n products and not n^2.

    ``stage``: "early" gives what depends on the last array only, "late" the result from all arrays and that, see
    :mod:`~.stages`.  ``rows``: a late stage gives only the entries from the first to before the second of a result (size,),
    so that several such parts share what the early stage gives.

    Raises
    ------
    NotNative
        The text says why: which primitive has no rule and on which line, or how many operations there are.
    """
    flat = flat_function(function, dynamics, *static)
    parameters = np.ascontiguousarray(flat.parameters)
    if parameters.dtype != np.float64:
        raise NotNative(f"parameters of type {parameters.dtype}")
    shapes = tuple(tuple(int(size) for size in shape) for shape in shapes)
    pattern = pattern_of(parameters)
    kind = (compact, stage, rows)
    key = (flat.key, pattern.tobytes(), shapes, kind)
    name = getattr(function, "__name__", "a function")
    known = key in _memory
    loaded: _Loaded | NotNative = _memory.find(key, lambda: _made(name, flat, pattern, shapes, kind))
    if isinstance(loaded, NotNative):
        raise loaded
    return _bound(loaded, parameters, cached=known or loaded.cached)


def native_pieces() -> int:
    """How many functions this process has as machine code, or knows it cannot have."""
    return len(_memory)


def _bound(loaded: _Loaded, parameters: np.ndarray, *, cached: bool) -> Native:
    code = loaded.code
    return Native(
        address=loaded.addresses[0],
        block_address=loaded.addresses[1],
        parameters=parameters,
        size=code.constants.size,
        shape=code.shape,
        varying=code.varying,
        constants=code.constants,
        compact=code.compact,
        operations=code.operations,
        seconds=dict(loaded.seconds),
        cached=cached,
    )


def _made(
    name: str, flat: Flat, pattern: np.ndarray, shapes: Shapes, kind: tuple[bool, str, tuple[int, int] | None]
) -> _Loaded | NotNative:
    """Traced, then from disk by content, or generated: no key of other kind can tell what a function's value depends on."""
    compact, stage, rows = kind
    try:
        reading, taken = staged(_read(name, flat, pattern, shapes), shapes, stage, rows)
        written = write(reading, taken, compact=compact, limit=MOST_OPERATIONS)
    except NotNative as error:
        return error
    seconds = {"trace": reading.trace, "lower": reading.lower + written.seconds, "generate": 0.0}
    file = f"{written.content}.code"
    kept = disk.read_file(file)
    began = time.perf_counter()
    if kept is not None:
        code = Code.from_bytes(kept)
    else:
        try:
            with preparing(f"generating {name}"):
                code = compiled(written)
        except RuntimeError as error:  # LLVM's word for whatever it cannot do; another version may
            return NotNative(f"LLVM does not generate code for it: {error}")
        seconds["generate"] = time.perf_counter() - began
        disk.write_file(file, code.to_bytes())
    began = time.perf_counter()
    addresses = load(code.binary, ENTRY, CALL)
    seconds["load"] = time.perf_counter() - began
    return _Loaded(code, addresses, seconds, kept is not None)


def _read(name: str, flat: Flat, pattern: np.ndarray, shapes: Shapes) -> Reading:
    """The scalar graph; that of the last function is remembered, for its other stage."""
    key = (flat.key, pattern.tobytes(), shapes)
    found: Reading = _last.find(key, lambda: read(name, jitted(flat), pattern, shapes, MOST_OPERATIONS))
    return found
