"""``native``: a function of arrays, and of a pytree that holds its parameters, as machine code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.counting import preparing
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.flattening import Flat, flat_function, jitted
from hhtbench.lowering.scalar_compiler import disk
from hhtbench.lowering.scalar_compiler.emit import CALL, ENTRY, Emitted, emit
from hhtbench.lowering.scalar_compiler.errors import NotNative, TooLarge
from hhtbench.lowering.scalar_compiler.lower import Lowered, Shapes, lower, pattern_of
from hhtbench.lowering.scalar_compiler.machine import generate, host, load
from hhtbench.lowering.scalar_compiler.stages import staged

FORMAT = 3  # of how object code is generated; part of the name of its file
MOST_OPERATIONS = 100_000  # tracing, lowering and generating them takes some ten seconds


@dataclass(frozen=True)
class Native:
    """Machine code of one function with the parameters of one dynamics."""

    address: int  #: of ``void f(double* out, const double* parameters, const double* a0, ...)``, one pointer per argument
    block_address: int  #: of ``void f(void** pointers)`` with all of those in a row
    parameters: np.ndarray  #: (k,) the dynamics' flattened parameters
    shape: tuple[int, ...]  #: of the result
    varying: np.ndarray  #: (v,) int64, flat places of the entries that depend on arguments or parameters
    constants: np.ndarray  #: (size,) values of the entries that do not; 0.0 at the others
    operations: int  #: scalar operations
    cached: bool  #: no code was generated: it was in memory or on disk

    @property
    def size(self) -> int:
        """Entries of the result."""
        return self.constants.size


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

    ``compact``: the result has the varying entries only.  ``stage``: "early" gives what depends on the last array only,
    "late" the result from all arrays and that, see :mod:`~.stages`.  ``rows``: a late stage gives only the entries from the
    first to before the second of a result (size,), so that several such parts share what the early stage gives.

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
    key = (flat.key, pattern.tobytes(), shapes, compact, stage, rows)

    def make() -> Native | NotNative:
        try:
            lowered = staged(_lowered(function, flat, pattern, shapes), stage, rows)
            return _compiled(_name(function), lowered, compact)
        except NotNative as error:
            return error

    known = key in _memory
    found: Native | NotNative = _memory.find(key, make)
    if isinstance(found, NotNative):
        raise found
    return replace(found, parameters=parameters, cached=known or found.cached)


def _name(function: Callable[..., Any]) -> str:
    return getattr(function, "__name__", "a function")


def _lowered(function: Callable[..., Any], flat: Flat, pattern: np.ndarray, shapes: Shapes) -> Lowered:
    """The scalar graph; that of the last function is remembered, for its other stage."""
    key = (flat.key, pattern.tobytes(), shapes)
    found: Lowered = _last.find(key, lambda: lower(_name(function), jitted(flat), pattern, shapes, MOST_OPERATIONS))
    return found


def _compiled(name: str, lowered: Lowered, compact: bool) -> Native:
    """Machine code, without the values of its parameters."""
    number = lowered.graph.number
    varying = np.flatnonzero([node not in number for node in lowered.outputs])
    constants = np.array([number.get(node, 0.0) for node in lowered.outputs], dtype=np.float64)
    outputs = [lowered.outputs[i] for i in varying.tolist()] if compact else lowered.outputs
    emitted = emit(lowered.graph, outputs, lowered.arguments)
    if emitted.operations > MOST_OPERATIONS:
        raise TooLarge(f"{emitted.operations} scalar operations, more than {MOST_OPERATIONS}")
    code, cached = _object_code(name, emitted)
    entry, call = load(code, ENTRY, CALL)
    return Native(entry, call, np.zeros(0), lowered.shape, varying, constants, emitted.operations, cached)


def _object_code(name: str, emitted: Emitted) -> tuple[bytes, bool]:
    """From disk by content, or generated: no key of other kind can tell what a function's value depends on."""
    content = "\0".join((str(FORMAT), host(), emitted.text, emitted.helpers))
    file = f"{hashlib.sha256(content.encode()).hexdigest()}.code"
    code = disk.read_file(file)
    if code is not None:
        return code, True
    try:
        with preparing(f"generating {name}"):
            code = generate(emitted.text, emitted.helpers, emitted.operations)
    except RuntimeError as error:  # LLVM's word for whatever it cannot do; another version may
        raise NotNative(f"LLVM does not generate code for it: {error}") from error
    disk.write_file(file, code)
    return code, False
