"""Mechanisms as plain data: points with masses, rods, springs, a blade; what they are made of, turned and in other units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

Row = tuple[float, ...]
Pair = tuple[int, int]  # two points; from the number of points on the second is an anchor


def table(x) -> tuple[Row, ...]:
    """A matrix as plain data."""
    return tuple(tuple(row) for row in np.asarray(x, dtype=np.float64).tolist())


def incidence(pairs, points, anchors):
    """(r, points) and (r, anchors): separations are the first times the points less the second times the anchors."""
    of_points, of_anchors = np.zeros((len(pairs), points)), np.zeros((len(pairs), anchors))
    for row, (i, j) in enumerate(pairs):
        of_points[row, i] += 1.0
        if j < points:
            of_points[row, j] -= 1.0
        else:
            of_anchors[row, j - points] += 1.0
    return of_points, of_anchors


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
        """(d r, n) and (r, anchors) of rods, then of springs: as :func:`incidence`, for coordinates."""
        pairs = [incidence(given, self.points, self.anchors) for given in (self.rods, self.springs)]
        return [(np.kron(points, np.eye(self.dim)), anchors) for points, anchors in pairs]


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """A shape with its numbers, in SI units."""

    shape: Shape
    places: tuple[Row, ...]  #: (points, d) at the start
    velocities: tuple[Row, ...]  #: (points, d) there, before they are projected onto the constraints
    masses: Row
    anchor: tuple[Row, ...]
    gravity: Row
    scales: Row = ()  #: of the rods' rows
    springs: tuple[Row, ...] = ()  #: stiffness, natural length over that at the start, damper
    drag: float = 0.0
    growth: float = 0.0  #: of masses, [1/m^2]
    swing: Row = ()  #: amplitude of the first anchor
    frequency: float = 0.0
    along: Row = ()  #: of the blade: scale ((along + turn x) . v - speed) = 0
    turn: tuple[Row, ...] = ()
    speed: float = 0.0
    blade_scale: float = 1.0
    friction: float = 0.0
    creep: float = 1e-2  #: speed up to which friction is viscous
    t0: float = 0.0

    def rotated(self, rotation) -> Mechanism:
        """In another frame, whose axes are the rows of ``rotation`` (d, d)."""
        turned = {name: table(np.array(getattr(self, name)) @ rotation.T) for name in ("places", "velocities", "anchor")}
        turned |= {name: tuple((rotation @ getattr(self, name)).tolist()) for name in ("gravity",)}
        turned |= {
            name: tuple((rotation @ getattr(self, name)).tolist()) for name in ("swing", "along") if getattr(self, name)
        }
        return replace(self, **turned, turn=table(rotation @ self.turn @ rotation.T) if self.turn else ())

    def in_units(self, length: float, mass: float, time: float) -> Mechanism:
        """With all numbers in other units, this many of which are one of before."""
        speed, force = length / time, mass * length / time**2
        sizes = {
            "places": length,
            "velocities": speed,
            "masses": mass,
            "anchor": length,
            "gravity": speed / time,
            "drag": mass / time,
            "growth": length**-2,
            "swing": length,
            "frequency": 1 / time,
            "turn": 1 / length,
            "speed": speed,
            "creep": speed,
            "t0": time,
        }
        changed = {name: _times(getattr(self, name), size) for name, size in sizes.items()}
        springs = tuple((k * force / length, ratio, c * force / speed) for k, ratio, c in self.springs)
        return replace(self, **changed, springs=springs)

    def rescaled(self, factor: float) -> Mechanism:
        """With the rows of the constraints times ``factor``, those of rods in turn divided by it."""
        scales = tuple(scale * factor ** (-1) ** i for i, scale in enumerate(self.scales))
        return replace(self, scales=scales, blade_scale=self.blade_scale * factor)


def _times(value, size):
    """Plain data of any depth, times a number."""
    return tuple(_times(part, size) for part in value) if isinstance(value, tuple) else value * size
