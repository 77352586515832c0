"""A case of the fuzzing as plain data, and how hypothesis draws one."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import Flaky

from tests.fuzz.mechanism import Mechanism, Shape
from tests.fuzz.systems import Spoil

ANY_TWINS = ("rows", "units", "rescaled", "budget", "watched", "python")
TWINS = {  # families of cases, and what their runs are compared with
    "steps": (*ANY_TWINS, "rotated", "algebra", "reversed", "order"),
    "control": ANY_TWINS,
    "machine": ("callables", "python", "rows", "budget", "rescaled"),
    "hostile": ("none",),
}
SPOILED = ("force", "constraint", "constraint_jacobian", "force_jacobians", "velocity_constraint", "reaction")
SPOILS = {"units": (-100, 100), "off": (-18, 0), "noise": (-14, -4), "wrong": (-12, 1), "massless": (0, 0)}  # powers of ten


@dataclass(frozen=True, kw_only=True)
class Way:
    """How a mechanism is asked to be solved."""

    turns: float  #: of the interval, in radians of what is fastest at the start
    steps: int = 0  #: prescribed; 0: error control
    ratios: tuple[float, ...] = ()  #: of the prescribed steps, again and again
    rtol: float = 1e-4
    backward: bool = False
    options: dict = field(default_factory=dict)  #: of HHT
    budget: dict = field(default_factory=dict)  #: of the request
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


def drawn(values, number: int, broken=None):
    """One of ``values`` by seed, or the simplest for which ``broken`` holds, if that is so of the one.

    Within one run hypothesis varies parts of what it has drawn, and takes six of seven values from others: so every value
    has a run of its own, whose first is the simplest of all.  The second begins otherwise: with a number that nobody reads,
    or no value would begin as the simplest does.
    """
    found: list = []

    @seed(number)
    @settings(
        max_examples=2,
        phases=[Phase.generate, Phase.shrink],
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 2**32), values)
    def keep(_, value):
        if broken is None or broken(value):
            found.append(value)
        assert broken is None or not found

    with suppress(AssertionError, Flaky):
        keep()
    return found[-1] if found else None


def decades(low: int, high: int):
    """10^low .. 10^high, simplest at 1."""
    return st.integers(2 * low, 2 * high).map(lambda x: float(f"{10 ** (x / 2):.3g}"))


def tenths(low: int, high: int):
    """A tenth of a whole number."""
    return st.integers(low, high).map(lambda x: x / 10)


def perhaps(values, plain, of: int):
    """``plain``, and once in so many draws one of ``values``."""
    return st.integers(0, of - 1).flatmap(lambda x: values if x == of - 1 else st.just(plain))


@dataclass(frozen=True)
class World:
    """The kinds of mechanisms and the methods that the cases of one process are drawn from: each is compiled once.

    Mechanisms of one kind have its sizes, and other rods; those of the family "machine" have its rods too.
    """

    kinds: tuple[Shape, ...]
    methods: tuple[dict, ...]  #: options of HHT: alpha, b, reaction; the first is symmetric

    @classmethod
    def drawn(cls, number: int, count: int = 6) -> World:
        """By seed."""
        some, ways = ([drawn(x, 100 * number + i) for i in range(count)] for x in (kinds(), methods()))
        return cls(tuple(some), ({"alpha": 0.0, "b": (0.0, 0.25)[number % 2]}, *ways[: count // 3]))

    def shapes(self, family: str):
        """Of mechanisms in a case."""
        if family == "machine":
            return st.sampled_from(self.kinds[: 1 + len(self.kinds) // 4])
        return st.sampled_from(self.kinds).flatmap(wired)


@st.composite
def kinds(draw) -> Shape:
    """Chains, trees, loops, with redundant rows or without rods."""
    known, points = st.sampled_from, draw(st.integers(1, 5))
    rods = max(points + draw(known((0, 0, 0, 1, -1, -2, 2))), 0)
    sizes = Shape(
        dim=draw(known((2, 2, 3))) if points < 4 else 2,
        points=points,
        anchors=draw(st.integers(1, 2)),
        rods=((0, 0),) * rods,
        blade=draw(perhaps(st.just((0, 0)), None, 5)),
        driven=rods > 0 and draw(perhaps(st.just(True), False, 4)),
        growing=draw(perhaps(st.just(True), False, 6)),
        reaction=draw(known(("", "", "", "linear", "friction"))) if rods else "",
    )
    return draw(wired(sizes))


@st.composite
def wired(draw, kind: Shape) -> Shape:
    """A tree of as many rods, closed by further ones, some of them doubled; without rods there are springs."""
    points, known, rods = kind.points, st.sampled_from, []
    pairs = [(i, j) for i in range(points) for j in range(points + kind.anchors) if i != j]
    for i in range(len(kind.rods)):
        tree = [(i, j) for j in [points, *range(i)]]
        rods.append(draw(known(tree if i < points else pairs + 4 * rods)))
    springs = draw(st.lists(known(pairs), min_size=int(not rods), max_size=3))
    blade = draw(st.tuples(*[st.integers(0, points - 1)] * 2)) if kind.blade else None
    return replace(kind, rods=tuple(rods), springs=tuple(springs), blade=blade)


@st.composite
def methods(draw) -> dict:
    """Damped ones."""
    known = st.sampled_from
    half = draw(known(("implicit", "implicit", "midpoint", "predictor", "midpoint_predictor")))
    b = 0.0 if half.startswith("midpoint") else draw(known((0.0, 0.0, 0.2, 1.0)))
    return {"alpha": draw(known((-0.05, -0.1, -0.3, -1 / 3))), "b": b, "reaction": half}


@st.composite
def mechanisms(draw, shape: Shape, *, wild: bool = False) -> Mechanism:
    """Numbers for ``shape``; ``wild``: of any size, places on one line among them."""
    d, flat, r, s = shape.dim, wild and draw(perhaps(st.just(True), False, 8)), len(shape.rods), len(shape.springs)
    rows = lambda k, values: draw(st.lists(values, min_size=k, max_size=k))  # noqa: E731
    parents = dict(reversed(shape.rods))
    spots = [np.zeros(d), 2.0 * np.eye(d)[0]][: shape.anchors]  # anchors, then points
    for i in range(shape.points):
        angles = [math.radians(draw(st.integers(-180, 180)) if not flat else -90) for _ in range(d - 1)]
        way = np.array([math.sin(angles[0]), -math.cos(angles[0]), *[math.sin(a) for a in angles[1:]]])
        parent = parents.get(i, shape.points)
        origin = spots[0 if parent == shape.points else shape.anchors + parent]
        spots.append(np.round(origin + draw(tenths(5, 15)) * way, 6))
    spots = np.roll(spots, -shape.anchors, axis=0)  # points, then anchors, as rods and springs count them
    lengths, distances = ([float(np.linalg.norm(spots[i] - spots[j])) for i, j in x] for x in (shape.rods, shape.springs))
    stiff, heavy = (decades(-2, 14), decades(-8, 8)) if wild else (decades(-1, 4), decades(-1, 1))
    vector = st.lists(tenths(-20, 20), min_size=d, max_size=d)
    return Mechanism(
        shape,
        {
            "places": spots[: shape.points].tolist(),
            "velocities": rows(shape.points, vector),
            "t0": draw(perhaps(st.sampled_from([1e9, -1e15] if wild else [0.5, -3.0, 100.0]), 0.0, 5)),
            "mass": rows(shape.points, heavy),
            "anchor": spots[shape.points :].tolist(),
            "gravity": [*draw(st.sampled_from([(0.0, -9.81), (0.0, 0.0), (3.0, -9.0)])), 0.0][:d],
            "scale": rows(r, perhaps(decades(-6, 6), 1.0, 4)),
            "length": lengths,
            "stiffness": rows(s, stiff),
            "natural": [x * draw(tenths(5, 15)) for x in distances],
            "damper": rows(s, perhaps(decades(-2, 6 if wild else 1), 0.0, 3)),
            "drag": draw(perhaps(decades(-2, 1), 0.0, 4)),
            "growth": draw(tenths(1, 5)) if shape.growing else 0.0,
            "swing": [x / 10 for x in draw(vector)] if shape.driven else [0.0] * d,
            "frequency": draw(tenths(1, 100)) if shape.driven else 0.0,
            "along": draw(vector) if shape.blade else [0.0] * d,
            "turn": draw(tenths(-20, 20)) if shape.blade else 0.0,
            "speed": draw(perhaps(tenths(-10, 10), 0.0, 3)) if shape.blade else 0.0,
            "blade_scale": 1.0,
            "friction": draw(tenths(0, 5)) * (1.0 if wild else 0.1) if shape.reaction == "friction" else 0.0,
            "creep": draw(decades(-4 if wild else -1, 0)),
        },
    )


def options(world: World, *, wild: bool):
    """Of HHT."""
    known = st.sampled_from
    others = {
        "start": known(("f0", "shifted", "trapezoidal")),
        "linsolver": st.just("band"),  # others: what runs are compared with
    }
    if wild:
        others |= {"min_step": decades(-6, 0), "rescale_a": st.just(False)}
    return st.tuples(known(world.methods), st.fixed_dictionaries({}, optional=others)).map(lambda x: x[0] | x[1])


@st.composite
def ways(draw, family: str, world: World) -> Way:
    """Gentle ones, but for the hostile family."""
    wild, known = family == "hostile", st.sampled_from
    by_error = draw(st.booleans()) if wild or family == "machine" else family == "control"
    declares = family == "machine" or draw(perhaps(st.just(False), True, 8))
    given = {
        "options": draw(options(world, wild=wild)),
        "backward": draw(perhaps(st.just(True), False, 5)),
        "watch": draw(perhaps(known(("terminal", "change")), "", 6)),
        "declares": declares,
        "budget": draw(st.fixed_dictionaries({}, optional={"max_num_steps": st.integers(1, 50)})) if wild else {},
    }
    fewer = 1 if declares else 4  # by differences an evaluation costs as much as a hundred
    extreme = wild and draw(perhaps(st.just(True), False, 3))  # all else of a hostile case is, so that most tell of a motion
    if by_error:
        rtol = draw(decades(-14 if extreme else -6, 0 if extreme else -2))
        long = draw(decades(-300, 3)) if extreme else draw(tenths(2, 20))
        return Way(**given, rtol=rtol, turns=min(long, 60 * math.sqrt(rtol)) / fewer if not wild else long)
    steps = draw(st.integers(3, 16 // fewer))
    length = draw(decades(-12, 4)) if extreme else draw(st.integers(2, 25)) / 100
    ratios = draw(perhaps(st.lists(tenths(5, 15), min_size=2, max_size=4).map(tuple), (), 4))
    return Way(**given, steps=steps, turns=steps * length, ratios=ratios)


@st.composite
def spoils(draw) -> Spoil | None:
    """A fault of the user's, or none."""
    kind, where = draw(st.sampled_from(("", "nan", "raise", *SPOILS))), draw(st.sampled_from(SPOILED))
    if not kind:
        return None
    return Spoil(kind, where, draw(decades(*SPOILS[kind]) if kind in SPOILS else tenths(0, 10)))


@st.composite
def cases(draw, family: str, world: World) -> Case:
    """Of one of the families in ``TWINS``."""
    wild = family == "hostile"
    way, made = draw(ways(family, world)), draw(world.shapes(family).flatmap(lambda shape: mechanisms(shape, wild=wild)))
    return Case(
        family=family,
        made=made,
        way=way,
        twin=draw(st.sampled_from(TWINS[family])),
        spoil=draw(spoils()) if wild else None,
    )
