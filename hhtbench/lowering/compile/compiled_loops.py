"""``make loops``: compile the entries of :mod:`~hhtbench.lowering.compile.loops` with Numba; for development only.

An entry's arguments come as one row of eight-byte words, so that all entries are called alike and no wrapper of
Numba's, which would need Numba, is part of the object code.  The only file that uses Numba's code generator.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib
import json
import os
import sys
from collections.abc import Iterator
from itertools import count
from types import FunctionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

os.environ["NUMBA_CPU_NAME"] = "generic"  # read when Numba is imported
os.environ["NUMBA_CPU_FEATURES"] = ""

import llvmlite.binding as llvm  # type: ignore[import-untyped, unused-ignore]
import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]
from numba import types
from numba.core import cgutils
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numba.np import arrayobj

from hhtbench.lowering.compile.loops import (
    BITCODE,
    ENTRIES,
    ENTRY,
    MANIFEST,
    Entry,
    content_of,
    in_words,
)
from hhtbench.lowering.scalar_compiler.machine import from_bitcode

PLATFORMS = {"x86_64-linux": "x86_64-unknown-linux-gnu", "aarch64-linux": "aarch64-unknown-linux-gnu"}
WITHOUT_PYTHON: Any = {"error_model": "numpy", "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
NEEDED = {"sqrt", "pow", "memset", "memcpy", "memmove"}  # allowed external functions, of the C library


def dispatcher(function: Any, options: dict[str, Any]) -> Any:
    """Numba's dispatcher of ``function``, with the loops that it calls replaced by their dispatchers."""
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        if hasattr(names.get(name), "for_numba"):
            names[name] = names[name].for_numba()
    copy = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    return numba.njit(**WITHOUT_PYTHON, **options)(copy)


def bitcode(entry: Entry) -> bytes:
    """Optimised bitcode of ``int name(int64* result, void** error, int64* words)``.

    Raises
    ------
    TypeError
        The function returns something else than a whole number or None, or needs Numba when it runs.
    """
    called, taken = entry.for_numba(), _taken(numba.typeof(arguments_of(entry)))

    def flat(words: Any) -> Any:
        return called(*taken(words))

    made = numba.njit(**WITHOUT_PYTHON)(flat)
    with _lean():
        made.compile((types.intp,))
    (result,) = made.overloads.values()
    if result.signature.return_type not in (types.int64, types.none):
        raise TypeError(f"{entry.__name__} must return a whole number or None; it gives {result.signature}.")
    module = llvm.parse_bitcode(result.library._final_module.as_bitcode())
    module.get_function(result.fndesc.llvm_func_name).name = ENTRY
    parts = *module.functions, *module.global_variables
    outside = {part.name for part in parts if part.is_declaration and not part.name.startswith("llvm.")}
    strange = [name for name in outside - NEEDED if not hasattr(ctypes.pythonapi, name)]
    if strange:
        raise TypeError(f"{entry.__name__} needs Numba when it runs: {', '.join(strange)}.")
    return bytes(module.as_bitcode())


def write(entry: Entry) -> dict[str, Any]:
    """Write the object code of ``entry`` into its folder; returns its part of the manifest."""
    common, hashes = bitcode(entry), {}
    for kind, code in {
        BITCODE: common,
        **{name: from_bitcode(common, triple) for name, triple in PLATFORMS.items()},
    }.items():
        (entry.folder / f"{entry.__name__}.{kind}").write_bytes(code)
        hashes[kind] = hashlib.sha256(code).hexdigest()
    return {"layout": in_words(arguments_of(entry), []), "files": hashes}


def write_all(found: list[Entry]) -> None:
    """Write object code and manifests of ``found`` into their folders."""
    for folder in dict.fromkeys(entry.folder for entry in found):
        folder.mkdir(exist_ok=True)
        mine = [entry for entry in found if entry.folder == folder]
        made = {"content": content_of(mine[0].sources), "numba": numba.__version__, "llvm": list(llvm.llvm_version_info)}
        made["entries"] = {entry.__name__: write(entry) for entry in mine}
        (folder / MANIFEST).write_text(json.dumps(made, indent=1) + "\n")


@contextlib.contextmanager
def _lean() -> Iterator[None]:
    """Context in which Numba makes no machine code of single functions, which takes half of the time and is never called.

    Checks for negative indices are left out too: no loop counts from the end of an array.
    """
    codegen, looking = cpu_target.target_context.codegen(), arrayobj.fix_integer_index
    with global_compiler_lock:
        codegen._add_module = lambda module: None
        codegen.set_env = lambda name, env: None  # there is no global variable to set
        arrayobj.fix_integer_index = lambda context, builder, kind, index, _: context.cast(builder, index, kind, types.intp)
        try:
            yield
        finally:
            del codegen._add_module, codegen.set_env
            arrayobj.fix_integer_index = looking


def arguments_of(entry: Entry) -> tuple[Any, ...]:
    """Empty arguments of the entry's annotated types, from which Numba's types and the layout of the words are read."""
    hints = get_type_hints(entry.function, include_extras=True)
    return tuple(empty(kind) for name, kind in hints.items() if name != "return")


def empty(hint: Any) -> Any:
    """A value of an annotated type: an empty array, a zero, or a tuple of these."""
    if get_origin(hint) is Annotated:
        dtype, ndim = get_args(hint)[1:]
        return np.empty((0,) * ndim, dtype)
    if get_origin(hint) is tuple:
        return tuple(map(empty, get_args(hint)))
    if hasattr(hint, "_fields"):
        return hint(*map(empty, get_type_hints(hint, include_extras=True).values()))
    return hint()


def _taken(kind: Any) -> Any:
    """Intrinsic for compiled code: from the address of the words to a value of Numba type ``kind``."""

    def take(typingctx: Any, words: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            return _value(context, builder, kind, _words(builder, pointer))

        return kind(types.intp), generate

    return intrinsic(take)


def _words(builder: Any, pointer: Any) -> Iterator[Any]:
    """Yield generated loads of consecutive words of memory."""
    for at in count():
        yield builder.load(builder.gep(pointer, [ir.Constant(ir.IntType(64), at)]))


def _value(context: Any, builder: Any, kind: Any, words: Any) -> Any:
    """Generate a value of Numba type ``kind`` from the next ``words``; inverse of ``loops.in_words``."""
    if isinstance(kind, types.BaseTuple):
        parts = kind.types  # type: ignore[attr-defined]
        return context.make_tuple(builder, kind, [_value(context, builder, part, words) for part in parts])
    if isinstance(kind, types.Array):
        return _array(context, builder, kind, words)
    word = next(words)
    if kind == types.float64:
        return builder.bitcast(word, ir.DoubleType())
    return builder.icmp_signed("!=", word, ir.Constant(word.type, 0)) if kind == types.boolean else word


def _array(context: Any, builder: Any, kind: Any, words: Any) -> Any:
    array = arrayobj.make_array(kind)(context, builder)
    size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    data = builder.inttoptr(next(words), context.get_data_type(kind.dtype).as_pointer())
    shape = [next(words) for _ in range(kind.ndim)]
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    packed = {"shape": cgutils.pack_array(builder, shape), "strides": cgutils.pack_array(builder, strides)}
    arrayobj.populate_array(array, data=data, itemsize=size, meminfo=None, **packed)
    return array._getvalue()


if __name__ == "__main__":
    for module in sys.argv[1:]:
        importlib.import_module(module)
    write_all(ENTRIES)
