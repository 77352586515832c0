"""HHT-I3, (H42): Negrut, Rampalli, Ottarsson and Sajdak (2007), the method of ADAMS and Chrono."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hhtbench.lowering import Dynamics
from solvers.hht.equations.newmark import Newmark, Terms


@dataclass(frozen=True, kw_only=True)
class HHTI3(Newmark):
    """Weights of HHT-alpha, ``alpha`` in [-1/3, 0], (H3), with the reactions among the forces."""

    alpha: float

    def multipliers(self) -> tuple[str, ...]:
        """Names of the multipliers: one set, since only positions are constrained, (H38)."""
        return ("lam1",)

    def terms(self, dynamics: Dynamics, start: Mapping[str, Any]) -> Terms:
        """Weights and known parts of one step, (H36), (H42)."""
        h, a0, at = start["h"], start["a0"], (start["t"], start["q"], start["v"])
        before = dynamics.force(*at)
        if dynamics.structure.m:
            before = before + dynamics.reaction(*at, start["lam"])
        return Terms(
            q=start["q"] + h * start["v"] + h * h * (0.5 - self.beta) * a0,  # (H36)
            v=start["v"] + h * (1.0 - self.gamma) * a0,  # (H36)
            rate=0.0 * a0,
            q_a=h * h * self.beta,
            v_a=h * self.gamma,
            end=1.0 + self.alpha,  # (H42)
            earlier=-self.alpha * before,  # (H42)
        )
