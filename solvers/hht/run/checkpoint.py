"""Checkpoints of stepping by hand: JSON with arrays as base64.  Reading one runs no code and checks everything.

A line with the checksum comes first.  A record is an object with its type's name, one of ``TYPES``; fields,
types and shapes are checked before use.
"""

from __future__ import annotations

import hashlib
import json
import math
from base64 import b64decode, b64encode
from collections import Counter
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from hhtbench.lowering.compile.fingerprint import fingerprints
from hhtbench.lowering.contents import NoContents
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.result import Counters
from solvers._start import PhasePoint
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine
from solvers.hht.run.loops import misfits, misshapen
from solvers.hht.run.stepper import EventState
from solvers.hht.run.stepping import IntegratorState
from solvers.hht.step.state import ControlMemory, Factorised, State
from solvers.kernel.memory import GIVEN, HEAD

MAGIC, VERSION = b"hhtbench HHT checkpoint", 11
RECORDS = (IntegratorState, PhasePoint, State, ControlMemory, Factorised, Tolerances, EventState, Occurrence, HermiteOutput)
TYPES: dict[str, Any] = {kind.__name__: kind for kind in RECORDS}
NUMBERS = np.dtype("<f8")  # numbers of arrays
COUNTERS = {f.name for f in fields(Counters)} - {"provenance"}
BEFORE = len(GIVEN) + len(HEAD)  # numbers of the step and of the state that precede its q and v
SHORTEST, LONGEST = 1e-150, 1e150  # [s] of a step: squares of others, or of their ratios, overflow or underflow


def setup_of(system: System | NumpySystem, options: HHTOptions, events: tuple[Event, ...]) -> dict[str, Any]:
    """Properties, as texts, that a checkpoint and the solver that resumes it must share."""
    o = options
    chosen = {"method": str(o.method()), "control": str(o.control), "linsolver": o.linsolver, "engine": o.engine}
    chosen["without"] = ", ".join(o.without)
    chosen["events"] = ", ".join(event.name for event in events)
    fields = {f"parameter {name}": value for name, value in named(system)[0].items()}
    return {"system": type(system).__qualname__, **fields, **chosen}


def named(system: System | NumpySystem) -> tuple[dict[str, str], str]:
    """Fingerprints of the system's fields by name; if it has none, an empty dict and the reason."""
    try:
        return fingerprints(system), ""
    except NoContents as error:
        return {}, str(error)


def pack(integrator: IntegratorState, setup: dict[str, Any]) -> bytes:
    """Serialise ``integrator`` of a solver with ``setup`` (texts by name) as a checkpoint."""
    body = json.dumps({"setup": setup, "integrator": _encoded(integrator)}).encode()
    return b"%s %d %s\n" % (MAGIC, VERSION, hashlib.sha256(body).hexdigest().encode()) + body


