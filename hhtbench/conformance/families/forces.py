"""Forces that are not smooth: jumps, at the start too, friction and contact."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from hhtbench.conformance.cell import Cell, Expected, family
from hhtbench.conformance.families.errors import REACTION, exact, motion, own_multipliers, reacting
from hhtbench.conformance.scenes.circles import Rubbing, Sliding, bouncing, pushed, sliding
from hhtbench.conformance.subject import ACCURACY
from hhtbench.protocol import Problem
from hhtbench.result import Solution

SPAN = 2.0  # [s]
JUMP = 0.7  # [s], no multiple of a step
RTOL, STEP = 1e-4, 1e-3
LATE = 20  # rows, at most half of them, after which a wrong start must have left the multipliers


@family("jump", "jump of the force [m/s^2]")
def jump(seed: int) -> Iterator[Cell]:
    """A force that jumps within a step: closed solution on both sides, to the first order of the step."""
    for size in (1e-2, 1.0, 1e2, 1e4, 1e8):
        make, small = partial(pushed, size, JUMP, SPAN), size in (1.0, 1e4)
        for line, request, most in (
            ("rtol 0.0001", {"rtol": RTOL}, ACCURACY * RTOL),
            ("h = 0.001 s", {"step": STEP}, 2 * STEP),
        ):
            expected = motion(felt(most, size))
            yield Cell(x=size, line=line, make=make, request=request, expected=expected, small=small)


def felt(most: float, size: float) -> float:
    """At most a tenth of what a push of this size moves, scaled: that it is felt shows."""
    return min(most, size / (1.0 + size) / 10.0)


@family("wrong_a0", "jump of the force right after the start [m/s^2]")
def wrong_a0(seed: int) -> Iterator[Cell]:
    """The acceleration and the multipliers at the start are wrong: motion, and multipliers twenty rows later, closed."""
    for size in (1e-2, 2.0, 1e2, 1e4, 1e8):
        make, small = partial(pushed, size, 0.0, SPAN), size in (2.0, 1e4)
        for line, request, most in (
            ("rtol 0.0001", {"rtol": RTOL}, ACCURACY * RTOL),
            ("h = 0.001 s", {"step": STEP}, 2 * STEP),
        ):
            asked = {**request, "t_eval": None}  # at its steps HHT holds multipliers of its own
            within = felt(most, size)
            expected = motion(within) | {"multipliers": Expected(error=_late_multipliers, most=REACTION * within)}
            yield Cell(x=size, line=line, make=make, request=asked, expected=expected, small=small)


def _late_multipliers(problem: Problem, found: Solution) -> float:
    """Largest scaled error of the multipliers that the solver itself holds, where it holds some."""
    late = np.abs(own_multipliers(found) - exact(problem, found, "lam"))[min(LATE, found.t.size // 2) :] / problem.scales.lam
    return float(np.max(late, initial=0.0))


@family("friction", "speed within which friction changes its sign [m/s]")
def friction(seed: int) -> Iterator[Cell]:
    """Coulomb-like friction, a force or as large as the multiplier, brings a mass to rest and keeps it there: closed."""
    for power in (-1, -2, -3, -4, -6, -8):
        width = 10.0**power
        small = power in (-2, -6)
        for name, system in (("", Sliding), (", of the multiplier", Rubbing)):
            make = partial(sliding, width, SPAN, system)
            for line, request, most in (
                ("rtol 0.0001", {"rtol": RTOL}, ACCURACY * RTOL),
                ("h = 0.01 s", {"step": 1e-2}, 5e-2),
                ("h = 0.001 s", {"step": STEP}, 5 * STEP),
            ):
                yield Cell(x=width, line=line + name, make=make, request=request, expected=reacting(most), small=small)


@family("contact", "stiffness of the contact [1/s^2]")
def contact(seed: int) -> Iterator[Cell]:
    """A mass meets a stiff spring and leaves it: closed solution at the end."""
    for power in range(2, 15, 2):
        stiffness = 10.0**power
        make, small = partial(bouncing, stiffness, SPAN), power in (4, 10)
        for line, request, most in (
            ("rtol 0.0001", {"rtol": RTOL}, ACCURACY * RTOL),
            ("rtol 1e-06", {"rtol": 1e-6}, ACCURACY * 1e-6),
            ("h = 0.001 s", {"step": STEP}, 5e-2),
        ):
            asked = {**request, "t_eval": [SPAN]}
            given: dict[str, Any] = {"make": make, "request": asked, "expected": motion(most), "small": small}
            yield Cell(x=stiffness, line=line, cause="the steps do not resolve the forces", **given)
