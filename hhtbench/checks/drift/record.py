"""The drift of a solution as arrays over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import Printed


@dataclass(frozen=True)
class Level:
    """Drift at one level."""

    t: Vector  #: (r,) [s]
    value: Vector  #: (r,)


@dataclass(frozen=True, kw_only=True)
class Drift(Printed):
    """Drift at every state, divided by its scale; None for what does not exist."""

    sampled: str  #: "steps" or "rows"
    t: Vector  #: (k,) [s]
    h: Vector | None  #: (k - 1,) lengths of the internal steps [s]
    position: Vector | None  #: (k,)
    velocity: Vector | None  #: (k,)
    absolute: dict[str, float | None]  #: largest |g_i|, and |g_t + g_q v|_i or |k_i|, unscaled
    energy: Vector | None  #: (k,) change of the energy that the declared power does not account for
    energy_note: str | None  #: why there is none although an energy is declared
    invariants: dict[str, Vector]  #: name -> (k,)
    acceleration: Level | None  #: at times at which the solver holds multipliers of its own
    acceleration_note: str | None  #: why there is none although the system is constrained, or where it is not known

    def __repr__(self) -> str:
        names = ("position", "velocity", "acceleration", "energy")
        largest = {name: value for name, value in self.metrics().items() if name in names and value is not None}
        largest |= self.metrics()["invariants"]
        values = ", ".join(f"{name} {value:.2g}" for name, value in largest.items()) or "nothing that can drift"
        return f"<Drift, largest over {self.t.size} {'states' if self.sampled == 'steps' else 'rows'}: {values}>"

    def metrics(self) -> dict[str, Any]:
        """Return ``metrics["drift"]`` of a row: maxima over time."""
        values = {name: getattr(self, name) for name in ("position", "velocity", "energy")}
        values["acceleration"] = None if self.acceleration is None else self.acceleration.value
        largest = {name: None if value is None else np.nanmax(value) for name, value in values.items()}
        invariants = {name: np.nanmax(values) for name, values in self.invariants.items()}
        return {
            **largest,
            **self.absolute,
            "invariants": invariants,
            "sampled": self.sampled,
            "points": int(self.t.size),
            "acceleration_note": self.acceleration_note,
            "energy_note": self.energy_note,
        }
