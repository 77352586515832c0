"""``hhtbench study parts``: what a part costs that is there, that what is absent is not called, what reductions gain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from tabulate import tabulate

import hhtbench as hb
from hhtbench.conformance.parts import scenes
from hhtbench.conformance.parts.measure import Cost, costs_of, own, run, seconds_of
from hhtbench.conformance.parts.scenes import Scene, chain
from hhtbench.lowering.description import describe

SAME = 1e-12  #: largest difference of what is computed with and without a reduction, of the largest entry
COMPARED = 200  # steps after which that is compared
ROUNDING = 0.5  # bytes a step below which a run's arrays do not grow

MASS = ("mass_matrix", "mass_product_jacobian")
CONSTRAINT = (
    *("constraint", "constraint_jacobian", "constraint_velocity", "constraint_velocity_jacobian"),
    *("constraint_acceleration", "reaction", "reaction_jacobians"),
)
VELOCITY = (
    *("velocity_constraint", "velocity_constraint_jacobian", "velocity_constraint_position_jacobian"),
    *("velocity_constraint_acceleration", "velocity_reaction", "velocity_reaction_jacobians"),
)


@dataclass(frozen=True)
class Part:
    """What a scene may have or not."""

    name: str
    absent: Scene
    present: Scene
    terms: tuple[str, ...] = ()  #: functions that are called for it alone
    more: tuple[str, ...] = ()  #: functions that it must call more often; without these and terms it calls none
    longer: bool = False  #: whether functions of a step are longer for it
    room: bool = False  #: whether the loop needs room for it


@dataclass(frozen=True)
class Reduction:
    """What is found not to be required, and is not computed."""

    name: str
    option: dict[str, Any]  #: of HHT, that does without it
    scene: Scene

    def __str__(self) -> str:
        return ", ".join(f"{name}={value}" for name, value in self.option.items())


SPRING, SPHERE, MASSIVE = (Scene(system=x) for x in (scenes.FREE, scenes.HELD, scenes.CONSTANT_MASS))
BETWEEN, SPHERE_BETWEEN = (replace(x, rows="between") for x in (SPRING, SPHERE))
BREATHING = Scene(system=scenes.BREATHING, v0=np.array([0.1, 0.5, 0.0]))
PARTS = (
    Part("mass, constant", SPRING, MASSIVE, terms=MASS),
    Part("mass, variable", MASSIVE, Scene(system=scenes.VARIABLE_MASS), terms=MASS, room=True),
    Part("force of v", SPRING, Scene(system=scenes.DAMPED), longer=True),
    Part("g", SPRING, SPHERE, terms=CONSTRAINT, longer=True, room=True),
    Part("k", SPRING, Scene(system=scenes.SKATE), terms=VELOCITY, longer=True, room=True),
    Part("time in g", SPHERE, BREATHING, more=("constraint",), longer=True),
    Part("nonlinear reaction", SPHERE, Scene(system=scenes.CUBIC), more=("reaction",), longer=True),
    Part("events", SPRING, replace(SPRING, watched=True), terms=("event",), room=True),
    Part("energy", SPRING, Scene(system=scenes.MEASURED), terms=("energy", "power", "invariants")),
    Part("error control", SPHERE, replace(SPHERE, controlled=True), more=("constraint",)),
    Part("rows between steps", SPRING, BETWEEN),
    Part("rows with multipliers", SPHERE, SPHERE_BETWEEN, more=("constraint_acceleration",)),
    Part("dense output", SPRING, replace(SPRING, rows="steps")),
)
LONG = chain(60)
REDUCTIONS = (
    Reduction("constant mass, one inverse", {"without": "mass"}, chain(6, coupled=True)),
    Reduction("linear reaction", {"without": "reaction"}, SPHERE_BETWEEN),
    Reduction("zeros and constants of the matrix", {"without": "zeros"}, LONG),
    Reduction("bands and blocks", {"linsolver": "dense"}, replace(LONG, uneven=True)),
    Reduction("kept inverse of few unknowns", {"linsolver": "dense"}, replace(SPHERE, uneven=True)),
)


@dataclass(frozen=True, kw_only=True)
class PartCost:
    """What was measured of one part."""

    part: Part
    absent: Cost
    present: Cost

    @property
    def fault(self) -> str:
        """What the part costs where it is absent, or what shows that it was not measured; empty: nothing."""
        return "; ".join(f"{self.part.name}: {text}" for text in self._faults())

    def _faults(self) -> Iterator[str]:
        part, absent, present = self.part, self.absent, self.present
        once, step = (own(calls, part.terms) for calls in (absent.once, absent.calls))
        if once or step:
            yield f"{once:g} calls and {step:g} a step where it is absent"
        if not (part.terms or part.more or part.longer) and absent.calls != present.calls:
            yield "it calls functions of the system"
        if absent.python > 0.0:
            yield f"{absent.python:g} calls in Python a step where it is absent"
        if absent.left > ROUNDING:
            yield f"{absent.left:.3g} bytes left behind by a step where it is absent"
        for asked, what, name in (
            (part.more, f"calls a step of {', '.join(part.more)}", lambda x: own(x.calls, part.more)),
            (part.longer, "operations", lambda x: x.operations),
            (part.room, "bytes of the loop's arrays", lambda x: x.memory),
        ):
            if asked and not name(absent) < name(present):
                yield f"{name(absent):g} {what} where it is absent, {name(present):g} where it is there"

    def row(self) -> dict[str, str]:
        """Of the table: absent and present, of calls, time and memory."""
        sides, terms = (self.absent, self.present), self.part.terms
        return {
            "part": self.part.name,
            "its calls": _both(own(x.calls, terms) for x in sides) if terms else "none",
            "all calls": _both(sum(x.calls.values()) for x in sides),
            "us": _both(1e6 * x.seconds for x in sides),
            "B": _both(x.memory for x in sides),
            "operations": _both(x.operations for x in sides),
            "in Python": _both(x.python for x in sides),
            "B left": _both(x.left if x.left > ROUNDING else 0.0 for x in sides),
        }


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What was measured of one reduction."""

    reduction: Reduction
    seconds: float  #: a step, with it
    seconds_without: float
    difference: float  #: of q, v, lam and mu, relative to the largest entry of each
    line: str  #: of ``describe`` that names the option; empty: there is none

    @property
    def fault(self) -> str:
        """What is wrong with it; empty: nothing."""
        if not self.difference <= SAME:
            return f"{self.reduction.name}: without it the answer differs by {self.difference:.1e}"
        return "" if self.line else f"{self.reduction.name}: describe does not name it"

    def row(self) -> dict[str, str]:
        """Of the table."""
        return {
            "reduction": self.reduction.name,
            "switch": str(self.reduction),
            "us without -> with": _both((1e6 * self.seconds_without, 1e6 * self.seconds)),
            "gain": f"{self.seconds_without / self.seconds:.2f}",
            "apart": f"{self.difference:.0e}",
            "describe": self.line,
        }


