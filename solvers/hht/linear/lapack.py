"""Addresses of SciPy's LAPACK routines, as ``scipy.linalg.cython_lapack`` offers them to compiled code."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

from scipy.linalg import cython_lapack


@lru_cache
def address_of(name: str) -> int:
    """Of the routine ``name``; integers are of 32 bits, every argument goes by its address."""
    routines: Any = cython_lapack.__pyx_capi__
    capsule = routines[name]
    get_name, get_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(get_pointer(capsule, get_name(capsule)))
