"""Which unknowns a step has, and how they travel as one vector."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.lowering import Structure


@dataclass(frozen=True)
class Layout:
    """Which unknowns a step has; hashable, it selects the compiled code.

    The reaction of a stage is eliminated where it is an explicit function of the other unknowns, else its
    acceleration ``R`` is an unknown with a row ``M R - Q = 0`` of its own.
    """

    structure: Structure
    moving: bool  #: the end reaction is taken at a place that depends on q1
    end_unknown: bool  #: R1 is an unknown: it acts on q1 and is taken there, or the mass there is not known
    inverse_places: tuple[int, ...] | None = None  #: flat places where M^-1 can differ from zero; None: anywhere
    unknowns: dict[str, int] = field(init=False, compare=False)  #: names and sizes, in order; none of undeclared constraints
    size: int = field(init=False, compare=False)  #: number of unknowns

    def __post_init__(self) -> None:
        s = self.structure
        unknowns = {"a": s.n}
        if s.m:
            unknowns |= ({"R1": s.n} if self.end_unknown else {}) | {"lam0": s.m, "lam1": s.m}
        if s.p:
            unknowns |= {"Rk": s.n, "mu": s.p}
        object.__setattr__(self, "unknowns", unknowns)
        object.__setattr__(self, "size", sum(unknowns.values()))

    def sparse_inverse(self, inverse: Any, xp: Any) -> Any:
        """M^-1 (n, n) from its entries (n*n,): the zeros that are known are written down, so that none is multiplied by."""
        if self.inverse_places is not None:
            there = np.zeros(self.structure.n**2, dtype=bool)
            there[list(self.inverse_places)] = True
            inverse = xp.where(there, inverse, 0.0)
        return inverse.reshape(self.structure.n, -1)

    def split(self, vector: Any) -> dict[str, Any]:
        """The unknowns by name, from ``vector`` (size,)."""
        result, offset = {}, 0
        for name, size in self.unknowns.items():
            result[name] = vector[offset : offset + size]
            offset += size
        return result