@dataclass(frozen=True, kw_only=True)
class Study:
    """What :func:`study_parts` found."""

    parts: tuple[PartCost, ...] = ()
    gains: tuple[Gain, ...] = ()

    @property
    def faults(self) -> tuple[str, ...]:
        """What does not hold."""
        faults = [x.fault for x in self.parts] + [x.fault for x in self.gains]
        return tuple(filter(None, faults))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        parts = [{"name": x.part.name, "absent": asdict(x.absent), "present": asdict(x.present)} for x in self.parts]
        gains = [{**vars(x), "name": x.reduction.name, "reduction": str(x.reduction)} for x in self.gains]
        return {"schema": "hhtbench.parts/2", "parts": parts, "reductions": gains}

    def __str__(self) -> str:
        tables = (
            tabulate([x.row() for x in rows], headers="keys", disable_numparse=True, maxcolwidths=60)
            for rows in (self.parts, self.gains)
        )
        return "\n\n".join([*tables, NOTES, *self.faults])


NOTES = """A step in the mean, `absent -> present`: calls of a system of plain callables, whose
derivatives are differences, with the terms that are derived; microseconds of processor time in machine code; bytes of the
arrays that the loop works in; operations of all functions of a step in machine code; calls of functions in Python, without
which nothing is allocated, in such a run; bytes that steps by hand leave behind. Judged of an absent part: no calls of its
own, none in Python, no bytes left behind; of functions that it shares fewer calls or operations than with it, and of what
only reads none at all. Derivatives that are zero are no reduction: the compiler leaves them out. Separable parts are not
reduced; a constant G has no switch of its own: its entries are constants of the matrix."""


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
    scene = reduction.scene
    seconds = seconds_of({"with": partial(run, scene), "without": partial(run, scene, **reduction.option)}, rounds)
    return Gain(
        reduction=reduction,
        seconds=seconds["with"],
        seconds_without=seconds["without"],
        difference=difference(reduction),
        line=line_of(reduction),
    )


def difference(reduction: Reduction) -> float:
    """Largest difference of what is found with and without it, over the largest entry of q, v, lam, mu each."""
    one, other = (run(reduction.scene, COMPARED, **options) for options in ({}, reduction.option))
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("q", "v", "lam", "mu")]
    return max(float(np.abs(x - y).max() / np.abs(x).max()) for x, y in pairs if x.size)


def line_of(reduction: Reduction) -> str:
    """What ``describe`` says where it names the option."""
    scene = reduction.scene
    problem = hb.Problem(name="scene", system=scene.system, t_span=(0.0, 1.0), q0=scene.q0, v0=scene.v0)
    found = (x for x in describe(problem).statements if f"hht({reduction})" in x.reason)
    return next((f"{x.subject}: {x.text}" for x in found), "")


def _both(numbers: Any) -> str:
    return " -> ".join(f"{x:.4g}" for x in numbers)
