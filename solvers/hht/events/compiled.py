"""Event functions as the loops take them: machine code where JAX can trace them, else callbacks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from types import FunctionType, ModuleType
from typing import Any

import equinox as eqx
import jax

from hhtbench.errors import BudgetSpent
from hhtbench.lowering import Dynamics, Native, native
from hhtbench.lowering.dynamics.foreign import Callbacks
from solvers.hht.events.event import Event, number_of
from solvers.hht.events.scan import EXTRA
from solvers.hht.loops.memory import DIRECTIONS, SAMPLES, Memory, integer_view


def event_value(dynamics: Dynamics, function: Callable[..., Any], seen: Any, t: Any, q: Any, v: Any) -> Any:
    """The value of an event function, (1,); ``seen`` tells functions apart that refer to other numbers by now."""
    value = dynamics.xp.asarray(function(t, q, v))
    if value.ndim or value.dtype.kind not in "fiu":
        raise TypeError("no real number")  # the callback says it to the user
    return value.astype(float).reshape(1)


class EventFunctions:
    """Addresses of event functions; of machine code as long as what they refer to stays."""

    def __init__(self, events: Sequence[Event], functions: Any, callbacks: Callbacks) -> None:
        self.events = tuple(events)
        self.samples = sum(event.samples + EXTRA for event in self.events)
        n = functions.layout.structure.n
        self._known = []  # of every function: itself, what it refers to, its machine code, the address of a callback
        for event in self.events:
            seen, called = seen_by(event.function), callbacks.entry(partial(number_of, event), 1, ((), (n,), (n,)))
            self._known.append((event.function, seen, _compiled(functions, event, seen, n), called))

    def codes(self) -> list[int]:
        """Addresses of every function and of its parameters."""
        pairs = list[int]()
        for function, seen, code, called in self._known:
            pairs += code.pair if code is not None and seen == seen_by(function) else (called, 0)
        return pairs

    def fill(self, z: Memory) -> None:
        """Put what does not change into the loops' memory."""
        integer_view(z, DIRECTIONS)[:] = [event.direction for event in self.events]
        integer_view(z, SAMPLES)[:] = [event.samples for event in self.events]


def _compiled(functions: Any, event: Event, seen: Any, n: int) -> Native | None:
    if seen is None or functions.in_python:
        return None
    try:
        return native(event_value, functions.dynamics, event.function, seen, shapes=((), (n,), (n,)))
    except BudgetSpent:
        raise
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        return None


NUMBERS = (int, float, str, type(None))
LIBRARIES = ("jax", "numpy", "math")  # what their modules hold stays
BUILTINS = (abs, min, max, float, int, len, range, sum, pow, round)
DEEPEST = 4  # functions that call one another


def seen_by(function: Any, depth: int = 0) -> tuple[Any, ...] | None:
    """The numbers that ``function`` refers to; None where it refers to anything that could change unseen.

    A list that it appends to, say, would grow once, when it is traced, and never again.
    """
    if not isinstance(function, FunctionType) or depth > DEEPEST:
        return None
    names = inspect.getclosurevars(function)
    values = [*names.nonlocals.values(), *names.globals.values(), *(function.__defaults__ or ())]
    called = [value for value in names.builtins.values() if value not in BUILTINS]
    seen = [_seen(value, depth) for value in values]
    return None if called or None in seen else tuple(seen)


def _seen(value: Any, depth: int) -> tuple[Any, ...] | None:
    """What there is to see of one value."""
    if isinstance(value, NUMBERS):
        return type(value).__name__, value
    if isinstance(value, tuple):
        parts = tuple(_seen(part, depth) for part in value)
        return None if None in parts else parts
    if isinstance(value, FunctionType) and not _of_a_library(value.__module__):
        return seen_by(value, depth + 1)
    owner = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None) or type(value).__module__
    fixed = (isinstance(value, ModuleType) or callable(value)) and _of_a_library(owner)
    return ("fixed", id(value)) if fixed or isinstance(value, jax.Array | eqx.Module) else None


def _of_a_library(module: str | None) -> bool:
    return (module or "").partition(".")[0] in LIBRARIES
