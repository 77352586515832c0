"""Event functions in machine code, so that the compiled loops see in which step something happens."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import equinox as eqx
import jax

from hhtbench.arguments import Vector
from hhtbench.errors import BudgetSpent
from hhtbench.lowering import Native, native
from solvers.hht.events import Event


def event_value(dynamics: Any, function: Callable[..., Any], seen: Any, t: Any, q: Any, v: Any) -> Any:
    """The value of an event function, (1,); ``seen`` tells functions apart that refer to other numbers by now."""
    return dynamics.xp.asarray(function(t, q, v), dtype=float).reshape(1)


class CompiledEvents:
    """Machine code of event functions, as long as what they refer to stays."""

    def __init__(self, dynamics: Any, events: Sequence[Event], n: int) -> None:
        self._functions = [event.function for event in events]
        self._seen = [seen_by(function) for function in self._functions]
        self._codes: list[Native] | None = None
        if None in self._seen:
            return
        shapes = (), (n,), (n,)
        try:
            self._codes = [
                native(event_value, dynamics, function, seen, shapes=shapes)
                for function, seen in zip(self._functions, self._seen, strict=True)
            ]
        except BudgetSpent:
            raise
        except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
            return

    @property
    def codes(self) -> list[Native] | None:
        """Of every event; None where one cannot be compiled, or refers to another number than before."""
        return self._codes if self._seen == [seen_by(function) for function in self._functions] else None


NUMBERS = (int, float, str, type(None))
LIBRARIES = ("jax", "numpy", "math")  # what their modules hold stays
BUILTINS = (abs, min, max, float, int, len, range, sum, pow, round)
DEEPEST = 4  # functions that call one another


def seen_by(function: Any, depth: int = 0) -> tuple[Any, ...] | None:
    """The numbers that ``function`` refers to; None where it refers to anything that could change unseen.

    A list that it appends to, say, would grow once, when it is traced, and never again.
    """
    if isinstance(function, MethodType) or not isinstance(function, FunctionType) or depth > DEEPEST:
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
    name = value.__name__ if isinstance(value, ModuleType) else type(value).__module__
    owner = getattr(value, "__module__", None) if callable(value) else None
    fixed = isinstance(value, (ModuleType, FunctionType, BuiltinFunctionType)) or callable(value)
    if isinstance(value, jax.Array | eqx.Module) or (fixed and _of_a_library(owner or name)):
        return "fixed", id(value)
    return None


def _of_a_library(module: str | None) -> bool:
    return (module or "").partition(".")[0] in LIBRARIES


@dataclass
class Watched:
    """Event functions as the loops take them, and their values (k,) where the loops stand."""

    events: Sequence[Event]
    codes: Sequence[Native]
    values: Vector

    def sections(self) -> dict[str, Any]:
        """Sections of integers."""
        return {
            "event_code": [number for code in self.codes for number in (code.address, code.parameters.ctypes.data)],
            "event_directions": [event.direction for event in self.events],
            "event_samples": [event.samples for event in self.events],
        }
