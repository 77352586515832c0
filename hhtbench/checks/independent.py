"""Remove redundant constraints from a system."""

from __future__ import annotations

from hhtbench.lowering import ConstraintLevels, Dynamics, reduce_redundant
from hhtbench.protocol.arguments import Vector


def independent(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> tuple[Dynamics | None, tuple[int, ...]]:
    """Return ``dynamics`` without the rows of [g; k] that are redundant at (t, q, v), and the indices of these rows.

    The first is None if a declared reaction may depend on every multiplier.
    """
    if not dynamics.structure.constrained:
        return dynamics, ()
    redundant = ConstraintLevels(dynamics, full=True).at(t, q, v).rank.redundant
    return reduce_redundant(dynamics, redundant) if redundant else dynamics, redundant
