"""Checkpoints of stepping by hand: numbers as JSON and plain arrays.  Reading one runs no code and believes nothing.

After a line with the checksum comes one of JSON, then the bytes of the arrays it speaks of.  A record is an object with
its type's name, of ``TYPES`` and of no others; fields, kinds and shapes are checked before anything is computed with them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from hhtbench.result import Counters
from solvers._start import Place
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.run.stepper import EventState
from solvers.hht.run.stepping import IntegratorState
from solvers.hht.step.state import ControlMemory, Factorised, State

MAGIC, VERSION = b"hhtbench HHT checkpoint", 4
RECORDS = (IntegratorState, Place, State, ControlMemory, Factorised, Tolerances, EventState, Occurrence, HermiteOutput)
TYPES: dict[str, Any] = {kind.__name__: kind for kind in RECORDS}
NUMBERS = ("<f8",)  # of arrays
KINDS: dict[str, Any] = {  # what a field's annotation allows
    "float": float,
    "int": int,
    "bool": bool,
    "str": str,
    "None": type(None),
    "Vector": np.ndarray,
    "Matrix": np.ndarray,
    "Counter[str]": Counter,
}
COUNTERS = {f.name for f in fields(Counters)} - {"provenance"}


def pack(integrator: IntegratorState, setup: dict[str, Any]) -> bytes:
    """A checkpoint of ``integrator``, made by a solver with ``setup``: texts by name."""
    arrays: list[np.ndarray] = []
    tree = {"setup": setup, "integrator": _encoded(integrator, arrays)}
    tree["arrays"] = [[array.dtype.str, array.shape] for array in arrays]
    body = json.dumps(tree).encode() + b"\n" + b"".join(array.tobytes() for array in arrays)
    return b"%s %d %s\n" % (MAGIC, VERSION, hashlib.sha256(body).hexdigest().encode()) + body


def unpack(data: Any, setup: dict[str, Any]) -> IntegratorState:
    """The :class:`IntegratorState` of a checkpoint that was made with the same ``setup``.

    :func:`~solvers.hht.run.legal_state.check` tells whether it fits the system.

    Raises
    ------
    ProblemError, TypeError
        ``data`` is no checkpoint, one of another version, damaged, or made by a solver with other options.
    """
    body = _body(data)
    line, _, rest = body.partition(b"\n")
    try:
        tree = json.loads(line, parse_constant=_no_number)
        made_with, integrator = tree["setup"], _decoded(tree["integrator"], _arrays(tree["arrays"], rest))
    except (ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
        raise ProblemError(f"the checkpoint is none of this solver's: {type(error).__name__}: {error}") from None
    for name, value in setup.items():
        found = made_with.get(name) if isinstance(made_with, dict) else None
        if found != value:
            raise ProblemError(
                f"the checkpoint was made by a solver with {name} = {found}; this one has {value}. Give HHT the same "
                "system, parameter values, options and events."
            )
    if not isinstance(integrator, IntegratorState):
        raise ProblemError("the checkpoint is none of this solver's: it holds no integrator.")
    return integrator


def _body(data: Any) -> bytes:
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise TypeError(f"resume takes the bytes of HHT.checkpoint(); got {type(data).__name__}.")
    head, _, body = bytes(data).partition(b"\n")
    words = head.rsplit(b" ", 2)
    if len(words) != 3 or words[0] != MAGIC:
        raise ProblemError("resume takes the bytes of HHT.checkpoint(); these are not.")
    if words[1] != b"%d" % VERSION:
        version = words[1].decode("ascii", "replace")
        raise ProblemError(f"the checkpoint has version {version}, this solver reads version {VERSION}; make it anew.")
    if words[2] != hashlib.sha256(body).hexdigest().encode():
        raise ProblemError("the checkpoint is damaged or incomplete: its checksum does not match.")
    return body


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no finite number")


def _encoded(value: Any, arrays: list[np.ndarray]) -> Any:
    """``value`` for JSON; its arrays go to ``arrays``."""
    if is_dataclass(value):
        parts = {f.name: _encoded(getattr(value, f.name), arrays) for f in fields(value)}
        return {"type": type(value).__name__, **parts}
    if isinstance(value, np.ndarray):
        arrays.append(np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<")))
        return {"type": "array", "number": len(arrays) - 1}
    if isinstance(value, Counter):
        return {"type": "Counter", **value}
    if isinstance(value, tuple):
        return [_encoded(part, arrays) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def _arrays(described: Any, rest: bytes) -> list[np.ndarray]:
    found, at = [], 0
    for number, shape in described:
        if number not in NUMBERS or not all(type(length) is int and length >= 0 for length in shape):
            raise ValueError(f"an array of {number} and shape {shape}")
        dtype = np.dtype(number)
        stop = at + dtype.itemsize * math.prod(shape)
        if stop > len(rest):
            raise ValueError("arrays are longer than the checkpoint")
        found.append(np.frombuffer(rest[at:stop], dtype=dtype).reshape(shape).copy())
        if not np.isfinite(found[-1]).all():
            raise ValueError("an array holds values that are not finite")
        at = stop
    if at != len(rest):
        raise ValueError("something follows the arrays")
    return found


def _decoded(value: Any, arrays: list[np.ndarray]) -> Any:
    """The inverse of :func:`_encoded`; fields and their kinds are those of the types.

    Raises
    ------
    ValueError, KeyError, TypeError
        They are not.
    """
    if isinstance(value, list):
        return tuple(_decoded(part, arrays) for part in value)
    if not isinstance(value, dict):
        if isinstance(value, int) and abs(value) >= 2**63:
            raise ValueError(f"{value} is no number of 64 bits")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError("a number that is not finite")  # what is too large, as 1e999, is read as infinity
        return value
    name = value["type"]
    if name == "array":
        return arrays[range(len(arrays)).index(value["number"])]
    parts = {key: _decoded(part, arrays) for key, part in value.items() if key != "type"}
    if name == "Counter":
        return _tally(parts)
    kind = TYPES[name]
    wanted = {f.name: f.type for f in fields(kind)}
    if parts.keys() != wanted.keys():
        raise ValueError(f"{name} with fields {', '.join(parts)}")
    for key, allowed in wanted.items():
        if not _is(parts[key], str(allowed)):
            raise TypeError(f"{name}.{key} must be {allowed}; got {type(parts[key]).__name__}")
    return kind(**parts)


def _tally(parts: dict[str, Any]) -> Counter[str]:
    for name, count in parts.items():
        if name not in COUNTERS or type(count) is not int or count < 0:
            raise ValueError(f"a counter {name} = {count!r}")
    return Counter(parts)


def _is(value: Any, allowed: str) -> bool:
    """Whether ``value`` is of a kind that an annotation allows."""
    for kind in allowed.split(" | "):
        if kind.startswith("tuple["):
            inner = kind[len("tuple[") : -1].split(", ")[0]
            if isinstance(value, tuple) and all(_is(part, inner) for part in value):
                return True
        elif isinstance(value, KINDS.get(kind) or TYPES[kind]) and (kind == "bool" or not isinstance(value, bool)):
            return True
    return False
