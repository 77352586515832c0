"""A case of the fuzzing as plain data, and how hypothesis draws one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

import numpy as np
from hypothesis import strategies as st

from tests.fuzz.mechanism import Mechanism, Shape
from tests.fuzz.systems import Spoil

FAMILIES = ("steps", "control", "machine", "hostile")
ANY_TWINS = ("rows", "units", "rescaled", "budget", "watched", "by hand", "python")
TWINS = {  # what a run is compared with, of the families
    "steps": (*ANY_TWINS, "rotated", "algebra", "reversed", "order"),
    "control": ANY_TWINS,
    "machine": ("callables", "python", "rows", "budget", "rescaled"),
    "hostile": ("none",),
}
SPOILED = ("force", "constraint", "constraint_jacobian", "force_jacobians", "velocity_constraint", "reaction")
MACHINES = (  # whose functions become machine code, once for each
    Shape(dim=2, points=1, rods=((0, 1),)),
    Shape(dim=2, points=2, rods=((0, 2), (1, 0)), springs=((1, 2),), reaction="friction"),
    Shape(dim=2, points=2, rods=((0, 2), (1, 0), (1, 0)), driven=True, growing=True),
    Shape(dim=3, points=2, rods=((0, 2), (1, 0)), springs=((0, 1),)),
    Shape(dim=2, points=3, anchors=2, rods=((0, 3), (1, 0), (1, 4)), springs=((2, 0), (2, 1))),
    Shape(dim=3, points=1, springs=((0, 1),), blade=(0, 0)),
    Shape(dim=2, points=2, rods=((0, 2),), springs=((1, 0), (1, 2)), blade=(1, 0), reaction="linear"),
    Shape(dim=2, points=4, anchors=2, rods=((0, 4), (1, 0), (2, 1), (2, 5), (3, 2)), springs=((3, 0),)),
    Shape(dim=3, points=3, rods=((0, 3), (1, 0), (2, 1)), blade=(2, 0), growing=True),
    Shape(dim=2, points=3, springs=((0, 3), (1, 0), (2, 1))),
)


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
class Kind:
    """What decides which code serves a mechanism, and is the same for many: compiling it takes a second."""

    dim: int
    points: int
    rods: int
    blade: bool = False
    driven: bool = False
    growing: bool = False
    reaction: str = ""


@dataclass(frozen=True)
class World:
    """The kinds of mechanisms and the methods that the cases of one process are drawn from."""

    kinds: tuple[Kind, ...]
    methods: tuple[dict, ...]  #: options of HHT: alpha, b, reaction
    machines: tuple[Shape, ...]

    @classmethod
    def drawn(cls, number: int, kinds: int = 6, methods: int = 3, machines: int = 2) -> World:
        """By seed; the first method is symmetric."""
        random = Random(number)
        some = [_kind(random) for _ in range(kinds)]
        ways = [{"alpha": 0.0, "b": random.choice((0.0, 0.0, 0.25))}, *(_method(random) for _ in range(methods - 1))]
        return cls(tuple(some), tuple(ways), tuple(random.sample(MACHINES, machines)))


def _kind(random: Random) -> Kind:
    points, rare = random.randint(1, 5), lambda of: random.randrange(of) == 0
    dim = random.choice((2, 2, 3)) if points < 4 else 2
    rods = random.choice((points, points, points, points + 1, points - 1, max(points - 2, 0), points + 2))
    reaction = random.choice(("", "", "", "linear", "friction")) if rods else ""
    return Kind(dim, points, rods, rare(5), rare(4) and rods > 0, rare(6), reaction)


def _method(random: Random) -> dict:
    reaction = random.choice(("implicit", "implicit", "midpoint", "predictor", "midpoint_predictor"))
    b = 0.0 if reaction.startswith("midpoint") else random.choice((0.0, 0.0, 0.2, 1.0))
    return {"alpha": random.choice((-0.05, -0.1, -0.3, -1 / 3)), "b": b, "reaction": reaction}


@st.composite
def shapes(draw, kind: Kind) -> Shape:
    """A tree of rods, closed by further ones, some of them doubled; points without rods are held by springs, if at all."""
    points, anchors, known = kind.points, draw(st.integers(1, 2)), st.sampled_from
    rods: list[tuple[int, int]] = []
    for i in range(kind.rods):
        if i < points:
            rods.append((i, draw(known([points, *range(i)]))))
        else:
            rods.append(draw(perhaps(known(rods), None, 4)) or draw(_pair(points, anchors)))
    return Shape(
        dim=kind.dim,
        points=points,
        anchors=anchors,
        rods=tuple(rods),
        springs=tuple(draw(st.lists(_pair(points, anchors), min_size=int(not rods), max_size=3))),
        blade=draw(st.tuples(*[st.integers(0, points - 1)] * 2)) if kind.blade else None,
        driven=kind.driven,
        growing=kind.growing,
        reaction=kind.reaction,
    )


def _pair(points: int, anchors: int):
    """A point and another, or an anchor."""
    other = st.integers(1, points + anchors - 1)
    return st.tuples(st.integers(0, points - 1), other).map(lambda x: (x[0], (x[0] + x[1]) % (points + anchors)))


@st.composite
def mechanisms(draw, shape: Shape, *, wild: bool = False) -> Mechanism:
    """Numbers for ``shape``; ``wild``: of any size, places on one line among them."""
    d, flat = shape.dim, wild and draw(perhaps(st.just(True), False, 8))
    parent = dict(reversed(shape.rods))
    anchor = [np.zeros(d), np.eye(d)[0] * 2.0][: shape.anchors]
    places: list[np.ndarray] = []
    for i in range(shape.points):
        angles = [math.radians(draw(st.integers(-180, 180)) if not flat else -90) for _ in range(d - 1)]
        way = np.array([math.sin(angles[0]), -math.cos(angles[0]), *[math.sin(a) for a in angles[1:]]])
        root = parent.get(i, shape.points)
        origin = places[root] if root < i else anchor[root - shape.points if root >= shape.points else 0]
        places.append(np.round(origin + draw(tenths(5, 15)) * way, 6))
    vector, rows = st.tuples(*[tenths(-20, 20)] * d), lambda k: st.tuples(*[st.tuples(*[tenths(-20, 20)] * d)] * k)
    stiff, heavy = (decades(-2, 14), decades(-8, 8)) if wild else (decades(-1, 4), decades(-1, 1))
    damper = perhaps(decades(-2, 6 if wild else 1), 0.0, 3)
    spring = st.tuples(stiff, tenths(5, 15), damper)
    has = shape.blade is not None
    return Mechanism(
        shape=shape,
        places=tuple(tuple(x.tolist()) for x in places),
        velocities=draw(rows(shape.points)),
        masses=draw(st.tuples(*[heavy] * shape.points)),
        anchor=tuple(tuple(x.tolist()) for x in anchor),
        gravity=draw(st.sampled_from([(0.0, -9.81), (0.0, 0.0), (3.0, -9.0)])) + (0.0,) * (d - 2),
        scales=draw(st.tuples(*[perhaps(decades(-6, 6), 1.0, 4)] * len(shape.rods))),
        springs=draw(st.tuples(*[spring] * len(shape.springs))),
        drag=draw(perhaps(decades(-2, 1), 0.0, 4)),
        growth=draw(tenths(1, 5)) if shape.growing else 0.0,
        swing=draw(vector.map(lambda x: tuple(v / 10 for v in x))) if shape.driven else (),
        frequency=draw(tenths(1, 100)) if shape.driven else 0.0,
        along=draw(vector) if has else (),
        turn=_antisymmetric(draw(tenths(-20, 20)), d) if has else (),
        speed=draw(perhaps(tenths(-10, 10), 0.0, 3)) if has else 0.0,
        friction=draw(tenths(0, 5)) * (1.0 if wild else 0.1) if shape.reaction == "friction" else 0.0,
        creep=draw(decades(-4 if wild else -1, 0)),
        t0=draw(perhaps(st.sampled_from([1e9, -1e15] if wild else [0.5, -3.0, 100.0]), 0.0, 5)),
    )


def _antisymmetric(number: float, d: int):
    found = np.zeros((d, d))
    found[0, 1], found[1, 0] = number, -number
    return tuple(map(tuple, found.tolist()))


def options(methods, *, wild: bool = False):
    """Of HHT."""
    known = st.sampled_from
    others = {
        "start": known(("f0", "shifted", "trapezoidal")),
        "linsolver": perhaps(known(("dense", "band", "sparse")), "auto", 3),
    }
    if wild:
        others |= {"calc_initcond": st.just(True), "min_step": decades(-6, 0), "rescale_a": st.just(False)}
    return st.tuples(known(methods), st.fixed_dictionaries({}, optional=others)).map(lambda x: x[0] | x[1])


@st.composite
def ways(draw, family: str, methods) -> Way:
    """Gentle ones, but for the hostile family."""
    wild, known = family == "hostile", st.sampled_from
    by_error = draw(st.booleans()) if wild or family == "machine" else family == "control"
    given = {"options": draw(options(methods, wild=wild)), "backward": draw(perhaps(st.just(True), False, 5))}
    given["watch"] = draw(perhaps(known(("terminal", "change")), "", 6))
    given["declares"] = draw(perhaps(st.just(False), True, 8)) if family != "machine" else True
    if wild:
        given["budget"] = draw(st.fixed_dictionaries({}, optional={"max_num_steps": st.integers(1, 50)}))
    if by_error:
        rtol = draw(decades(-14 if wild else -6, 0 if wild else -2))
        long = draw(decades(-300, 3)) if wild and draw(perhaps(st.just(True), False, 3)) else draw(tenths(2, 30))
        return Way(**given, rtol=rtol, turns=min(long, 60 * math.sqrt(rtol)) if not wild else long)
    steps = draw(st.integers(3, 30))
    length = draw(decades(-12, 4)) if wild else draw(st.integers(2, 25)) / 100
    ratios = draw(perhaps(st.lists(tenths(5, 15), min_size=2, max_size=4).map(tuple), (), 4))
    return Way(**given, steps=steps, turns=steps * length, ratios=ratios)


@st.composite
def spoils(draw) -> Spoil | None:
    """A fault of the user's, or none."""
    kind = draw(st.sampled_from(("", "nan", "raise", "wrong", "noise", "off", "units", "massless")))
    where = draw(st.sampled_from(SPOILED))
    if not kind:
        return None
    if kind in ("nan", "raise"):
        return Spoil(kind, where, draw(tenths(0, 10)))
    return Spoil(
        kind, where, draw(decades(*{"units": (-100, 100), "off": (-18, 0), "noise": (-14, -4)}.get(kind, (-12, 1))))
    )


@st.composite
def cases(draw, family: str, world: World) -> Case:
    """Of one of the ``FAMILIES``."""
    wild = family == "hostile"
    shape = draw(st.sampled_from(world.machines) if family == "machine" else st.sampled_from(world.kinds).flatmap(shapes))
    way = draw(ways(family, world.methods[:2] if family == "machine" else world.methods))
    made = draw(mechanisms(shape, wild=wild))
    return Case(
        family=family,
        made=made,
        way=way,
        twin=draw(st.sampled_from(TWINS[family])),
        spoil=draw(spoils()) if wild else None,
    )
