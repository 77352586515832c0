"""Numerical loops compiled by Numba in advance: their object code is shipped with the sources and needs no Numba.

``make loops`` (:mod:`~.compiled_loops`) writes it: object code for Linux on x86-64 and aarch64, for no processor in
particular, and LLVM bitcode, which takes a second to become machine code elsewhere.  A manifest holds a hash of the sources
that the code was made from.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import json
import platform
import struct
from collections.abc import Callable
from functools import cache, lru_cache, update_wrapper
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from hhtbench.lowering.scalar_compiler.machine import from_bitcode, host, load
from hhtbench.runtime.disk_cache import kept_on_disk
from hhtbench.solution.counting import preparing

# Annotations of an entry's arguments: contiguous arrays, in addition to int, float, bool and tuples.
FloatArray = Annotated[Any, np.dtype(np.float64), 1]
FloatMatrix = Annotated[Any, np.dtype(np.float64), 2]
IntArray = Annotated[Any, np.dtype(np.int64), 1]
BoolArray = Annotated[Any, np.dtype(np.bool_), 1]

ENTRY = "hhtbench_loop"  #: the name of an entry in its object code
NUMBERS = {float: "d", np.float64: "d", int: "q", bool: "?"}  #: letters of number types in a layout
MANIFEST = "manifest.json"
BITCODE = "bitcode"
_address, _buffer = ctypes.addressof, cast("Any", ctypes.c_char.from_buffer)  # mypy does not know arrays as buffers
_CALL = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
OWN = Path(__file__), Path(__file__).with_name("compiled_loops.py")  #: they define how arguments are passed
ENTRIES: list[Entry] = []  #: entries of all imported modules


def entries(folder: Path, *sources: Path) -> Callable[[Any], Any]:
    """Decorator that makes an :class:`Entry` of a function of loops over numbers, with annotated arguments.

    Such functions allocate no arrays and return a whole number or None.

    Parameters
    ----------
    folder
        Folder of their object code.
    sources
        Files, and folders of files, that it is made from.
    """
    return lambda function: Entry(function, folder, sources)


def inner(**options: Any) -> Callable[[Any], Any]:
    """Decorator that makes an :class:`Inner`; ``inline="always"`` for functions that return a view of an array."""
    return lambda function: Inner(function, lambda: _dispatcher(function, options))


def intrinsic(module: str, name: str, function: Callable[..., Any]) -> Inner:
    """A primitive of compiled loops: a Numba code generator in ``module``, and a Python function that does the same."""
    return Inner(function, lambda: getattr(importlib.import_module(module), name))


def _dispatcher(function: Any, options: dict[str, Any]) -> Any:
    return importlib.import_module("hhtbench.lowering.compile.compiled_loops").dispatcher(function, options)


class Inner:
    """A function called by compiled loops; called from Python it runs as plain Python."""

    __name__: str

    def __init__(self, function: Any, for_numba: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.for_numba = cache(for_numba)  #: () -> Numba's function; it needs Numba

    def __call__(self, *arguments: Any) -> Any:
        """Run as plain Python."""
        return self.function(*arguments)


class Shipped:
    """A compiled function, called without importing its source; arguments are passed as a row of eight-byte words."""

    def __init__(self, name: str, folder: Path, sources: tuple[Path, ...]) -> None:
        self.__name__, self.folder, self.sources = name, folder, sources
        self._ready: tuple[str, Any, Any] | None = None

    def __call__(self, *arguments: Any) -> int:
        """Call it; returns its whole number, or 0 for None.

        Raises
        ------
        TypeError
            Arguments of other types than the annotations', or strided arrays.
        """
        return self.following()(*arguments)

    def following(self, *first: Any) -> Callable[..., int]:
        """Callable of the arguments after ``first``, which are bound; of arrays, their memory.

        Threads may share it only if nobody uses its return value, which has one place.
        """
        known: list[Any] = []
        begins, result, error = in_words(first, known), ctypes.c_int64(), ctypes.c_void_p()
        at, error_at = _address(result), _address(error)

        def call(*rest: Any, _kept: Any = (first, error)) -> int:
            words = known.copy()
            layout = begins + in_words(rest, words)
            wanted, function, pack = self._ready or self._prepare(words)
            if layout != wanted:
                raise TypeError(f"{self.__name__} takes {wanted}; got {layout}.")
            if function(at, error_at, pack(*words)):
                raise RuntimeError(f"{self.__name__} failed in compiled code")
            return result.value

        return call

    def _prepare(self, words: list[Any]) -> tuple[str, Any, Any]:
        layout, code = self._shipped()
        (address,) = load(code, ENTRY)
        formats = ["d" if isinstance(word, float) else "q" for word in words]
        self._ready = layout, _CALL(address), struct.Struct("".join(formats)).pack  # threads at once make the same twice
        return self._ready

    def _shipped(self) -> tuple[str, bytes]:
        """Layout of its arguments, and object code for this machine."""
        manifest = json.loads((self.folder / MANIFEST).read_text())
        if manifest["content"] != content_of(self.sources):
            raise RuntimeError(f"the sources of {self.folder} have changed since they were compiled: run `make loops`.")
        made = manifest["entries"][self.__name__]
        here = f"{platform.machine()}-{platform.system()}".lower()
        kind = here if here in made["files"] else BITCODE
        code = (self.folder / f"{self.__name__}.{kind}").read_bytes()
        if hashlib.sha256(code).hexdigest() != made["files"][kind]:
            raise RuntimeError(f"the compiled {self.__name__} in {self.folder} is damaged: install hhtbench anew.")
        if kind == BITCODE:
            return made["layout"], kept_on_disk(code + host().encode(), "loop", lambda: self._generated(code))
        return made["layout"], code

    def _generated(self, bitcode: bytes) -> bytes:
        with preparing(f"generating the loop {self.__name__}"):
            return from_bitcode(bitcode)


class Entry(Shipped, Inner):
    """A function that is compiled when called from Python; ``entry.function`` is the same as plain Python."""

    def __init__(self, function: Any, folder: Path, sources: tuple[Path, ...]) -> None:
        Shipped.__init__(self, function.__name__, folder, sources)
        Inner.__init__(self, function, lambda: _dispatcher(function, {}))
        ENTRIES.append(self)


def in_words(values: tuple[Any, ...], words: list[Any]) -> str:
    """Append the eight-byte words of ``values`` to ``words``; returns their layout.

    Raises
    ------
    TypeError
        A value is neither array, number nor tuple of these, or an array is strided.
    """
    layout = ""
    for value in values:
        if isinstance(value, np.ndarray):
            try:  # a buffer, in a fifth of the time that ndarray.ctypes takes
                words += _address(_buffer(value)), *value.shape
            except (TypeError, ValueError):  # of no array that is read-only, empty or strided
                if not value.flags.c_contiguous:
                    text = "compiled loops take arrays whose entries follow one another in memory; got a strided one."
                    raise TypeError(text) from None
                words += value.ctypes.data, *value.shape
            layout += array_layout(value.dtype, value.ndim)
        elif (letter := NUMBERS.get(type(value))) is not None:
            words.append(value)
            layout += letter
        elif isinstance(value, tuple):
            layout += f"({in_words(value, words)})"
        else:
            raise TypeError(f"compiled loops take arrays, numbers and tuples of them; got {type(value).__name__}.")
    return layout


@lru_cache
def array_layout(dtype: np.dtype, ndim: int) -> str:
    """Layout text of an array."""
    return f"[{dtype.str}{ndim}]"


@lru_cache
def content_of(sources: tuple[Path, ...]) -> str:
    """Hash of all Python files in ``sources``."""
    digest = hashlib.sha256()
    files = (path for source in (*sources, *OWN) for path in (source.glob("*.py") if source.is_dir() else [source]))
    for path in sorted(files):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
