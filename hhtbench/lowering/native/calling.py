"""Calls of machine code from Python with NumPy arrays, at a fraction of a microsecond."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.native.compiler import Native
from hhtbench.lowering.native.machine import caller


class _Buffers(NamedTuple):
    """Memory of one thread: arguments are copied in and the result is copied out."""

    places: tuple[np.ndarray, ...]
    result: np.ndarray
    block: int  #: address of the pointers to the result, the parameters and every argument
    pointers: np.ndarray  #: that block


class NativeCall:
    """``call(*arrays) -> array``: a fresh array each time.  Arguments are float64 arrays or numbers of the known shapes."""

    def __init__(self, native: Native, shapes: tuple[tuple[int, ...], ...]) -> None:
        self._native, self._shapes = native, shapes
        self._code = caller(native.block_address)
        self._local = threading.local()

    def __call__(self, *arguments: Any) -> np.ndarray:
        """The result at ``arguments``, which are of the right shapes: nothing is checked here."""
        try:
            places, result, block, _ = self._local.buffers
        except AttributeError:
            places, result, block, _ = self._local.buffers = self._buffers()
        for place, argument in zip(places, arguments, strict=False):
            place[...] = argument
        self._code(block)
        return result.copy()

    def _buffers(self) -> _Buffers:
        """A cache line lies between any two arrays."""
        places = tuple(np.zeros(shape) for shape in self._shapes)
        result = np.zeros(self._native.shape)
        arrays = (result, self._native.parameters, *places)
        pointers = np.array([array.ctypes.data for array in arrays], dtype=np.uintp)
        return _Buffers(places, result, pointers.ctypes.data, pointers)
