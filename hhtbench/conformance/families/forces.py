"""Forces that are not smooth: jumps, at the start too, friction and contact."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from hhtbench.conformance.cell import Cell, cells, family, rtol, step
from hhtbench.conformance.families.errors import motion, reacting
from hhtbench.conformance.scenes.circles import Rubbing, Sliding, bouncing, pushed, sliding

SPAN = 2.0  # [s]
JUMP = 0.7  # [s], no multiple of a step
FIRST_ORDER = rtol(1e-4), step(1e-3, 2e-3)


@family("jump", "jump of the force [m/s^2]")
def jump(seed: int) -> Iterator[Cell]:
    """A force that jumps within a step, or right after the start: closed on both sides, to the first order of the step."""
    for size in (1e-2, 2.0, 1e2, 1e4, 1e8):  # at 1 what is pushed at the start would stand still
        felt = size / (1.0 + size) / 10.0  # at most a tenth of what a push of this size moves, scaled: that it is felt shows
        for begin, named in ((JUMP, "{}"), (0.0, "{}, at the start")):
            ways = [way._replace(most=min(way.most, felt)) for way in FIRST_ORDER]
            make = partial(pushed, size, begin, SPAN)
            yield from cells(size, make, ways, motion, named=named, small=size in (2.0, 1e4))


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
