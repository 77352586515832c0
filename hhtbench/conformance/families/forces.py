"""Forces that are not smooth: jumps, at the start too, friction and contact."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from hhtbench.conformance.cell import Cell, Expected, cells, family, rtol, step
from hhtbench.conformance.families.errors import REACTION, exact, motion, own_multipliers, reacting
from hhtbench.conformance.scenes.circles import Rubbing, Sliding, bouncing, pushed, sliding
from hhtbench.protocol.system import Problem
from hhtbench.solution.result import Solution

SPAN = 2.0  # [s]
JUMP = 0.7  # [s], no multiple of a step
FIRST_ORDER = rtol(1e-4), step(1e-3, 2e-3)
LATE = 20  # rows, at most half of them, after which a wrong start must have left the multipliers


@family("jump", "jump of the force [m/s^2]")
def jump(seed: int) -> Iterator[Cell]:
    """A force that jumps within a step: closed solution on both sides, to the first order of the step."""
    for size in (1e-2, 1.0, 1e2, 1e4, 1e8):
        make = partial(pushed, size, JUMP, SPAN)
        yield from cells(size, make, FIRST_ORDER, partial(_felt, size), small=size in (1.0, 1e4))


@family("wrong_a0", "jump of the force right after the start [m/s^2]")
def wrong_a0(seed: int) -> Iterator[Cell]:
    """The acceleration and the multipliers at the start are wrong: motion, and multipliers twenty rows later, closed."""
    for size in (1e-2, 2.0, 1e2, 1e4, 1e8):
        make, small = partial(pushed, size, 0.0, SPAN), size in (2.0, 1e4)
        yield from cells(size, make, FIRST_ORDER, partial(_felt_late, size), t_eval=None, small=small)


def _felt(size: float, most: float) -> dict[str, Expected]:
    """At most a tenth of what a push of this size moves, scaled: that it is felt shows."""
    return motion(min(most, size / (1.0 + size) / 10.0))


def _felt_late(size: float, most: float) -> dict[str, Expected]:
    """The same, and at the steps, where HHT holds multipliers of its own, those."""
    known = _felt(size, most)
    return known | {"multipliers": Expected(error=_late_multipliers, most=REACTION * known["motion"].most)}


def _late_multipliers(problem: Problem, found: Solution) -> float:
    """Largest scaled error of the multipliers that the solver itself holds, where it holds some."""
    late = np.abs(own_multipliers(found) - exact(problem, found, "lam"))[min(LATE, found.t.size // 2) :] / problem.scales.lam
    return float(np.max(late, initial=0.0))


@family("friction", "speed within which friction changes its sign [m/s]")
def friction(seed: int) -> Iterator[Cell]:
    """Coulomb-like friction, a force or as large as the multiplier, brings a mass to rest and keeps it there: closed."""
    ways = rtol(1e-4), step(1e-2, 5e-2), step(1e-3, 5e-3)
    for power in (-1, -2, -3, -4, -6, -8):
        for named, system in (("{}", Sliding), ("{}, of the multiplier", Rubbing)):
            make = partial(sliding, 10.0**power, SPAN, system)
            yield from cells(10.0**power, make, ways, reacting, named=named, small=power in (-2, -6))


@family("contact", "stiffness of the contact [1/s^2]")
def contact(seed: int) -> Iterator[Cell]:
    """A mass meets a stiff spring and leaves it: closed solution at the end."""
    ways, cause = (rtol(1e-4), rtol(1e-6), step(1e-3, 5e-2)), "the steps do not resolve the forces"
    for power in range(2, 15, 2):
        make, small = partial(bouncing, 10.0**power, SPAN), power in (4, 10)
        yield from cells(10.0**power, make, ways, motion, t_eval=[SPAN], small=small, cause=cause)
