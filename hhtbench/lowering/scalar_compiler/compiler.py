"""``native``: a function of arrays and a pytree of parameters as machine code; ``native_call`` calls it."""

from __future__ import annotations

import gc
import pickle
import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Concatenate

import numpy as np

from hhtbench.lowering.caching import Cache
from hhtbench.lowering.contents import lasting_key
from hhtbench.lowering.flattening import Flat, Tree, flat_function, jitted
from hhtbench.lowering.scalar_compiler.dependencies import needed, pattern
from hhtbench.lowering.scalar_compiler.emit import CALL, ENTRY, Emitted, emit
from hhtbench.lowering.scalar_compiler.lower import Lowered, Shapes, lower, pattern_of, staged
from hhtbench.lowering.scalar_compiler.machine import caller, generate, host, load
from hhtbench.lowering.scalar_compiler.store import CALLS, CODES, ZERO, Ids, NotNative, TooLarge
from hhtbench.runtime.disk_cache import kept_on_disk
from hhtbench.solution.counting import preparing

FORMAT = 4  # version of the generation of object code; part of the name of its file
MOST_OPERATIONS = 100_000  # written down: tracing, lowering and generating them takes some ten seconds
IN_LOOPS = 5_000  # operations from which equal ones are written as loops: a fifth of the time to generate, as fast to run
FLOAT = np.dtype(np.float64)


@dataclass(frozen=True)
class Native:
    """Machine code of one function with the parameters of one pytree."""

    address: int  #: of ``void f(double* out, const double* parameters, const double* a0, ...)``, one pointer per argument
    block_address: int  #: of ``void f(void** pointers)`` with all of those in a row
    parameters: np.ndarray  #: (k,) the pytree's flattened parameters
    shape: tuple[int, ...]  #: of the result
    varying: np.ndarray  #: (v,) int64, flat places of the entries that depend on arguments or parameters
    constants: np.ndarray  #: (size,) values of the entries that do not; 0.0 at the others
    operations: int  #: scalar operations

    @property
    def size(self) -> int:
        """Number of entries of the result."""
        return self.constants.size

    @property
    def pair(self) -> tuple[int, int]:
        """Addresses of the code and of its parameters."""
        return self.address, int(self.parameters.ctypes.data)


_memory, _last = Cache(4096), Cache(1)


def native(
    function: Callable[Concatenate[Tree, ...], Any],
    tree: Tree,
    *static: Hashable,
    shapes: Shapes,
    compact: bool = False,
    stage: str = "whole",
    rows: tuple[int, int] | None = None,
) -> Native:
    """Compile ``function(tree, *static, *arrays) -> array`` to machine code for float64 arrays of ``shapes``.

    The code serves all parameter values except exact 0, 1 and -1, which are folded: a full mass matrix that is
    diagonal costs n products and not n^2.
    ``compact``: the result has the varying entries only.  ``stage``: "early" returns what depends on the last array only,
    "late" the result from all arrays and that, see :mod:`~.lower`.  ``rows``: a late stage returns only this range of
    entries of a result (size,), so that several parts share one early stage.

    Raises
    ------
    NotNative
        The message says why: which primitive has no rule and on which line, or how many operations there are.
    """
    flat = flat_function(function, tree, *static)
    parameters = np.ascontiguousarray(flat.parameters)
    if parameters.dtype != np.float64:
        raise NotNative(f"parameters of type {parameters.dtype}")
    shapes = tuple(tuple(int(size) for size in shape) for shape in shapes)
    folded = pattern_of(parameters)
    key = flat.key, folded.tobytes(), shapes

    def generated() -> bytes:
        with _uncollected():  # the graph of the last function is remembered, for its other stage
            whole = _last.find(key, lambda: lower(flat.name, jitted(flat), folded, shapes, MOST_OPERATIONS))
            return pickle.dumps(_compiled(flat.name, staged(whole, stage, rows), compact))

    def make() -> Native | NotNative:
        what = function, tree, static, *key[1:], compact, stage, rows, FORMAT, host(), IN_LOOPS, MOST_OPERATIONS
        lasting = lasting_key(*what)
        try:
            return _loaded(*pickle.loads(generated() if lasting is None else kept_on_disk(lasting, "function", generated)))
        except NotNative as error:
            return error

    found: Native | NotNative = _memory.find((*key, compact, stage, rows), make)
    if isinstance(found, NotNative):
        raise found
    return replace(found, parameters=parameters)


def places_of(function: Callable[..., Any], tree: Any, *static: Any, shapes: Shapes) -> Any:
    """Flat indices of the entries that can differ from zero in the result of :func:`native`.

    Raises
    ------
    NotNative
        As :func:`native`.
    """
    return np.flatnonzero(_lowered(flat_function(function, tree, *static), shapes).outputs != ZERO)


def _lowered(flat: Flat, shapes: Shapes, *, free: bool = False) -> Lowered:
    """The scalar graph, with parameters of 0, 1 or -1 folded, or all of them ``free``."""
    folded = np.zeros(flat.parameters.size, dtype=np.int8) if free else pattern_of(np.asarray(flat.parameters))
    with _uncollected():
        return lower(flat.name, jitted(flat), folded, shapes, MOST_OPERATIONS)


