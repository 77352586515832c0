"""Typical sizes of a problem, one per component, and the row that checks the declared ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.checks.problem.rows import attempt, yes_or_fault
from hhtbench.protocol.arguments import Vector, real_array
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem


@dataclass(frozen=True)
class Sizes:
    """Typical sizes of t, q, v, lam and mu; ones where the declared scales cannot be used."""

    t: float  #: [s] time over which the motion changes, at most 1
    q: Vector  #: (n,)
    v: Vector  #: (n,)
    lam: Vector  #: (m,)
    mu: Vector  #: (p,)


def sizes_of(problem: Problem, m: int | None, p: int | None) -> tuple[Sizes, Row]:
    """Return the declared scales broadcast to the components, and the row that checks them."""
    n = problem.q0.size
    found, faults = {}, []
    for name, size in (("q", n), ("v", n), ("lam", m), ("mu", p)):
        value = getattr(problem.scales, name)
        outcome = attempt(lambda name=name, value=value, size=size: _spread(name, value, size))  # type: ignore[misc]
        if outcome.fault:
            faults.append(outcome.fault)
        found[name] = np.ones(size or 0) if outcome.fault else outcome.value
    span = abs(problem.t_span[1] - problem.t_span[0])
    change = float(np.min(found["q"] / found["v"], initial=1.0)) if found["q"].size == found["v"].size else 1.0
    claim = "scales are positive and fit the components"
    row = yes_or_fault("data/scales", claim, "; ".join(faults), "fit", "above 0; a number or one per component")
    return Sizes(t=min(span, 1.0, change) or 1.0, **found), row


def _spread(name: str, value: Any, size: int | None) -> Vector:
    array = real_array(f"scales.{name}", value)
    if not np.all(array > 0):
        raise ValueError(f"scales.{name} must be above 0; got {array.min():g}")
    if size is None:
        return np.ones(0)
    if array.ndim > 0 and array.shape != (size,):
        raise ValueError(f"scales.{name} must be a number or have shape ({size},); got {array.shape}")
    return np.broadcast_to(array, (size,)).copy()
