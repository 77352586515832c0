"""Contents of values as bytes that are equal in every process."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from hhtbench.runtime.jax_settings import BEGAN

FOLDERS = [Path(__file__).parents[2] / name for name in ("hhtbench", "solvers")]  # whose sources are part of a key
LIBRARIES = "jax", "jaxlib", "equinox", "numpy", "llvmlite"  # whose versions are


class NoContents(TypeError):
    """A value has no contents of its own, as a function; the message describes it."""


def contents(value: Any, *, parameters: bool = True) -> Iterator[bytes]:
    """Yield ``value`` as bytes: type and size of everything before its contents.

    Without ``parameters`` only shape and type of arrays of floating-point numbers, and functions and objects of our own
    packages, by their names.

    Raises
    ------
    NoContents
        It holds a function or another object.
    """
    own = not parameters
    yield type(value).__qualname__.encode()
    if value is None or type(value) in (bool, int, float, complex, str, bytes):
        yield repr(value).encode()
    elif isinstance(value, jax.Array | np.ndarray | np.generic) and not value.dtype.hasobject:
        yield f"{value.dtype} {value.shape}".encode()
        if parameters or not (isinstance(value, jax.Array) and eqx.is_inexact_array(value)):
            yield np.asarray(value).tobytes()
    elif isinstance(value, tuple | list | dict | eqx.Module) or (own and dataclasses.is_dataclass(value)):
        inner: Any = value
        if not isinstance(value, tuple | list | dict):
            if own:
                yield _ours(type(value))
            inner = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        inner = [part for item in inner.items() for part in item] if isinstance(inner, dict) else inner
        yield b"%d" % len(inner)
        for part in inner:
            yield from contents(part, parameters=parameters)
    elif own and isinstance(value, FunctionType):
        yield _ours(value)
    else:
        raise NoContents(f"holds a {type(value).__name__}")


def _ours(defined: Any) -> bytes:
    """Name of a class or function at the top of a module of our packages, which is what the module has by that name."""
    name, module = defined.__qualname__, sys.modules.get(defined.__module__)
    place = Path(getattr(module, "__file__", None) or "/")
    if not any(folder in place.parents for folder in FOLDERS) or getattr(module, name, None) is not defined:
        raise NoContents(f"holds {defined.__module__}.{name}")
    return f"{defined.__module__}.{name}".encode()


def lasting_key(*values: Any) -> bytes | None:
    """Key of computations that is equal in every process, apart from parameters; None if code of others takes part.

    It holds the versions of all libraries and of our own sources.  None, too, if one of these files was changed after it may
    have been imported.
    """
    sources = _sources()
    if sources is None:
        return None
    digest = hashlib.sha256(sources)
    try:
        for part in contents(values, parameters=False):
            digest.update(b"%d " % len(part) + part)
    except NoContents:
        return None
    return digest.digest()


def _sources() -> bytes | None:
    """Versions of libraries; places, sizes and times of our own sources; None if one may be newer than what was imported."""
    found = list(_versions())
    for folder in FOLDERS:
        for file in sorted(folder.rglob("*.py")):
            state = file.stat()
            if state.st_ctime > BEGAN:
                return None
            found.append(f"{file} {state.st_size} {state.st_mtime_ns}")
    return "\0".join(found).encode()


@cache
def _versions() -> tuple[str, ...]:
    return sys.version, *(version(name) for name in LIBRARIES)
