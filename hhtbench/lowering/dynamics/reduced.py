"""Redundant constraints left out: the equations with independent rows only, and minimum-norm multipliers of all rows.

Where rows of ``[g_q; k_v]`` depend on others and the start satisfies all of them, the motion is determined but the
multipliers are not: adding to them a vector of the null space of ``C^T`` changes nothing.  Independent rows give the same
motion; of all multipliers with the same reaction ``C^T [lam; mu]`` the one of smallest norm is reported, (H22).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.protocol import declared


class ReducedDynamics(Wrapper):
    """The functions of ``inner`` with the rows ``position`` of g and ``velocity`` of k only."""

    position: tuple[int, ...] = eqx.field(static=True)  #: kept rows of g
    velocity: tuple[int, ...] = eqx.field(static=True)  #: kept rows of k

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        return replace(self.inner.structure, m=len(self.position), p=len(self.velocity))

    def call(self, name: str, *arguments: Any) -> Any:
        """Functions of k and Q_k are called velocity_...; to Q and Q_k multipliers of the rows left out are zero."""
        whole = self.inner.structure
        rows, size = (self.velocity, whole.p) if name.startswith("velocity") else (self.position, whole.m)
        kept = np.array(rows, dtype=int)
        if "reaction" in name:
            *place, multipliers = arguments
            arguments = *place, self.xp.asarray(np.eye(size)[:, kept]) @ multipliers
        value = super().call(name, *arguments)
        if name.endswith("reaction_jacobians"):
            return value[0], value[1][:, kept]
        return value[kept] if "constraint" in name else value


def reduce_redundant(dynamics: Dynamics, redundant: tuple[int, ...]) -> ReducedDynamics | None:
    """``dynamics`` without the rows ``redundant`` of [g; k]; None where a declared reaction may need their multipliers."""
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")):
        return None
    s = dynamics.structure
    position = tuple(i for i in range(s.m) if i not in redundant)
    velocity = tuple(i for i in range(s.p) if s.m + i not in redundant)
    return ReducedDynamics(inner=dynamics, position=position, velocity=velocity)


def unreduced(dynamics: Dynamics) -> Dynamics:
    """The dynamics with all rows of the constraints."""
    kept = _reduction(dynamics)
    return dynamics if kept is None else kept.inner


def padded(dynamics: Dynamics, lam: Matrix, mu: Matrix) -> tuple[Matrix, Matrix]:
    """Multipliers (k, kept) with a zero for every redundant row: (k, m) and (k, p), the same reaction."""
    whole, kept = unreduced(dynamics), _reduction(dynamics)
    if kept is None:
        return lam, mu
    full = np.zeros((len(lam), whole.structure.m)), np.zeros((len(mu), whole.structure.p))
    full[0][:, list(kept.position)] = lam
    full[1][:, list(kept.velocity)] = mu
    return full


def minimum_norm(rows: Matrix, multipliers: Vector, rank: int) -> Vector:
    """The multipliers of least norm with the same reaction ``rows^T multipliers``; ``rows`` (m + p, n) is [g_q; k_v].

    ``rank`` is that of the consistent configuration: off the constraints by an error, the rows are independent by as little,
    and a rank found by a tolerance would jump there.
    """
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(left[:, :rank] @ ((right[:rank] @ (rows.T @ multipliers)) / size[:rank]), dtype=np.float64)


def _reduction(dynamics: Dynamics) -> ReducedDynamics | None:
    inner: Any = dynamics
    while isinstance(inner, Wrapper) and not isinstance(inner, ReducedDynamics):
        inner = inner.inner
    return inner if isinstance(inner, ReducedDynamics) else None
