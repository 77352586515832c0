"""``hhtbench study parts``: what a part costs that is there, that what is absent is not called, what reductions gain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from tabulate import tabulate

import hhtbench as hb
from hhtbench.arguments import Matrix
from hhtbench.description import Statement, describe
from hhtbench.studies.parts.measure import Cost, costs_of, own, run, seconds_of
from hhtbench.studies.parts.scenes import (
    Breathing,
    ConstantMass,
    Cubic,
    Damped,
    Measured,
    Scene,
    Skate,
    Sphere,
    Spring,
    VariableMass,
    chain,
)

SAME = 1e-12  #: largest difference of what is computed with and without a reduction, of the largest entry
COMPARED = 200  # steps after which that is looked at
ROUNDING = 0.5  # bytes a step below which a run's arrays do not grow

POSITION = ("constraint", "constraint_jacobian", "constraint_velocity", "constraint_velocity_jacobian")
MULTIPLIERS = ("constraint_acceleration", "reaction", "reaction_jacobians")
VELOCITY = (
    *("velocity_constraint", "velocity_constraint_jacobian", "velocity_constraint_position_jacobian"),
    *("velocity_constraint_acceleration", "velocity_reaction", "velocity_reaction_jacobians"),
)


@dataclass(frozen=True, kw_only=True)
class Part:
    """What a scene may have or not."""

    name: str
    absent: Scene
    present: Scene
    terms: tuple[str, ...] = ()  #: functions that are called for it alone
    more: tuple[str, ...] = ()  #: functions that it must call more often; without these and terms it calls none
    longer: bool = False  #: whether functions of a step are longer for it
    room: bool = False  #: whether the loop needs room for it


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """What is found not to be required, and is not computed."""

    name: str
    switch: dict[str, Any]  #: options of HHT that do without it
    scene: Scene


SPRING, SPHERE = Scene(system=Spring()), Scene(system=Sphere())
PARTS = (
    Part(
        name="mass, constant",
        absent=SPRING,
        present=Scene(system=ConstantMass()),
        terms=("mass_matrix", "mass_product_jacobian"),
    ),
    Part(
        name="mass, variable",
        absent=Scene(system=ConstantMass()),
        present=Scene(system=VariableMass()),
        terms=("mass_matrix", "mass_product_jacobian"),
        room=True,
    ),
    Part(name="force of v", absent=SPRING, present=Scene(system=Damped()), longer=True),
    Part(name="g", absent=SPRING, present=SPHERE, terms=(*POSITION, *MULTIPLIERS), longer=True, room=True),
    Part(name="k", absent=SPRING, present=Scene(system=Skate()), terms=VELOCITY, longer=True, room=True),
    Part(
        name="time in g",
        absent=SPHERE,
        present=Scene(system=Breathing(), v0=np.array([0.1, 0.5, 0.0])),
        more=("constraint",),
        longer=True,
    ),
    Part(name="nonlinear reaction", absent=SPHERE, present=Scene(system=Cubic()), more=("reaction",), longer=True),
    Part(name="events", absent=SPRING, present=Scene(system=Spring(), watched=True), terms=("event",), room=True),
    Part(
        name="energy",
        absent=SPRING,
        present=Scene(system=Measured()),
        terms=("energy", "power", "invariants"),
    ),
    Part(name="error control", absent=SPHERE, present=Scene(system=Sphere(), controlled=True), more=("constraint",)),
    Part(name="rows between steps", absent=SPRING, present=Scene(system=Spring(), rows="between")),
    Part(
        name="rows with multipliers",
        absent=SPHERE,
        present=Scene(system=Sphere(), rows="between"),
        more=("constraint_acceleration",),
    ),
    Part(name="dense output", absent=SPRING, present=Scene(system=Spring(), rows="steps")),
)
COUPLED, LONG = chain(6, coupled=True), chain(60)
REDUCTIONS = (
    Reduction(name="constant mass, one inverse", switch={"without": "mass"}, scene=COUPLED),
    Reduction(name="linear reaction", switch={"without": "reaction"}, scene=Scene(system=Sphere(), rows="between")),
    Reduction(name="zeros and constants of the matrix", switch={"without": "zeros"}, scene=LONG),
    Reduction(name="bands and blocks", switch={"linsolver": "dense"}, scene=replace(LONG, uneven=True)),
    Reduction(name="kept inverse of few unknowns", switch={"linsolver": "dense"}, scene=replace(SPHERE, uneven=True)),
)


@dataclass(frozen=True, kw_only=True)
class PartCost:
    """What was measured of one part."""

    part: Part
    absent: Cost
    present: Cost

    @property
    def fault(self) -> str:
        """What the part costs where it is absent, or what shows that it was not looked at; empty: nothing."""
        return "; ".join(f"{self.part.name}: {text}" for text in (*self._calls(), *self._allocations()))

    def _calls(self) -> Iterator[str]:
        part, absent, present = self.part, self.absent, self.present
        once, step = (own(calls, part.terms) for calls in (absent.once, absent.calls))
        if once or step:
            yield f"{once:g} calls and {step:g} a step where it is absent"
        few, many = (own(x.calls, part.more) for x in (absent, present))
        if part.more and not few < many:
            yield f"{few:g} calls a step of {', '.join(part.more)} where it is absent, {many:g} where it is there"
        if part.longer and not absent.operations < present.operations:
            yield f"{absent.operations} operations where it is absent, {present.operations} where it is there"
        if not (part.terms or part.more or part.longer) and absent.calls != present.calls:
            yield "it calls functions of the system"

    def _allocations(self) -> Iterator[str]:
        absent = self.absent
        if absent.python > 0.0:
            yield f"{absent.python:g} calls in Python a step where it is absent"
        if absent.left > ROUNDING:
            yield f"{absent.left:.3g} bytes left behind by a step where it is absent"
        if self.part.room and not absent.memory < self.present.memory:
            yield f"{absent.memory} bytes of the loop's arrays where it is absent, {self.present.memory} where it is there"

    def row(self) -> list[str]:
        """Of the table: absent and present, of calls, time and memory."""
        sides, terms = (self.absent, self.present), self.part.terms
        return [
            self.part.name,
            _both(own(x.calls, terms) for x in sides) if terms else "none",
            _both(sum(x.calls.values()) for x in sides),
            *(f"{1e6 * x.seconds:.2f}" for x in sides),
            *(str(x.memory) for x in sides),
            _both(x.operations for x in sides),
            _both(x.python for x in sides),
            _both(x.left if x.left > ROUNDING else 0.0 for x in sides),
            _both(x.allocated if x.allocated > ROUNDING else 0.0 for x in sides),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "name": self.part.name,
            "terms": self.part.terms,
            "absent": asdict(self.absent),
            "present": asdict(self.present),
        }


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What was measured of one reduction."""

    reduction: Reduction
    seconds: float  #: a step, with it
    seconds_without: float
    difference: float  #: of q, v, lam and mu, relative to the largest entry of each
    line: str  #: of ``describe`` that names the switch; empty: there is none

    @property
    def fault(self) -> str:
        """What is wrong with it, in words; empty: nothing."""
        if not self.difference <= SAME:
            return f"{self.reduction.name}: without it the answer differs by {self.difference:.1e}"
        return "" if self.line else f"{self.reduction.name}: describe does not tell of it"

    def row(self) -> list[str]:
        """Of the table."""
        times = [f"{1e6 * x:.2f}" for x in (self.seconds, self.seconds_without)]
        ratio = f"{self.seconds_without / self.seconds:.2f}"
        return [self.reduction.name, _switch(self.reduction), *times, ratio, f"{self.difference:.0e}", self.line]

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        given = {name: value for name, value in vars(self).items() if name != "reduction"}
        return {"name": self.reduction.name, "switch": _switch(self.reduction), **given}


