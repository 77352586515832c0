"""Calls of machine code by its address, and parts of arrays: what loops do that Python has no word for."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np

from hhtbench.lowering.compile.loops import intrinsic

_SOURCE = "solvers.hht.loops.intrinsics"


@lru_cache
def _function_of(count: int) -> Any:
    return ctypes.PYFUNCTYPE(None, *[ctypes.c_void_p] * count)


def _invoke(address: int, pointers: tuple[int, ...]) -> None:
    _function_of(len(pointers))(int(address))(*map(int, pointers))


def _view(array: Any, start: int, count: int) -> Any:
    return array[start : start + count]


invoke: Any = intrinsic(_SOURCE, "invoke", _invoke)  #: (address, pointers) -> None
view: Any = intrinsic(_SOURCE, "view", _view)  #: (array of 8-byte entries, start, count) -> a part of it
spacing: Any = intrinsic(_SOURCE, "spacing", np.spacing)  #: (x >= 0) -> distance to the next larger number