def unpack(data: Any, setup: dict[str, Any]) -> IntegratorState:
    """Read the :class:`IntegratorState` from a checkpoint that was made with the same ``setup``.

    :func:`check` then compares it with the system.

    Raises
    ------
    ProblemError, TypeError
        ``data`` is no checkpoint, one of another version, damaged, or made by a solver with other options.
    """
    body = _body(data)
    try:
        tree = json.loads(body)
        made_with, integrator = tree["setup"], _decoded(tree["integrator"])
    except (ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
        raise ProblemError(f"the checkpoint is none of this solver's: {type(error).__name__}: {error}") from None
    made_with = made_with if isinstance(made_with, dict) else {}
    for name in [*setup, *made_with.keys() - setup.keys()]:
        found, value = made_with.get(name), setup.get(name)
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


def _encoded(value: Any) -> Any:
    """Convert ``value`` to what JSON can hold."""
    if is_dataclass(value):
        return {"type": type(value).__name__, **{f.name: _encoded(getattr(value, f.name)) for f in fields(value)}}
    if isinstance(value, np.ndarray):
        return {"type": "array", "shape": value.shape, "content": b64encode(value.astype(NUMBERS).tobytes()).decode()}
    if isinstance(value, Counter):
        return {"type": "Counter", **value}
    if isinstance(value, tuple):
        return list(map(_encoded, value))
    return value.item() if isinstance(value, np.generic) else value


def _array(shape: Any, content: Any) -> np.ndarray:
    found = np.frombuffer(b64decode(content, validate=True), dtype=NUMBERS).reshape(shape).copy()
    if list(found.shape) != shape:
        raise ValueError(f"an array of shape {shape}")
    if not np.isfinite(found).all():
        raise ValueError("an array holds values that are not finite")
    return found


def _decoded(value: Any) -> Any:
    """Inverse of :func:`_encoded`; fields and their types are checked.

    Raises
    ------
    ValueError, KeyError, TypeError
        A field is missing, unknown or of a wrong type, or a number is not finite.
    """
    if isinstance(value, list):
        return tuple(map(_decoded, value))
    if not isinstance(value, dict):
        if isinstance(value, int) and abs(value) >= 2**63:
            raise ValueError(f"{value} is no number of 64 bits")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError("a number that is not finite")  # what is too large, as 1e999, is read as infinity
        return value
    name = value["type"]
    if name == "array":
        return _array(value["shape"], value["content"])
    parts = {key: _decoded(part) for key, part in value.items() if key != "type"}
    if name == "Counter":
        return _tally(parts)
    kind = TYPES[name]
    wanted = get_type_hints(kind)
    if parts.keys() != wanted.keys():
        raise ValueError(f"{name} with fields {', '.join(parts)}")
    for key, allowed in wanted.items():
        if not _is(parts[key], allowed):
            raise TypeError(f"{name}.{key} must be {kind.__annotations__[key]}; got {type(parts[key]).__name__}")
    return kind(**parts)


def _tally(parts: dict[str, Any]) -> Counter[str]:
    for name, count in parts.items():
        if name not in COUNTERS or type(count) is not int or count < 0:
            raise ValueError(f"a counter {name} = {count!r}")
    return Counter(parts)


def _is(value: Any, allowed: Any) -> bool:
    """True if ``value`` matches the annotation ``allowed``."""
    origin, inner = get_origin(allowed), get_args(allowed)
    if origin is UnionType:
        return any(_is(value, kind) for kind in inner)
    if origin is tuple:
        return isinstance(value, tuple) and all(_is(part, inner[0]) for part in value)
    return isinstance(value, origin or allowed) and (allowed is bool or not isinstance(value, bool))


def check(integrator: IntegratorState, engine: Engine, events: int) -> None:
    """Raise ProblemError unless ``integrator`` is a valid state for ``engine`` and that number of ``events``."""
    n, given, s, rows = engine.structure.n, engine.functions.given[0], integrator, integrator.last.t.size
    shapes: list[tuple[Any, dict[str, Any]]] = [
        (s.place, {"q": (n,), "v": (n,)}),
        (s.tolerances, {"rtol": (2 * n,), "atol": (2 * n,)}),
        (s.watch, {"values": (2 * events,)}),
        (s.last, {"t": (max(rows, 1),), "q": (rows, n), "v": (rows, n)}),
        *((found, {"q": (n,), "v": (n,)}) for found in s.occurrences),
    ]
    wrong = misfits(s.state, engine.layout, given)
    wrong += [text for owner, wanted in shapes for text in misshapen(owner, wanted)]
    wrong = wrong or _contradictions(s, given, events)
    if wrong:
        raise ProblemError(f"the checkpoint does not fit this system: {wrong[0]}.")


def _contradictions(s: IntegratorState, given: int, events: int) -> list[str]:
    """Texts on fields that contradict each other."""
    state, memory, t = s.state, s.state.memory, s.last.t
    named = {
        "either a step or tolerances are needed": (s.step is None) == (s.tolerances is None),
        "a step must not be zero": s.step == 0.0 or not (state.h is None or _is_length(state.h, state.t)),
        "the direction of time must be 1, -1 or 0": s.direction not in (-1.0, 0.0, 1.0),
        "sizes must not be negative": min(state.size_q, state.size_v) < 0,
        "State.factorised must be of a step": state.factorised is not None
        and not _is_factorised(state.factorised, state, given),
        "the next step must be positive": memory is not None and not memory.h_next > 0.0,
        "tolerances must not be negative": s.tolerances is not None
        and min(s.tolerances.rtol.min(), s.tolerances.atol.min()) < 0.0,
        f"there are {events} events": len(s.watch.counts) != events
        or len(s.watch.sides) not in (0, events)
        or not all(0 <= i < events for i in (*s.watch.changed, *(found.index for found in s.occurrences))),
        "the last step must end at the state": not t.size or t[-1] != state.t,
    }
    return [text for text, broken in named.items() if broken]


def _is_factorised(made: Factorised, state: State, given: int) -> bool:
    """True if a factorisation can have been made in a step that ended at ``state``, by its sizes and length."""
    n, step = state.q.size, made.at[made.at.size - given :]
    h, (q, v) = float(step[0]), np.split(step[BEFORE : BEFORE + 2 * n], 2)
    seen = float(np.abs(q).max()) <= state.size_q and float(np.abs(v).max()) <= state.size_v
    return seen and _is_length(h, state.t) and min(made.rate, made.uses, made.cost) >= 0


def _is_length(h: float, t: float) -> bool:
    """True if a step of ``h`` [s] can have ended at ``t``."""
    return max(float(np.spacing(abs(t))) / 2, SHORTEST) <= abs(h) <= LONGEST
