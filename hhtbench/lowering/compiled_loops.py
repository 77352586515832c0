"""What Numba makes of the functions of :mod:`hhtbench.lowering.loops`; imported where something must be compiled.

An entry's arguments come as one row of eight-byte words, so that every entry is called in one way and no wrapper of
Numba's, which would need Numba, is part of its object code.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator
from types import FunctionType
from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped, unused-ignore]
import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]
from numba import types
from numba.core import cgutils
from numba.core import config as _config
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array
from numba.np.numpy_support import from_dtype

from hhtbench.lowering.caching import private_folder

config: Any = _config


def dispatcher(function: Any, options: dict[str, Any], **more: Any) -> Any:
    """Numba's function of ``function``, to whose code it refers by what Numba made of the loops that it calls."""
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        if hasattr(names.get(name), "for_numba"):
            names[name] = names[name].for_numba()
    copy = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    return numba.njit(**options, **more)(copy)


def kept_dispatcher(function: Any, options: dict[str, Any], content: str) -> Any:
    """The same, kept on disk by Numba under the name ``content``; in memory only where no folder can be written."""
    before, folder = config.CACHE_DIR, private_folder("loops")
    if folder is None:
        return dispatcher(function, options)
    config.CACHE_DIR = str(folder / content)
    try:
        return dispatcher(function, options, cache=True)
    except (RuntimeError, OSError):  # there is no folder that can be written
        return dispatcher(function, options)
    finally:
        config.CACHE_DIR = before


def object_code(function: Any, options: dict[str, Any], arguments: tuple[Any, ...], name: str) -> tuple[bytes, bool]:
    """Object code of ``int name(int64* result, void** error, int64* words)`` and whether Numba must be loaded with it.

    Raises
    ------
    TypeError
        ``function`` returns something else than a whole number or None.
    """
    called, taken = dispatcher(function, options), _taken(types.Tuple([_type(value) for value in arguments]))

    def entry(words: Any) -> Any:
        return called(*taken(words))

    made = numba.njit(**options)(entry)
    with _not_loaded():
        made.compile((types.intp,))
    (result,) = made.overloads.values()
    if result.signature.return_type not in (types.int64, types.none):
        raise TypeError(f"{function.__qualname__} must return a whole number or None; it gives {result.signature}.")
    module = llvm.parse_bitcode(result.library._final_module.as_bitcode())
    module.get_function(result.fndesc.llvm_func_name).name = name
    parts = *module.functions, *module.global_variables
    outside = [part.name for part in parts if part.is_declaration and not part.name.startswith("llvm.")]
    needs_numba = not all(hasattr(ctypes.pythonapi, symbol) for symbol in outside)
    return bytes(result.library._codegen._tm.emit_object(module)), needs_numba


@contextlib.contextmanager
def _not_loaded() -> Iterator[None]:
    """Numba makes no machine code of its own of every single function: half of the time, for what is never called."""
    codegen = cpu_target.target_context.codegen()
    with global_compiler_lock:
        codegen._add_module = lambda module: None
        codegen.set_env = lambda name, env: None  # there is no global variable to set
        try:
            yield
        finally:
            del codegen._add_module, codegen.set_env


def _type(value: Any) -> Any:
    """Numba's type of an argument, for the kinds of arguments that an entry takes."""
    if isinstance(value, np.ndarray):
        return types.Array(from_dtype(value.dtype), value.ndim, "C")
    if isinstance(value, tuple):
        return types.BaseTuple.from_types([_type(part) for part in value], None if type(value) is tuple else type(value))
    return types.boolean if isinstance(value, bool) else types.int64 if isinstance(value, int) else types.float64


def _taken(kind: Any) -> Any:
    """A function for compiled code: from the address of the words to a value of the type ``kind``."""

    def take(typingctx: Any, words: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            return _value(context, builder, kind, iter(_Words(builder, pointer)))

        return kind(types.intp), generate

    return intrinsic(take)


class _Words:
    """Words of memory, one after the other, in code that is being written."""

    def __init__(self, builder: Any, pointer: Any) -> None:
        self._builder, self._pointer = builder, pointer

    def __iter__(self) -> Any:
        at = 0
        while True:
            yield self._builder.load(self._builder.gep(self._pointer, [ir.Constant(ir.IntType(64), at)]))
            at += 1


def _value(context: Any, builder: Any, kind: Any, words: Any) -> Any:
    """Code for a value of the type ``kind`` from the next ``words``, the inverse of ``loops._in_words``."""
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
    array = make_array(kind)(context, builder)
    size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    data = builder.inttoptr(next(words), context.get_data_type(kind.dtype).as_pointer())
    shape = [next(words) for _ in range(kind.ndim)]
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    packed = {"shape": cgutils.pack_array(builder, shape), "strides": cgutils.pack_array(builder, strides)}
    populate_array(array, data=data, itemsize=size, meminfo=None, **packed)
    return array._getvalue()
