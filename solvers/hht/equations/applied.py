"""Applied force where multipliers are extrapolated, (H55).

The multipliers among a step's unknowns are then corrections to the extrapolated ones, so that no digits cancel.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hhtbench.lowering import Dynamics


def applied_force(dynamics: Dynamics, known: Mapping[str, Any], t: Any, q: Any, v: Any) -> Any:
    """F (n,), plus the reaction of extrapolated multipliers where a step has these."""
    force, lam = dynamics.force(t, q, v), known.get("applied")
    return force if lam is None else force + dynamics.reaction(t, q, v, lam)  # (H55)


def applied_jacobians(dynamics: Dynamics, known: Mapping[str, Any], t: Any, q: Any, v: Any) -> tuple[Any, Any]:
    """Derivatives of the applied force by q and v, (n, n) each; None for one that is zero."""
    (by_q, by_v), lam = dynamics.force_jacobians(t, q, v), known.get("applied")
    if lam is None:
        return by_q, by_v
    reaction_q = dynamics.reaction_jacobians(t, q, v, lam)[0]  # (H55)
    return reaction_q if by_q is None else by_q + reaction_q, by_v


def whole(unknown: Mapping[str, Any], known: Mapping[str, Any], name: str) -> Any:
    """The total multipliers ``name`` of a step: the unknown correction plus the extrapolated part."""
    applied = known.get(f"applied_{name}")
    return unknown[name] if applied is None else unknown[name] + applied  # (H55)
