"""Event functions as the loops call them: machine code where JAX can trace them, else callbacks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from types import FunctionType, ModuleType
from typing import Any

import equinox as eqx
import jax

from hhtbench.lowering import Dynamics, Native, native
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.lowering.dynamics.derive import parameters_of
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.events import Event
from solvers.hht.events.event import number_of
from solvers.hht.events.scan import EXTRA
from solvers.kernel.memory import DIRECTIONS, SAMPLES, Memory, integer_view

NUMBERS = (int, float, str, type(None))
LIBRARIES = ("jax", "numpy", "math")  # modules whose contents do not change
BUILTINS = (abs, min, max, float, int, len, range, sum, pow, round)
MAX_DEPTH = 4  # depth to which functions that call one another are followed


def event_value(dynamics: Dynamics, function: Callable[..., Any], seen: Any, t: Any, q: Any, v: Any) -> Any:
    """Value of an event function as (1,), for tracing; ``seen`` are the values it refers to, part of the cache key."""
    value = dynamics.xp.asarray(function(t, q, v))
    if value.ndim or value.dtype.kind not in "fiu":
        raise TypeError("no real number")  # the callback reports it to the user
    return value.astype(float).reshape(1)


class EventFunctions:
    """Addresses of event functions: machine code while the values they refer to stay, else callbacks."""

    def __init__(self, events: Sequence[Event], functions: Any, callbacks: Callbacks) -> None:
        self.events = tuple(events)
        self.samples = sum(event.samples + EXTRA for event in self.events)
        n = functions.layout.structure.n
        self._known = []  # per function: itself, values it refers to, machine code, address of the callback
        for event in self.events:
            seen, called = seen_by(event.function), callbacks.entry(partial(number_of, event), 1, ((), (n,), (n,)))
            code = None if functions.in_python else code_of(event, functions.dynamics, n)
            self._known.append((event.function, seen, code, called))

    def codes(self) -> list[int]:
        """Addresses of all functions and of their parameters, in pairs."""
        pairs = list[int]()
        for function, seen, code, called in self._known:
            pairs += code.pair if code is not None and seen == seen_by(function) else (called, 0)
        return pairs

    def fill(self, z: Memory) -> None:
        """Put directions and numbers of samples into the loops' memory."""
        integer_view(z, DIRECTIONS)[:] = [event.direction for event in self.events]
        integer_view(z, SAMPLES)[:] = [event.samples for event in self.events]


def code_of(event: Event, dynamics: Dynamics, n: int) -> Native | None:
    """Machine code of an event function of n coordinates; None if it cannot be, or refers to what could change."""
    seen = seen_by(event.function)
    if seen is None:
        return None
    try:
        return native(event_value, dynamics, event.function, seen, shapes=((), (n,), (n,)))
    except BudgetSpent:
        raise
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        return None


def seen_by(function: Any, depth: int = 0) -> tuple[Any, ...] | None:
    """The values that ``function`` refers to; None if it refers to anything that could change unnoticed.

    A list that it appends to, for instance, would grow once, at tracing, and never again.
    """
    if not isinstance(function, FunctionType) or depth > MAX_DEPTH:
        return None
    names = inspect.getclosurevars(function)
    values = [*names.nonlocals.values(), *names.globals.values(), *(function.__defaults__ or ())]
    called = [value for value in names.builtins.values() if value not in BUILTINS]
    seen = [_seen(value, depth) for value in values]
    return None if called or None in seen else tuple(seen)


def _seen(value: Any, depth: int) -> tuple[Any, ...] | None:
    """Hashable identity of one value that a function refers to; None if the value could change unnoticed."""
    if isinstance(value, NUMBERS):
        return type(value).__name__, value
    if isinstance(value, tuple):
        parts = tuple(_seen(part, depth) for part in value)
        return None if None in parts else parts
    if isinstance(value, FunctionType) and not _of_a_library(value.__module__):
        return seen_by(value, depth + 1)
    owner = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None) or type(value).__module__
    fixed = (isinstance(value, ModuleType) or callable(value)) and _of_a_library(owner)
    if isinstance(value, eqx.Module):  # its owner may write to an array that it holds
        return "module", id(value), parameters_of(value)
    return ("fixed", id(value)) if fixed or isinstance(value, jax.Array) else None


def _of_a_library(module: str | None) -> bool:
    return (module or "").partition(".")[0] in LIBRARIES