def count_operations(function: Callable[..., Any], tree: Any, *static: Any, shapes: Shapes) -> int:
    """Number of scalar operations of one call of :func:`native`'s code, each computed once; a sine counts as one.

    Linear systems count as Gaussian elimination of full matrices.

    Raises
    ------
    NotNative
        As :func:`native`; or it solves a banded system, or calls a function in Python.
    """
    lowered = _lowered(flat_function(function, tree, *static), shapes)
    graph, live = lowered.graph, np.flatnonzero(needed(lowered.graph, lowered.outputs))
    codes = graph.column("code")[live]
    if np.isin(codes, [CODES["banded"], CODES["foreign"]]).any():
        raise NotNative("it holds operations that are not in the graph")
    solves = live[codes == CODES["solve"]]
    sizes, columns = graph.column("x")[solves].astype(np.int64), graph.column("y")[solves].astype(np.int64)
    factors = (sizes - 1) * sizes * (4 * sizes + 1) // 6  # the sum of j (1 + 2 j): a division, and a row times a column less
    inside = np.sum(factors + columns * sizes * (2 * sizes - 1))
    return int(np.count_nonzero(codes > CODES[CALLS[-1]]) + inside)


def pattern_along(flat: Flat, shapes: Shapes) -> tuple[tuple[int, int], Ids, Ids]:
    """Shape, rows and columns of the nonzeros of a flat function's derivative by its first array, a vector.

    Row by row, for any parameter values.

    Raises
    ------
    NotNative
        As :func:`native`.
    """
    lowered = _lowered(flat, shapes, free=True)
    return (lowered.outputs.size, shapes[0][0]), *pattern(lowered.graph, lowered.outputs, 0)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Context without garbage collection: a graph is a million tuples without cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _compiled(name: str, lowered: Lowered, compact: bool) -> tuple[Any, ...]:
    """Object code of a graph, and all that :class:`Native` says of it but addresses and parameters."""
    graph = lowered.graph
    known, constants = graph.column("code")[lowered.outputs] == CODES["constant"], np.zeros(lowered.outputs.size)
    constants[known] = graph.column("values")[graph.column("x")[lowered.outputs[known]]]
    varying = np.flatnonzero(~known)
    outputs = lowered.outputs[varying] if compact else lowered.outputs
    counts = needed(graph, outputs)
    if np.count_nonzero(counts) <= IN_LOOPS:
        emitted = emit(graph, outputs, lowered.arguments)
    else:
        from hhtbench.lowering.scalar_compiler.emit_loops import emit_loops  # imported for large systems only

        emitted = emit_loops(graph, outputs, lowered.arguments, counts, MOST_OPERATIONS)
    if emitted.operations > MOST_OPERATIONS:
        raise TooLarge(f"{emitted.operations} scalar operations, more than {MOST_OPERATIONS}")
    content = "\0".join((str(FORMAT), host(), emitted.text, emitted.helpers))
    code = kept_on_disk(content.encode(), "code", lambda: _generated(name, emitted))
    return code, lowered.shape, varying, constants, emitted.operations


def _loaded(code: bytes, *more: Any) -> Native:
    """Machine code from what :func:`_compiled` gives, without the values of its parameters."""
    entry, call = load(code, ENTRY, CALL)
    return Native(entry, call, np.zeros(0), *more)


def _generated(name: str, emitted: Emitted) -> bytes:
    try:
        with preparing(f"generating {name}"):
            return generate(emitted.text, emitted.helpers, emitted.operations)
    except RuntimeError as error:  # LLVM's word for whatever it cannot do; another version may
        raise NotNative(f"LLVM does not generate code for it: {error}") from error


def native_call(native: Native, shapes: Shapes) -> Callable[..., np.ndarray | None]:
    """``call(*arguments) -> new array``; None if an argument is no float or float64 array of its shape.

    A closure: a method of an object costs a tenth of a microsecond more.
    """
    code, memory, count = caller(native.block_address), _Memory(native, shapes), len(shapes)

    def call(*arguments: Any) -> np.ndarray | None:
        places, result = memory.places, memory.result
        if len(arguments) != count:
            return None
        for argument, (place, shape) in zip(arguments, places, strict=False):
            if type(argument) is np.ndarray:
                other = (
                    argument.dtype is not FLOAT and argument.dtype != FLOAT
                )  # an unpickled array's type is another object
                if other or argument.shape != shape:
                    return None
            elif shape or type(argument) is not float:
                return None
            place[...] = argument
        code(memory.block)
        return result.copy()

    return call


class _Memory(threading.local):
    """Memory of each thread: arguments are copied in, the result is copied out."""

    def __init__(self, native: Native, shapes: Shapes) -> None:
        self.places = [(np.zeros(shape), shape) for shape in shapes]  #: buffer and shape of every argument
        self.result = np.zeros(native.shape)
        arrays = self.result, native.parameters, *(place for place, _ in self.places)
        self.pointers = np.array([array.ctypes.data for array in arrays], dtype=np.uintp)
        self.block = self.pointers.ctypes.data  #: where the pointers to the result, the parameters and every argument lie
