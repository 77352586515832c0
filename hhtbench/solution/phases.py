"""Parts of a motion with several systems, and impulses between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhtbench.protocol.arguments import Vector


@dataclass(frozen=True, kw_only=True)
class Impact:
    """An impulse by events: ``M (v after - v before)``, and the multipliers that give it."""

    t: float  #: [s]
    event: str  #: its name; those of several with rebounds at one time
    impulse: Vector  #: (n,) [N s]
    lam: Vector  #: (m,) of the position constraints of the system after it, as forces over time [N s]
    mu: Vector  #: (p,) of the velocity constraints
    contact: Vector  #: (k,) along the distances of these events, if they have a restitution [N s]


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A part of a motion in which one system holds."""

    system: Any
    event: str  #: name of the event that began it; "" at the start
    t: float  #: its start [s]
    q: Vector  #: (n,) there
    v: Vector  #: (n,) there, after the impact
    first: int  #: its first row in the Solution
    stop: int  #: the row behind its last

    @property
    def rows(self) -> slice:
        """Its rows in the Solution."""
        return slice(self.first, self.stop)
