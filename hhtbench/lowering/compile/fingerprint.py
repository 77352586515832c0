"""Fingerprint of a system with its parameter values, equal in every process."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import jax
import numpy as np

from hhtbench.lowering.contents import NoContents, contents
from hhtbench.protocol.system import NumpySystem, System


def fingerprints(system: System | NumpySystem) -> dict[str, str]:
    """Text for each field, equal for equal values only: a number as printed, else a hash of its contents.

    The code of the class, and values that its functions use from outside the fields, are not included.

    Raises
    ------
    NoContents
        A NumpySystem, whose functions hide their numbers, or a field that holds a function or another such object.
    """
    if isinstance(system, NumpySystem):
        raise NoContents("is a NumpySystem")
    return {field.name: _text(getattr(system, field.name)) for field in dataclasses.fields(system)}


def _text(value: Any) -> str:
    if isinstance(value, jax.Array) and value.ndim == 0 and value.dtype == np.float64:
        return repr(float(value))
    digest = hashlib.sha256()
    for part in contents(value):
        digest.update(b"%d " % len(part) + part)
    return digest.hexdigest()
