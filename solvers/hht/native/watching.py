"""Event functions in machine code, so that the compiled loops see in which step something happens."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.arguments import Vector
from hhtbench.lowering import Native, native
from solvers.hht.events import Event


def event_value(dynamics: Any, function: Callable[..., Any], t: Any, q: Any, v: Any) -> Any:
    """The value of an event function, (1,)."""
    return dynamics.xp.asarray(function(t, q, v), dtype=float).reshape(1)


def compiled_events(dynamics: Any, events: Sequence[Event], n: int) -> list[Native] | None:
    """Machine code of every event function; None where one of them is Python that JAX cannot trace."""
    try:
        return [native(event_value, dynamics, event.function, shapes=((), (n,), (n,))) for event in events]
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        return None


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
