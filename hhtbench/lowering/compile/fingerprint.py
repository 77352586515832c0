"""Fingerprint of a system with its parameter values, equal in every process."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from hhtbench.protocol.system import NumpySystem, System


class NoFingerprint(TypeError):
    """The system, or a field described by the message, has no fingerprint."""


def fingerprints(system: System | NumpySystem) -> dict[str, str]:
    """Text for each field, equal for equal values only: a number as printed, else a hash of its contents.

    The code of the class, and values that its functions use from outside the fields, are not included.

    Raises
    ------
    NoFingerprint
        A NumpySystem, whose functions hide their numbers, or a field that holds a function or another such object.
    """
    if isinstance(system, NumpySystem):
        raise NoFingerprint("is a NumpySystem")
    return {field.name: _text(getattr(system, field.name)) for field in dataclasses.fields(system)}


def _text(value: Any) -> str:
    if isinstance(value, jax.Array) and value.ndim == 0 and value.dtype == np.float64:
        return repr(float(value))
    digest = hashlib.sha256()
    for part in _parts(value):
        digest.update(b"%d " % len(part) + part)
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """Yield ``value`` as bytes: type and size of everything before its contents."""
    yield type(value).__qualname__.encode()
    if value is None or type(value) in (bool, int, float, complex, str, bytes):
        yield repr(value).encode()
    elif isinstance(value, jax.Array | np.ndarray | np.generic) and not value.dtype.hasobject:
        array = np.asarray(value)
        yield from (f"{array.dtype} {array.shape}".encode(), array.tobytes())
    elif isinstance(value, tuple | list | dict | eqx.Module):
        inner: Any = value
        if isinstance(value, eqx.Module):
            inner = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        inner = [part for item in inner.items() for part in item] if isinstance(inner, dict) else inner
        yield b"%d" % len(inner)
        for part in inner:
            yield from _parts(part)
    else:
        raise NoFingerprint(f"holds a {type(value).__name__}")