@dataclass(frozen=True, kw_only=True)
class Study:
    """What :func:`study_parts` found."""

    parts: tuple[PartCost, ...] = field(default=())
    gains: tuple[Gain, ...] = field(default=())

    @property
    def faults(self) -> tuple[str, ...]:
        """What does not hold."""
        found = [x.fault for x in self.parts] + [x.fault for x in self.gains]
        return tuple(filter(None, found))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        parts, gains = [x.as_dict() for x in self.parts], [x.as_dict() for x in self.gains]
        return {"schema": "hhtbench.parts/1", "parts": parts, "reductions": gains}

    def __str__(self) -> str:
        parts = ["part", "its calls", "all calls", "us absent", "us present", "B absent", "B present"]
        parts += ["operations", "in Python", "B left", "B of rows"]
        gains = ["reduction", "switch", "us with", "us without", "gain", "apart", "describe"]
        tables = [
            tabulate([x.row() for x in self.parts], headers=parts, disable_numparse=True),
            tabulate([x.row() for x in self.gains], headers=gains, disable_numparse=True, maxcolwidths=[None] * 6 + [60]),
        ]
        return "\n\n".join([*tables, NOTES, *self.faults])


NOTES = """A step in the mean, `absent -> present` where there is one column: calls of a system of plain callables, whose
derivatives are differences, with the terms that are derived; microseconds of processor time in machine code; bytes of the
arrays that the loop works in; operations of all functions of a step in machine code; calls of functions in Python, without
which nothing is allocated, in such a run; bytes that steps by hand leave behind, and those by which a run grows that keeps
its rows, to some hundred: its arrays grow fourfold. Judged of an absent part: no calls of its own, none in Python, no bytes
left behind; of functions that it shares fewer calls or operations than with it, and of what only reads none at all. Room for
error control and steps of up to 24 MB are kept in any case. Derivatives that are zero are no reduction: the compiler leaves
them out. Separable parts are not reduced; a constant G has no switch of its own: its entries are
constants of the matrix."""


