"""Mechanisms as plain data: points with masses, rods, springs, a blade; what they are turned, and in other units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

Pair = tuple[int, int]  # two points; from the number of points on the second is an anchor


class Unit(NamedTuple):
    """Powers of length, mass and time of a number, and whether it is a vector or has one a row."""

    length: int = 0
    mass: int = 0
    time: int = 0
    vector: bool = False


PARAMETERS = {  # with dim d, of r rods and s springs
    "mass": Unit(mass=1),  # (points,)
    "anchor": Unit(length=1, vector=True),  # (anchors, d)
    "gravity": Unit(length=1, time=-2, vector=True),  # (d,)
    "scale": Unit(),  # (r,) of the rods' rows
    "length": Unit(length=1),  # (r,)
    "stiffness": Unit(mass=1, time=-2),  # (s,)
    "natural": Unit(length=1),  # (s,)
    "damper": Unit(mass=1, time=-1),  # (s,)
    "drag": Unit(mass=1, time=-1),
    "growth": Unit(length=-2),  # of masses with the square of the distance from the origin
    "swing": Unit(length=1, vector=True),  # (d,) of the first anchor: swing sin(frequency (t - t0))
    "frequency": Unit(time=-1),
    "along": Unit(vector=True),  # (d,) of the blade: blade_scale ((along + turn SPIN x) . v - speed) = 0
    "turn": Unit(length=-1),
    "speed": Unit(length=1, time=-1),
    "blade_scale": Unit(),
    "friction": Unit(),
    "creep": Unit(length=1, time=-1),  # speed up to which friction is viscous
    "t0": Unit(time=1),
}
START = {  # (points, d) each, velocities before they are projected onto the constraints
    "places": Unit(length=1, vector=True),
    "velocities": Unit(length=1, time=-1, vector=True),
}


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a mechanism has, without a number; systems of one shape share their machine code."""

    dim: int
    points: int
    anchors: int = 1
    rods: tuple[Pair, ...] = ()
    springs: tuple[Pair, ...] = ()
    blade: Pair | None = None  #: the velocity of the first point is held by the place of the second
    driven: bool = False  #: the first anchor swings
    growing: bool = False  #: masses grow with the distance from the origin
    reaction: str = ""  #: declared as a "linear" one, or with "friction"

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.dim * self.points

    @cached_property
    def maps(self):
        """(d r, n) and (r, anchors) of rods, then of springs: their separations are the first of q less the second."""
        found = []
        for pairs in (self.rods, self.springs):
            table = np.zeros((len(pairs), self.points + self.anchors))
            for row, (i, j) in enumerate(pairs):
                table[row, i] += 1.0
                table[row, j] -= 1.0
            found.append((np.kron(table[:, : self.points], np.eye(self.dim)), -table[:, self.points :]))
        return found

    @cached_property
    def blade_maps(self):
        """(d, n) each: what of q is the blade's point, and the one that turns it."""
        return [np.kron(np.eye(self.points)[[i]], np.eye(self.dim)) for i in self.blade or ()]


@dataclass(frozen=True)
class Mechanism:
    """A shape with its numbers."""

    shape: Shape
    numbers: dict[str, Any]  #: by the names in ``PARAMETERS`` and ``START``, as plain data in SI units

    @cached_property
    def p(self) -> SimpleNamespace:
        """Them as arrays."""
        return SimpleNamespace(**{name: np.array(value, dtype=np.float64) for name, value in self.numbers.items()})

    def but(self, change) -> Mechanism:
        """With other numbers: ``change(name, value, unit)``."""
        units = PARAMETERS | START
        found = {name: np.asarray(change(name, x, units[name])) for name, x in vars(self.p).items()}
        return Mechanism(self.shape, {name: x.tolist() for name, x in found.items()})

    def in_units(self, length: float, mass: float, time: float) -> Mechanism:
        """With all numbers in other units, this many of which are one of before."""
        return self.but(lambda name, x, unit: x * length**unit.length * mass**unit.mass * time**unit.time)
