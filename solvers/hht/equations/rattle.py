"""RATTLE, (H43): Andersen (1983)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hhtbench.lowering import Dynamics
from solvers.hht.equations.discretise import accelerate
from solvers.hht.equations.newmark import Newmark, Terms


@dataclass(frozen=True, kw_only=True)
class Rattle(Newmark):
    """Weights of RATTLE (leapfrog); symplectic where the mass is constant and forces have a potential."""

    alpha: ClassVar[float] = 0.0  # type: ignore[misc]
    beta: ClassVar[float] = 0.0  #: no end acceleration in the position

    def multipliers(self) -> tuple[str, ...]:
        """Names of the multipliers: at the start for the positions, at the end for the velocities."""
        return ("lam0", "lam1")

    def terms(self, dynamics: Dynamics, start: Mapping[str, Any]) -> Terms:
        """Weights and known parts of one step, (H43)."""
        h, v = start["h"], start["v"]
        f0 = accelerate(dynamics, start, dynamics.force(start["t"], start["q"], v))
        half = v + 0.5 * h * f0  # (H43)
        q = start["q"] + h * half
        return Terms(q=q, v=half, rate=0.0 * v, q_a=0.0, v_a=0.5 * h, q_R0=0.5 * h * h, v_R0=0.5 * h)  # (H43)
