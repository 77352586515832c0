"""Singular systems made regular: redundant constraints left out; :mod:`~.augmented` has singular masses.

Where rows of ``[g_q; k_v]`` depend on others and the start satisfies all of them, the motion is determined but the
multipliers are not: adding to them a vector of the null space of ``C^T`` changes nothing.  Independent rows give the same
motion; of all multipliers with the same reaction ``C^T [lam; mu]`` the one of smallest norm is reported, (H22).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.system import declared

_changed = Cache(64)


class ReducedDynamics(Wrapper):
    """``inner`` with only the rows ``position`` of g and ``velocity`` of k."""

    position: tuple[int, ...] = eqx.field(static=True)  #: kept rows of g
    velocity: tuple[int, ...] = eqx.field(static=True)  #: kept rows of k

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        return replace(self.inner.structure, m=len(self.position), p=len(self.velocity))

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of ``inner`` on the kept rows; multipliers of the rows left out are zero."""
        whole = self.inner.structure
        rows, size = (self.velocity, whole.p) if name.startswith("velocity") else (self.position, whole.m)
        kept = np.array(rows, dtype=int)
        if "reaction" in name:
            *place, multipliers = arguments
            arguments = *place, self.xp.asarray(np.eye(size)[:, kept]) @ multipliers
        value = super().call(name, *arguments)
        if name.endswith("reaction_jacobians"):
            *others, by_multipliers = value
            return *others, by_multipliers[:, kept]
        if name == "reaction_columns":
            return value[:, kept]
        return value[kept] if "constraint" in name else value


class FullMatrices(Wrapper):
    """``inner``, marked so that its functions are not replaced by products."""


def with_full_matrices(dynamics: Dynamics) -> FullMatrices:
    """``dynamics`` marked for full matrices; cached."""
    found: FullMatrices = remembered(dynamics, "full", lambda: FullMatrices(inner=dynamics))
    return found


def reduce_redundant(dynamics: Dynamics, redundant: tuple[int, ...]) -> ReducedDynamics | None:
    """``dynamics`` without the rows ``redundant`` of [g; k]; None if a declared reaction may need their multipliers."""
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")):
        return None
    s = dynamics.structure
    position = tuple(i for i in range(s.m) if i not in redundant)
    velocity = tuple(i for i in range(s.p) if s.m + i not in redundant)
    return remembered(dynamics, redundant, lambda: ReducedDynamics(inner=dynamics, position=position, velocity=velocity))


def remembered(dynamics: Dynamics, how: Hashable, change: Callable[[], Wrapper]) -> Any:
    """The result of ``change()`` for ``dynamics``, cached by ``how``."""
    return _changed.find((by_id(dynamics), how), change)


def unreduced(dynamics: Dynamics) -> Dynamics:
    """The dynamics with all rows of the constraints."""
    kept = _reduction(dynamics)
    return dynamics if kept is None else kept.inner


def redundant_rows(dynamics: Dynamics) -> tuple[int, ...]:
    """Rows of [g; k] that ``dynamics`` leaves out."""
    kept = _reduction(dynamics)
    if kept is None:
        return ()
    s = kept.inner.structure
    left = (*kept.position, *(s.m + i for i in kept.velocity))
    return tuple(i for i in range(s.m + s.p) if i not in set(left))


def padded(dynamics: Dynamics, lam: Matrix, mu: Matrix) -> tuple[Matrix, Matrix]:
    """Multipliers (k, kept) with zeros added for redundant rows: (k, m) and (k, p), the same reaction."""
    whole, kept = unreduced(dynamics), _reduction(dynamics)
    if kept is None:
        return lam, mu
    full = np.zeros((len(lam), whole.structure.m)), np.zeros((len(mu), whole.structure.p))
    full[0][:, list(kept.position)] = lam
    full[1][:, list(kept.velocity)] = mu
    return full


def _reduction(dynamics: Dynamics) -> ReducedDynamics | None:
    inner: Any = dynamics
    while type(inner).wraps and type(inner) is not ReducedDynamics:
        inner = inner.inner
    return inner if type(inner) is ReducedDynamics else None
