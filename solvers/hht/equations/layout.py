"""Which unknowns a step has, and how knowns and unknowns travel as single vectors."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import Structure
from solvers.hht.equations.formulas import EPS, digits, has_digit


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
    packed_size: int = field(init=False, compare=False)  #: length of the packed known values

    def __post_init__(self) -> None:
        unknowns = _unknowns(self.structure, self.end_unknown)
        scalars, arrays = _knowns(self.structure, self.end_unknown)
        for name, value in {
            "unknowns": unknowns,
            "scalars": scalars,
            "arrays": arrays,
            "size": sum(unknowns.values()),
            "packed_size": len(scalars) + sum(math.prod(shape) for shape in arrays.values()),
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

    def disturbed(self, vector: np.ndarray) -> np.ndarray:
        """The packed known values with array entries moved by one roundoff or not, by a fixed drawing of lots.

        All away from zero: the roundoff of regular values is not of both signs alike (of a chain at rest it was ten times
        what signs drawn by lot made of it).
        """
        return vector * _lots(vector.size, len(self.scalars))

    def disturbances(self, vector: Vector) -> Iterator[Vector]:
        """The packed known values with some of the coordinates moved by one roundoff, (H30)."""
        n, start = self.structure.n, len(self.scalars)
        for digit in range(digits(n)):
            for value in (0, 1):
                moved, at = vector.copy(), start
                for shape in self.arrays.values():
                    if shape == (n,):
                        moved[at : at + n][has_digit(np.arange(n), digit, value)] *= 1.0 + EPS
                    at += math.prod(shape)
                yield moved

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


@functools.lru_cache(maxsize=8)
def _lots(size: int, exact: int) -> np.ndarray:
    factors = 1.0 + np.random.default_rng(0).choice([0.0, EPS], size)
    factors[:exact] = 1.0
    return factors


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