def study_parts(rounds: int = 9, tell: Callable[[int, int], None] = lambda done, total: None) -> Study:
    """Measure every part and every reduction; ``tell`` hears how many of how many are done."""
    total, parts, gains = len(PARTS) + len(REDUCTIONS), list[PartCost](), list[Gain]()
    for part in PARTS:
        tell(len(parts), total)
        parts.append(PartCost(part=part, **costs_of({"absent": part.absent, "present": part.present}, rounds)))
    for reduction in REDUCTIONS:
        tell(len(parts) + len(gains), total)
        gains.append(gain_of(reduction, rounds))
    tell(total, total)
    return Study(parts=tuple(parts), gains=tuple(gains))


def gain_of(reduction: Reduction, rounds: int) -> Gain:
    """What ``reduction`` saves in its scene."""
    scene, switch = reduction.scene, reduction.switch
    actions = {"with": partial(run, scene), "without": partial(run, scene, **switch)}
    seconds = seconds_of(actions, rounds)
    return Gain(
        reduction=reduction,
        seconds=seconds["with"],
        seconds_without=seconds["without"],
        difference=difference(reduction),
        line=line_of(reduction),
    )


def difference(reduction: Reduction) -> float:
    """Largest difference of what is found with and without it, over the largest entry of q, v, lam, mu each."""
    runs = (run(reduction.scene, COMPARED, **options) for options in ({}, reduction.switch))
    pairs = zip(*((x.q, x.v, x.lam, x.mu) for x in runs), strict=True)
    return max(_apart(one, other) for one, other in pairs if one.size)


def _apart(one: Matrix, other: Matrix) -> float:
    return float(np.abs(one - other).max() / np.abs(one).max())


def line_of(reduction: Reduction) -> str:
    """What ``describe`` says where it names the switch."""
    scene = reduction.scene
    problem = hb.Problem(name="scene", system=scene.system, t_span=(0.0, 1.0), q0=scene.q0, v0=scene.v0)
    return next((_text(x) for x in describe(problem).statements if f"hht({_switch(reduction)})" in x.reason), "")


def _text(statement: Statement) -> str:
    return f"{statement.subject}: {statement.text}"


def _switch(reduction: Reduction) -> str:
    return ", ".join(f"{name}={value}" for name, value in reduction.switch.items())


def _both(numbers: Any) -> str:
    return " -> ".join(f"{x:.3g}" for x in numbers)
