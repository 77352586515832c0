"""A case of the fuzzing as plain data, and how it is drawn by its seed."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

import numpy as np

from tests.fuzz.mechanism import Mechanism, Shape
from tests.fuzz.systems import Spoil

COMPILED = 50  # cases of machine code with one shape, which is compiled once
ANY_TWINS = ("rows", "elsewhere", "budget", "watched", "python")
TWINS = {  # families of cases, and what their runs are compared with
    "steps": (*ANY_TWINS, "algebra", "backward", "order"),
    "control": ANY_TWINS,
    "machine": ("callables", "python", "rows", "budget", "elsewhere"),
    "hostile": ("none",),
}
SPOILED = ("force", "constraint", "constraint_jacobian", "force_jacobians", "velocity_constraint", "reaction")
SPOILS = {"units": (-100, 100), "off": (-18, 0), "wrong": (-12, 1), "massless": (0, 0)}  # powers of ten


@dataclass(frozen=True, kw_only=True)
class Way:
    """How a mechanism is asked to be solved."""

    turns: float  #: of the interval, in radians of what is fastest at the start
    steps: int = 0  #: prescribed; 0: error control
    ratios: tuple[float, ...] = ()  #: of the prescribed steps, again and again
    rtol: float = 1e-4
    backward: bool = False
    options: dict = field(default_factory=dict)  #: of HHT
    watch: str = ""  #: an event of this kind: "terminal" or "change"
    declares: bool = True  #: the derivatives


@dataclass(frozen=True, kw_only=True)
class Case:
    """One mechanism, one way, and what it is compared with."""

    family: str
    made: Mechanism
    way: Way
    twin: str = "none"
    spoil: Spoil | None = None


class Draw(random.Random):
    """Numbers by seed."""

    def once(self, of: int) -> bool:
        """True once in so many draws."""
        return self.randrange(of) == 0

    def decades(self, low: int, high: int) -> float:
        """10^low .. 10^high."""
        return float(f"{10 ** (self.randint(2 * low, 2 * high) / 2):.3g}")

    def tenths(self, low: int, high: int) -> float:
        """A tenth of a whole number."""
        return self.randint(low, high) / 10


def shape_of(draw: Draw) -> Shape:
    """Chains, trees, loops, some rods doubled; without rods there are springs."""
    points, anchors = draw.randint(1, 5), draw.randint(1, 2)
    count = max(points + draw.choice((0, 0, 0, 1, -1, -2, 2)), 0)
    pairs, rods = [(i, j) for i in range(points) for j in range(points + anchors) if i != j], []
    for i in range(count):  # a tree, closed by the others
        rods.append(draw.choice([(i, j) for j in [points, *range(i)]] if i < points else pairs + 4 * rods))
    return Shape(
        dim=draw.choice((2, 2, 3)) if points < 4 else 2,
        points=points,
        anchors=anchors,
        rods=tuple(rods),
        springs=tuple(draw.choices(pairs, k=draw.randint(int(not rods), 3))),
        blade=(draw.randrange(points), draw.randrange(points)) if draw.once(5) else None,
        driven=count > 0 and draw.once(4),
        growing=draw.once(6),
        reaction=draw.choice(("", "", "", "linear", "friction")) if rods else "",
    )


def spots(draw: Draw, shape: Shape, flat: bool) -> np.ndarray:
    """Places of the points, then of the anchors, as rods and springs count them; ``flat``: on one line."""
    d, parents = shape.dim, dict(reversed(shape.rods))
    found = [np.zeros(d), 2.0 * np.eye(d)[0]][: shape.anchors]  # anchors, then points
    for i in range(shape.points):
        angles = [math.radians(draw.randint(-180, 180)) if not flat else -90 for _ in range(d - 1)]
        way = np.array([math.sin(angles[0]), -math.cos(angles[0]), *[math.sin(a) for a in angles[1:]]])
        parent = parents.get(i, shape.points)
        origin = found[0 if parent == shape.points else shape.anchors + parent]
        found.append(np.round(origin + draw.tenths(5, 15) * way, 6))
    return np.roll(found, -shape.anchors, axis=0)


def mechanism(draw: Draw, shape: Shape, wild: bool) -> Mechanism:
    """Numbers for ``shape``; ``wild``: of any size, places on one line among them."""
    d, places = shape.dim, spots(draw, shape, wild and draw.once(8))
    lengths, distances = ([float(np.linalg.norm(places[i] - places[j])) for i, j in x] for x in (shape.rods, shape.springs))
    stiff, heavy, damped = ((-2, 14), (-8, 8), (-2, 6)) if wild else ((-1, 4), (-1, 1), (-2, 1))
    vector = lambda: [draw.tenths(-20, 20) for _ in range(d)]  # noqa: E731
    return Mechanism(
        shape,
        {
            "places": places[: shape.points].tolist(),
            "velocities": [vector() for _ in range(shape.points)],
            "t0": draw.choice((1e9, -1e15) if wild else (0.5, -3.0, 100.0)) if draw.once(5) else 0.0,
            "mass": [draw.decades(*heavy) for _ in range(shape.points)],
            "anchor": places[shape.points :].tolist(),
            "gravity": [*draw.choice(((0.0, -9.81), (0.0, 0.0), (3.0, -9.0))), 0.0][:d],
            "scale": [draw.decades(-6, 6) if draw.once(4) else 1.0 for _ in lengths],
            "length": lengths,
            "stiffness": [draw.decades(*stiff) for _ in distances],
            "natural": [x * draw.tenths(5, 15) for x in distances],
            "damper": [draw.decades(*damped) if draw.once(3) else 0.0 for _ in distances],
            "drag": draw.decades(-2, 1) if draw.once(4) else 0.0,
            "growth": draw.tenths(1, 5) if shape.growing else 0.0,
            "swing": [x / 10 for x in vector()] if shape.driven else [0.0] * d,
            "frequency": draw.tenths(1, 100) if shape.driven else 0.0,
            "along": vector() if shape.blade else [0.0] * d,
            "turn": draw.tenths(-20, 20) if shape.blade else 0.0,
            "speed": draw.tenths(-10, 10) if shape.blade and draw.once(3) else 0.0,
            "blade_scale": 1.0,
            "friction": draw.tenths(0, 5) * (1.0 if wild else 0.1) if shape.reaction == "friction" else 0.0,
            "creep": draw.decades(-4 if wild else -1, 0),
        },
    )


def options(draw: Draw, wild: bool) -> dict:
    """Of HHT."""
    found = {"alpha": 0.0, "b": draw.choice((0.0, 0.25))}
    if not draw.once(3):
        half = draw.choice(("implicit", "implicit", "midpoint", "predictor", "midpoint_predictor"))
        b = 0.0 if half.startswith("midpoint") else draw.choice((0.0, 0.0, 0.2, 1.0))
        found = {"alpha": draw.choice((-0.05, -0.1, -0.3, -1 / 3)), "b": b, "reaction": half}
    others = {"start": draw.choice(("f0", "shifted", "trapezoidal")), "linsolver": "band"}  # runs are compared with others
    if wild:
        others |= {"min_step": draw.decades(-6, 0), "rescale_a": False}
    return found | {name: value for name, value in others.items() if draw.once(2)}


def way(draw: Draw, family: str) -> Way:
    """A gentle one, but for the hostile family."""
    wild = family == "hostile"
    by_error = draw.once(2) if wild or family == "machine" else family == "control"
    declares = family == "machine" or not draw.once(8)
    given = {
        "options": options(draw, wild),
        "backward": draw.once(5),
        "watch": draw.choice(("terminal", "change")) if draw.once(6) else "",
        "declares": declares,
    }
    fewer = 1 if declares else 4  # by differences an evaluation costs as much as a hundred
    extreme = wild and draw.once(3)  # all else of a hostile case is, so that most tell of a motion
    if by_error:
        rtol = draw.decades(-14 if extreme else -6, 0 if extreme else -2)
        long = draw.decades(-300, 3) if extreme else draw.tenths(2, 20)
        return Way(**given, rtol=rtol, turns=min(long, 60 * math.sqrt(rtol)) / fewer if not wild else long)
    steps = draw.randint(3, 16 // fewer)
    length = draw.decades(-12, 4) if extreme else draw.randint(2, 25) / 100
    ratios = tuple(draw.tenths(5, 15) for _ in range(draw.randint(2, 4))) if draw.once(4) else ()
    return Way(**given, steps=steps, turns=steps * length, ratios=ratios)


def spoil(draw: Draw) -> Spoil | None:
    """A fault of the user's, or none."""
    kind, where = draw.choice(("", "nan", "raise", *SPOILS)), draw.choice(SPOILED)
    if not kind:
        return None
    return Spoil(kind, where, draw.decades(*SPOILS[kind]) if kind in SPOILS else draw.tenths(0, 10))


def drawn(family: str, number: int) -> Case:
    """Of one of the families in ``TWINS``, by its seed."""
    draw, wild = Draw(f"{family} {number}"), family == "hostile"
    shape = shape_of(Draw(number // COMPILED) if family == "machine" else draw)
    return Case(
        family=family,
        made=mechanism(draw, shape, wild),
        way=way(draw, family),
        twin=draw.choice(TWINS[family]),
        spoil=spoil(draw) if wild else None,
    )
