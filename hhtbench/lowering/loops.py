"""Loops over numbers compiled by Numba, kept on disk by the content of all their sources.

Numba itself looks at the file of the function only: what that file's functions call in others may change unseen.  It is
imported where something must be compiled: to find machine code in its cache takes it longer than most runs.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import platform
import struct
import threading
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import numpy as np

from hhtbench.counting import preparing
from hhtbench.lowering.native import disk
from hhtbench.lowering.native.machine import host, load

ENTRY = "hhtbench_loop"  #: the name of an entry in its object code
_address, _buffer = ctypes.addressof, cast("Any", ctypes.c_char.from_buffer)  # mypy does not know arrays as buffers
_CALL = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
OWN = Path(__file__), Path(__file__).with_name("compiled_loops.py")
_lock = threading.RLock()


def loops(*folders: Path, bare: bool = False, inner: bool = False, inline: bool = False) -> Callable[[Any], Any]:
    """A decorator that compiles functions made of loops over numbers, for modules whose sources lie in ``folders``.

    Parameters
    ----------
    bare
        They make no arrays, so references to arrays need not be counted, which costs more than small loops do; they may
        return a part of an array only where they are put ``inline`` into their callers.  One that is called from Python
        is an :class:`Entry`.
    inner
        They are called by other such functions only, with which they are kept on disk.
    """
    options: dict[str, Any] = {"error_model": "numpy"} | ({"_nrt": False} if bare else {})
    options |= {"inline": "always"} if inline else {}
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True} if inner or bare else {}

    def compiled(function: Any) -> Any:
        if inner or inline:
            return Inner(function, options)
        return (Entry if bare else Called)(function, options, _content((*folders, *OWN)))

    return compiled


class Later:
    """What Numba needs, by the name of its module, which is imported where something is compiled."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    def for_numba(self) -> Any:
        """The thing itself."""
        return getattr(importlib.import_module(self._module), self._name)


class Inner:
    """A function that other loops call."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        self.__doc__, self.__module__ = function.__doc__, function.__module__
        self._function, self._options = function, options
        self._made: Any = None

    def for_numba(self) -> Any:
        """Numba's function."""
        with _lock:
            if self._made is None:
                self._made = self._make()
            return self._made

    def _make(self) -> Any:
        return _compiling().dispatcher(self._function, self._options)


class Called(Inner):
    """A function that Python calls, with arrays of its own; Numba keeps it on disk."""

    def __init__(self, function: Any, options: dict[str, Any], content: str) -> None:
        super().__init__(function, options)
        self._content = content

    def _make(self) -> Any:
        return _compiling().kept_dispatcher(self._function, self._options, self._content)

    def __call__(self, *arguments: Any) -> Any:
        """Its value."""
        if self._made is not None and self._made.signatures:
            return self._made(*arguments)
        with preparing(f"compiling the loop {self._function.__name__}, for all systems"):
            return self.for_numba()(*arguments)


class Entry(Inner):
    """A function without arrays of its own that Python calls: object code on disk, which is loaded without Numba.

    It takes arrays whose entries follow one another in memory, Python's numbers, and tuples of all these.  Types and
    dimensions, which select the code, are those of the arguments.  Its arguments go over as a row of eight-byte words.
    """

    def __init__(self, function: Any, options: dict[str, Any], content: str) -> None:
        super().__init__(function, options)
        self._content = content
        self._ready: dict[str, tuple[Any, Any]] = {}

    def __call__(self, *arguments: Any) -> int:
        """The whole number that it returns; 0 for None."""
        words: list[Any] = []
        layout = _in_words(arguments, words)
        function, pack = self._ready.get(layout) or self._prepare(layout, arguments, words)
        result, error = ctypes.c_int64(), ctypes.c_void_p()
        if function(ctypes.addressof(result), ctypes.addressof(error), pack(*words)):
            raise RuntimeError(f"{self._function.__qualname__} failed in compiled code")
        return result.value

    def _prepare(self, layout: str, arguments: tuple[Any, ...], words: list[Any]) -> tuple[Any, Any]:
        with _lock:
            if layout not in self._ready:
                (address,) = load(self._object_code(layout, arguments), ENTRY)
                formats = ["d" if isinstance(word, float) else "q" for word in words]
                self._ready[layout] = _CALL(address), struct.Struct("".join(formats)).pack
            return self._ready[layout]

    def _object_code(self, layout: str, arguments: tuple[Any, ...]) -> bytes:
        """From disk, or by Numba; what needs Numba to be loaded too is not kept."""
        digest = hashlib.sha256()
        for part in (self._function.__module__, self._function.__qualname__, layout, self._content, *_versions()):
            digest.update(part.encode() + b"\0")
        name = f"{digest.hexdigest()}.loop"
        code = disk.read_file(name)
        if code is None:
            with preparing(f"compiling the loop {self._function.__name__}, for all systems"):
                code, needs_numba = _compiling().object_code(self._function, self._options, arguments, ENTRY)
            if not needs_numba:
                disk.write_file(name, code)
        return code


def _in_words(value: Any, words: list[Any]) -> str:
    """Append the eight-byte words of ``value``; returns what they are.

    Raises
    ------
    TypeError
        There is no way to hand it over.
    """
    if isinstance(value, float):
        words.append(value)
        return "d"
    if isinstance(value, np.ndarray):
        flags = value.flags
        if not flags.c_contiguous:
            raise TypeError("compiled loops take arrays whose entries follow one another in memory; got a strided one.")
        if flags.writeable and value.size:  # in a fifth of the time that NumPy's word for it takes
            words.append(_address(_buffer(value)))
        else:
            words.append(value.ctypes.data)
        words.extend(value.shape)
        return _array_layout(value.dtype, value.ndim)
    if isinstance(value, tuple):
        return f"({type(value).__name__}:{''.join([_in_words(part, words) for part in value])})"
    if not isinstance(value, int):  # as True and False are
        raise TypeError(f"compiled loops take arrays, numbers and tuples of them; got {type(value).__name__}.")
    words.append(value)
    return "?" if isinstance(value, bool) else "q"


@lru_cache
def _array_layout(dtype: np.dtype, ndim: int) -> str:
    return f"[{dtype.str}{ndim}]"


def _compiling() -> Any:
    """The module that needs Numba."""
    return importlib.import_module("hhtbench.lowering.compiled_loops")


@lru_cache
def _versions() -> tuple[str, ...]:
    return version("numba"), np.__version__, platform.python_version(), host()


@lru_cache
def _content(folders: tuple[Path, ...]) -> str:
    """A name for the content of all Python sources in ``folders``."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in (folder.glob("*.py") if folder.is_dir() else [folder])):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]
