"""Generalised-alpha for constrained systems, (H39) to (H41): Chung and Hulbert (1993), Arnold and Bruels (2007)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hhtbench.lowering import Dynamics
from solvers.hht.equations.newmark import Newmark, Terms


@dataclass(frozen=True, kw_only=True)
class GeneralisedAlpha(Newmark):
    """Weights that damp vibrations of infinite frequency by ``rho_inf`` in [0, 1] and low ones least, (H39)."""

    rho_inf: float
    form: str  #: "ggl": stabilised, with both constraint levels; "index3": with positions only

    @property
    def alpha_m(self) -> float:
        """Weight of the earlier accelerations in the balance, (H39)."""
        return (2.0 * self.rho_inf - 1.0) / (self.rho_inf + 1.0)

    @property
    def alpha_f(self) -> float:
        """Weight of the earlier forces in the balance, (H39)."""
        return self.rho_inf / (self.rho_inf + 1.0)

    @property
    def alpha(self) -> float:  # type: ignore[override]
        """Offset of ``a`` in steps: a approximates v'(t + alpha h), (H41)."""
        return self.alpha_m - self.alpha_f

    def multipliers(self) -> tuple[str, ...]:
        """Names of the multipliers; ``eta`` of the stabilised form vanishes in the exact solution, (H40)."""
        return ("eta", "lam1") if self.form == "ggl" else ("lam1",)

    def terms(self, dynamics: Dynamics, start: Mapping[str, Any]) -> Terms:
        """Weights and known parts of one step, (H36), (H39), (H40)."""
        h, a0, of_last = start["h"], start["a0"], 1.0 / (1.0 - self.alpha_f)
        return Terms(
            q=start["q"] + h * start["v"] + h * h * (0.5 - self.beta) * a0,  # (H36)
            v=start["v"] + h * (1.0 - self.gamma) * a0,  # (H36)
            rate=of_last * (self.alpha_m * a0 - self.alpha_f * start["vdot"]),  # (H39)
            q_a=h * h * self.beta,
            v_a=h * self.gamma,
            rate_a=of_last * (1.0 - self.alpha_m),  # (H39)
            q_R0=0.5 * h * h,  # (H40)
        )
