"""A name for a system with its parameter values, equal in every process."""

from __future__ import annotations

import hashlib
import re

import jax
import numpy as np

from hhtbench.protocol import NumpySystem, System

_ADDRESS = re.compile(r" at 0x[0-9a-f]+")  # in the text of a function: another one in every process


def fingerprint(system: System | NumpySystem) -> str | None:
    """A hash of the class's name and of all fields; None for a NumpySystem, whose functions hide their numbers."""
    if isinstance(system, NumpySystem):
        return None
    leaves, structure = jax.tree.flatten(system)
    digest = hashlib.sha256(type(system).__qualname__.encode())
    for part in (structure, *leaves):
        array = np.asarray(part) if isinstance(part, jax.Array | np.ndarray | np.generic) else None
        text = _ADDRESS.sub("", f"{type(part).__name__} {part!r}") if array is None else f"{array.dtype} {array.shape} "
        digest.update(text.encode() + (b"" if array is None else array.tobytes()) + b"\0")
    return digest.hexdigest()
