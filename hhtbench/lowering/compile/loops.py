"""Loops over numbers, compiled by Numba beforehand: their object code lies beside their sources and needs no Numba.

``make loops`` (:mod:`~.compiled_loops`) writes it: object code for Linux on x86-64 and aarch64, made
for no processor in particular, and LLVM's bitcode, which takes a second to become machine code elsewhere.  A manifest names
the content of the sources that all this was made from.
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

from hhtbench.lowering.caching import kept_on_disk
from hhtbench.lowering.scalar_compiler.machine import from_bitcode, host, load
from hhtbench.solution.counting import preparing

# Annotations of an entry's arguments: arrays whose entries follow one another in memory, beside int, float, bool and tuples.
FloatArray = Annotated[Any, np.dtype(np.float64), 1]
FloatMatrix = Annotated[Any, np.dtype(np.float64), 2]
IntArray = Annotated[Any, np.dtype(np.int64), 1]
BoolArray = Annotated[Any, np.dtype(np.bool_), 1]

ENTRY = "hhtbench_loop"  #: the name of an entry in its object code
NUMBERS = {float: "d", np.float64: "d", int: "q", bool: "?"}  #: kinds of numbers, in the words of a layout
MANIFEST = "manifest.json"
BITCODE = "bitcode"
_address, _buffer = ctypes.addressof, cast("Any", ctypes.c_char.from_buffer)  # mypy does not know arrays as buffers
_CALL = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
OWN = Path(__file__), Path(__file__).with_name("compiled_loops.py")  #: they say how arguments go over
ENTRIES: list[Entry] = []  #: of all modules that were imported


def entries(folder: Path, *sources: Path) -> Callable[[Any], Any]:
    """A decorator that makes an :class:`Entry` of a function of loops over numbers, with annotated arguments.

    They make no arrays of their own and return a whole number or None.

    Parameters
    ----------
    folder
        Where their object code lies.
    sources
        Files, and folders of files, that it is made from.
    """
    return lambda function: Entry(function, folder, sources)


def inner(**options: Any) -> Callable[[Any], Any]:
    """A decorator that makes an :class:`Inner`; ``inline="always"`` for functions that return a part of an array."""
    return lambda function: Inner(function, lambda: _dispatcher(function, options))


def intrinsic(module: str, name: str, function: Callable[..., Any]) -> Inner:
    """A word of compiled loops: a generator of code in ``module``, for Numba, and a function that does the same."""
    return Inner(function, lambda: getattr(importlib.import_module(module), name))


def _dispatcher(function: Any, options: dict[str, Any]) -> Any:
    return importlib.import_module("hhtbench.lowering.compile.compiled_loops").dispatcher(function, options)


class Inner:
    """A function that other loops call; called from Python it runs as plain Python."""

    __name__: str

    def __init__(self, function: Any, for_numba: Callable[[], Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.for_numba = cache(for_numba)  #: () -> Numba's function; it needs Numba

    def __call__(self, *arguments: Any) -> Any:
        """As plain Python."""
        return self.function(*arguments)


class Shipped:
    """A compiled function, called without importing its source.  Its arguments go over as a row of eight-byte words."""

    def __init__(self, name: str, folder: Path, sources: tuple[Path, ...]) -> None:
        self.__name__, self.folder, self.sources = name, folder, sources
        self._ready: tuple[str, Any, Any] | None = None

    def __call__(self, *arguments: Any) -> int:
        """The whole number that it returns; 0 for None.

        Raises
        ------
        TypeError
            Arguments of other types than the annotations', or strided arrays.
        """
        return self.following()(*arguments)

    def following(self, *first: Any) -> Callable[..., int]:
        """What takes the arguments after ``first``, which stay the same: of arrays their memory.

        Threads may share it where nobody uses what it returns: that has one place.
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
        """The machine words of its arguments, and object code for this machine."""
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
    """A function that Python calls compiled; ``entry.function`` is the same as plain Python."""

    def __init__(self, function: Any, folder: Path, sources: tuple[Path, ...]) -> None:
        Shipped.__init__(self, function.__name__, folder, sources)
        Inner.__init__(self, function, lambda: _dispatcher(function, {}))
        ENTRIES.append(self)


def in_words(values: tuple[Any, ...], words: list[Any]) -> str:
    """Append the eight-byte words of ``values``; returns what they are.

    Raises
    ------
    TypeError
        There is no way to hand one over.
    """
    layout = ""
    for value in values:
        if isinstance(value, np.ndarray):
            try:  # a buffer, in a fifth of the time that NumPy's word takes
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
    """An array in the words of a layout."""
    return f"[{dtype.str}{ndim}]"


@lru_cache
def content_of(sources: tuple[Path, ...]) -> str:
    """A name for the content of all Python sources in ``sources``."""
    digest = hashlib.sha256()
    files = (path for source in (*sources, *OWN) for path in (source.glob("*.py") if source.is_dir() else [source]))
    for path in sorted(files):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
