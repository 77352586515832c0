"""Event functions in machine code, so that the compiled loops see in which step something happens."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import Native, native
from solvers.hht.events import Event


def event_value(dynamics: Any, function: Callable[..., Any], t: Any, q: Any, v: Any) -> Any:
    """The value of an event function, (1,)."""
    return dynamics.xp.asarray(function(t, q, v), dtype=float).reshape(1)


def compiled_events(dynamics: Any, events: Sequence[Event], n: int) -> list[Native] | None:
    """Machine code of every event function; None where one keeps something between calls, or JAX cannot trace it."""
    if not all(looks_pure(event.function) for event in events):
        return None
    try:
        return [native(event_value, dynamics, event.function, shapes=((), (n,), (n,))) for event in events]
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        return None


CONSTANTS = (
    int,
    float,
    str,
    type(None),
    np.generic,
    np.ndarray,
    jax.Array,
    eqx.Module,
    ModuleType,
    BuiltinFunctionType,
    type,
)
DEEPEST = 4  # functions that call one another


def looks_pure(function: Any, depth: int = 0) -> bool:
    """Whether nothing that ``function`` refers to is of a kind that could change between two calls, as far as can be seen.

    A list that it appends to, say, would grow once, when it is traced, and never again.
    """
    if isinstance(function, MethodType) or not isinstance(function, FunctionType) or depth > DEEPEST:
        return False
    names = inspect.getclosurevars(function)
    values = [*names.nonlocals.values(), *names.globals.values(), *(function.__defaults__ or ())]
    return all(_constant(value, depth) for value in values)


def _constant(value: Any, depth: int) -> bool:
    if isinstance(value, tuple):
        return all(_constant(entry, depth) for entry in value)
    if isinstance(value, FunctionType):
        return value.__module__.startswith("jax") or looks_pure(value, depth + 1)
    return isinstance(value, CONSTANTS) or type(value).__module__.split(".")[0] in ("jax", "jaxlib", "numpy")


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
