"""Which unknowns a step has, and how knowns and unknowns travel as single vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
    scalars: tuple[str, ...] = field(init=False, compare=False)  #: known numbers, in order
    arrays: dict[str, tuple[int, ...]] = field(init=False, compare=False)  #: known arrays and their shapes, in order
    size: int = field(init=False, compare=False)  #: number of unknowns

    def __post_init__(self) -> None:
        unknowns = _unknowns(self.structure, self.end_unknown)
        scalars, arrays = _knowns(self.structure, self.end_unknown)
        for name, value in {
            "unknowns": unknowns,
            "scalars": scalars,
            "arrays": arrays,
            "size": sum(unknowns.values()),
        }.items():
            object.__setattr__(self, name, value)

    def pack(self, values: Mapping[str, Any], xp: Any = np) -> Any:
        """The known values as one vector, in the array namespace ``xp``."""
        scalars = xp.asarray([values[name] for name in self.scalars])
        return xp.concatenate([scalars, *[values[name].ravel() for name in self.arrays]])

    def sparse_inverse(self, inverse: Any, xp: Any) -> Any:
        """M^-1 (n, n) from its entries (n*n,): the zeros that are known are written down, so that none is multiplied by."""
        if self.inverse_places is not None:
            there = np.zeros(self.structure.n**2, dtype=bool)
            there[list(self.inverse_places)] = True
            inverse = xp.where(there, inverse, 0.0)
        return inverse.reshape(self.structure.n, -1)

    def known(self, vector: Any) -> dict[str, Any]:
        """The inverse of :meth:`pack`."""
        result = {name: vector[i] for i, name in enumerate(self.scalars)}
        offset = len(self.scalars)
        for name, shape in self.arrays.items():
            size = math.prod(shape)
            result[name] = vector[offset : offset + size].reshape(shape)
            offset += size
        return result

    def split(self, vector: Any) -> dict[str, Any]:
        """The unknowns by name, from ``vector`` (size,)."""
        result, offset = {}, 0
        for name, size in self.unknowns.items():
            result[name] = vector[offset : offset + size]
            offset += size
        return result


def _unknowns(s: Structure, end_unknown: bool) -> dict[str, int]:
    sizes = {"a": s.n}
    if s.m:
        sizes |= {"R1": s.n} if end_unknown else {}
        sizes |= {"lam0": s.m, "lam1": s.m}
    if s.p:
        sizes |= {"Rk": s.n, "mu": s.p}
    return sizes


def _knowns(s: Structure, end_unknown: bool) -> tuple[tuple[str, ...], dict[str, tuple[int, ...]]]:
    n = s.n
    scalars: tuple[str, ...] = ("h", "t1", "alpha", "q_a", "v_a")
    arrays: dict[str, tuple[int, ...]] = {"q_known": (n,), "v_known": (n,), "f0": (n,)}
    if s.mass == "variable":
        arrays["inverse_mass"] = (n, n)
    if s.m:
        scalars += ("t0", "t_stage", "q_R0", "q_R1", "v_R0", "v_R1", "theta")
        arrays |= {"q0": (n,), "q_stage": (n,)}
        if s.mass == "variable" and not end_unknown:
            arrays["inverse_mass_stage"] = (n, n)
    if s.p:
        scalars += ("t_half",)
        arrays |= {"q_half": (n,), "v0": (n,)}
    return scalars, arrays
