"""Calls from XLA's compiled code to Python functions through XLA's stable C interface (FFI), at 5 us each.

``jax.pure_callback`` costs 150 us: it makes JAX arrays and a task of its thread pool for every call.  The structures
follow ``xla/ffi/api/c_api.h``, which lies in ``jax.ffi.include_dir()``, in words of eight bytes.
"""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

TARGET = "hhtbench_call"
FRAME = struct.Struct("15q")  # XLA_FFI_CallFrame up to its results, and where in it ...
EXTENSION, API, STAGE, COUNT, ARGUMENTS, RESULTS = 1, 2, 4, 7, 9, 14  # ... things are; the last two: arrays of buffers
EXECUTE = 3  # the stage that is a call, XLA_FFI_ExecutionStage_EXECUTE
BUFFER = struct.Struct("6q")  # XLA_FFI_Buffer, and where in it ...
DATA, RANK, SHAPE = 3, 4, 5  # ... things are
METADATA = 1  # the extension that asks what a handler is, XLA_FFI_Extension_Metadata
OF_TYPE, OF_METADATA = 8, 24  # [bytes] where things are in XLA_FFI_Metadata_Extension ...
OF_VERSION, OF_TRAITS = 24, 32  # ... in XLA_FFI_Metadata: numbers of the version, major and minor in one word ...
OF_API_VERSION = 32  # ... and in XLA_FFI_Api
INT = 0xFFFFFFFF  # the half of a word that an int is
MAX_KNOWN = 256  # buffer addresses whose arrays are cached

functions: dict[int, Callable[..., Any]] = {}  #: ticket -> function: (shape of the result, *arrays) -> array
_known: dict[
    tuple[tuple[int, bytes], ...], list[Any]
] = {}  # places and shapes of the buffers -> arrays there, the result first


def _word(address: int) -> Any:
    """The eight-byte word at ``address``; assign to its ``value`` to write it."""
    return ctypes.c_int64.from_address(address)


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
def _handler(address: int) -> None:
    """FFI handler: answers XLA's query for metadata, or calls the Python function."""
    frame = FRAME.unpack(ctypes.string_at(address, FRAME.size))
    extension = frame[EXTENSION]
    if extension and _word(extension + OF_TYPE).value & INT == METADATA:
        metadata = _word(extension + OF_METADATA).value
        _word(metadata + OF_VERSION).value = _word(frame[API] + OF_API_VERSION).value  # that which runs
        ctypes.c_uint32.from_address(metadata + OF_TRAITS).value = 0
    elif frame[STAGE] & INT == EXECUTE:
        count = frame[COUNT]
        places = ctypes.string_at(frame[RESULTS], 8) + ctypes.string_at(frame[ARGUMENTS], 8 * count)
        result, ticket, *arrays = _arrays(struct.unpack(f"{1 + count}q", places))
        result[...] = functions[int(ticket)](result.shape, *arrays)


def _arrays(buffers: tuple[int, ...]) -> list[Any]:
    """NumPy views of XLA's float64 ``buffers``, cached by address and shape."""
    fields = [BUFFER.unpack(ctypes.string_at(buffer, BUFFER.size)) for buffer in buffers]
    key = tuple((field[DATA], ctypes.string_at(field[SHAPE], 8 * field[RANK])) for field in fields)
    found = _known.get(key)
    if found is None:
        if len(_known) >= MAX_KNOWN:
            _known.clear()
        found = _known[key] = [_array(*place) for place in key]
    return found


def _array(data: int, shape_in_bytes: bytes) -> Any:
    shape = struct.unpack(f"{len(shape_in_bytes) // 8}q", shape_in_bytes)
    memory = (ctypes.c_double * math.prod(shape)).from_address(data)
    return np.frombuffer(memory).reshape(shape)


def called(ticket: Any, shape: tuple[int, ...], *arrays: Any) -> Any:
    """Traced call of the function of ``ticket``: an array of ``shape`` from float64 ``arrays``.

    The function must not keep the arrays, nor raise.
    """
    return jax.ffi.ffi_call(TARGET, jax.ShapeDtypeStruct(shape, np.float64))(ticket, *arrays)


def _register() -> None:
    make: Any = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    capsule = make(ctypes.cast(_handler, ctypes.c_void_p).value, b"xla._CUSTOM_CALL_TARGET", None)
    jax.ffi.register_ffi_target(TARGET, capsule, platform="cpu")


_register()
