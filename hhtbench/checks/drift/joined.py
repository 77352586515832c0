"""The drift of a motion with several systems, from that of its phases."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hhtbench.checks.drift.record import Drift, Level
from hhtbench.protocol.arguments import Vector


def joined(parts: Sequence[Drift]) -> Drift | None:
    """Join the drift of phases in the order of time; None if there is none.

    Where a phase has no such quantity, it is NaN in the states of this phase.
    """
    if not parts:
        return None

    def values(quantity: Any) -> Vector | None:
        """Join one quantity; None if no phase has it."""
        found = [quantity(part) for part in parts]
        if all(value is None for value in found):
            return None
        filled = [np.full(part.t.size, np.nan) if value is None else value for part, value in zip(parts, found, strict=True)]
        return np.concatenate(filled)

    def note(name: str) -> str | None:
        return "; ".join(dict.fromkeys(text for part in parts if (text := getattr(part, name)))) or None

    own = [part.acceleration for part in parts if part.acceleration is not None]
    level = Level(*(np.concatenate([getattr(one, name) for one in own]) for name in ("t", "value"))) if own else None
    names = sorted({name for part in parts for name in part.invariants})
    absolute = {
        name: max((value for part in parts if (value := part.absolute[name]) is not None), default=None)
        for name in parts[0].absolute
    }
    return Drift(
        sampled="rows",
        t=np.concatenate([part.t for part in parts]),
        h=None,
        position=values(lambda part: part.position),
        velocity=values(lambda part: part.velocity),
        absolute=absolute,
        energy=values(lambda part: part.energy),
        energy_note=note("energy_note"),
        invariants={name: _known(values(lambda part, name=name: part.invariants.get(name))) for name in names},
        acceleration=level,
        acceleration_note=note("acceleration_note"),
    )


def _known(value: Vector | None) -> Vector:
    return np.zeros(0) if value is None else value
