"""Springs, dampers and spins far stiffer than the motion that is judged, at given tolerances and at given steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.catalogue.registry import load_problem
from hhtbench.conformance.cell import Cell, Expected, Way, cells, family, rtol, step
from hhtbench.conformance.families.errors import HALF, REACTION, along, at_the_end, exact, held, motion, reacting
from hhtbench.conformance.scenes.circles import FAST, FIRST, SLOW, crossed_levels, damped, led, spinning, stiff
from hhtbench.conformance.scenes.servos import hung
from hhtbench.conformance.subject import ACCURACY
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

SPAN = 5.0  # [s], most of a period of the slow motion
CURVATURE = 10.0  # error over h^2 of a method of second order on a motion of frequency 1 [1/s^2], unless it is said
GROWTH = 10.0  # growth up to which a fast vibration counts as bounded
UNRESOLVED = 3.0  # at steps longer than the slow motion: that it stays of its size
ROUNDOFF = 1e-9
LEVELS = 20 * float(np.finfo(np.float64).eps)  # violation of constraints, over the size of q and v
STIFF = 1e6  # stiffness over mass of the steps [1/s^2]
TOLERANCES = (1e-3, 1e-5)
STEPS = (1e-1, 1e-2, 1e-3)  # [s]
PROBLEM = "stiff_spring_pendulum(stiffness=1e{})"
BEND = 30.0  # error over h^2 of a method of second order there [1/s^2]; 8 to 11 for HHT on the rigid pendulum
SWAY = 30.0  # over g/k, where the step does not resolve the spring: 11 there
THERE = 0.3  # scaled, at any step: that the pendulum is where it should be, and not where it was
SLOPE = (2e-2, 1e-2, 5e-3)  # steps of a fitted order [s]
FITTED = (2, 10, 12)  # exponents of stiffness where they all resolve the spring, or are far beyond it
SHORT = 0.5  # tolerated lack of the order
LAST = 8  # exponent of the largest stiffness with a reference; that of the rigid rod is nearer to the others than SWAY g/k


def beside(stiffness: float, most: float, across: float = ROUNDOFF) -> dict[str, Expected]:
    """Expect the slow motion on its circle, and a fast vibration, 1 / stiffness at first, that stays below ``across``."""
    slow = {name: Expected(error=along(u), most=most) for name, u in (("slow motion", SLOW), ("its circle", FIRST))}
    fast = {"fast vibration": Expected(error=_fast, most=GROWTH / stiffness + across)}
    return slow | fast | {"reaction": Expected(error=_slow_reaction, most=min(REACTION * most, HALF))}


def _fast(problem: Problem, found: Solution) -> float:
    return float(np.max(np.abs(found.q @ FAST)))


def _slow_reaction(problem: Problem, found: Solution) -> float:
    """Error of the multiplier of the slow motion's circle."""
    return float(np.max(np.abs(exact(problem, found, "lam") - found.lam)[1:, 0]))


WAYS = (*map(rtol, TOLERANCES), *(step(h, CURVATURE * h**2 + ROUNDOFF) for h in STEPS))
SMALL = "rtol 0.001", "h = 0.01 s"


def _cells(
    power: int, small: int | None, make: Callable[[], Problem], known: Any = reacting, named: str = "{}"
) -> Iterator[Cell]:
    """Yield a cell for every request at the parameter 10^power; some of those at 10^small are marked small."""
    for way in WAYS:
        chosen = power == small and way.line in SMALL
        yield from cells(10.0**power, make, [way], known, named=named, small=chosen)


@family("stiffness", "stiffness across the motion [1/s^2]")
def stiffness(seed: int) -> Iterator[Cell]:
    """A slow vibration beside one up to 1e7 times faster, both constrained: error of the slow one, closed solution."""
    for power in range(2, 15, 2):
        for way in WAYS:
            expected = partial(beside, 10.0**power, across=way.most if "rtol" in way.request else ROUNDOFF)
            small = power in (4, 12) and way.line in SMALL
            yield from cells(10.0**power, partial(stiff, 10.0**power, SPAN), [way], expected, small=small)


@family("dampers", "damper along the motion [1/s]")
def dampers(seed: int) -> Iterator[Cell]:
    """A damper and a spring that leave a decay of about e^-t: closed solution."""
    for power in (1, 2, 4, 6, 8, 10):
        yield from _cells(power, 8, partial(damped, 10.0**power, SPAN))


@family("servo", "stiffness of the servo [1/s^2]")
def servo(seed: int) -> Iterator[Cell]:
    """A spring, with and without a damper as stiff, that leads the motion along sin t, or by what is driven so: closed."""
    for power in (2, 5, 8, 11, 14):
        for name, damping in (("spring", 0.0), ("spring and damper", 10.0**power)):
            yield from _cells(power, 8, partial(led, 10.0**power, damping, SPAN), named=f"{name}, {{}}")
            hanging = partial(hung, 10.0**power, damping, SPAN)
            yield from _cells(power, None, hanging, motion, named=f"{name} on a drive, {{}}")


@family("spin", "gyroscopic coupling [1/s]")
def spin(seed: int) -> Iterator[Cell]:
    """Fast spin: gyroscopic forces whose slow circle has a frequency near 1: closed solution."""
    for power in (0, 1, 2, 3, 4, 6):
        yield from _cells(power, 4, partial(spinning, 10.0**power, SPAN))


@family("steps", "length of a step [s]")
def steps(seed: int) -> Iterator[Cell]:
    """Sixty steps from roundoff to far beyond the fast period of 6e-3 s: bounded, both levels of constraints at roundoff."""
    count = 60
    for power in range(-14, 2):
        h = 10.0**power
        make = partial(stiff, STIFF, count * h)
        levels = Expected(error=held(_levels), most=LEVELS * max(1.0, h * count))
        slow = beside(STIFF, min(CURVATURE * h**2 * max(1.0, h * count) + ROUNDOFF, UNRESOLVED))
        expected = slow | {"both levels": levels}
        small = power in (-9, -3, 1)
        yield Cell(x=h, line=f"{count} steps", make=make, request={"steps": count}, expected=expected, small=small)
        within = reacting(ACCURACY * 1e-6 * max(1.0, count * h))
        yield Cell(x=h, line="rtol 1e-06, as long", make=make, request={"rtol": 1e-6}, expected=within, small=small)


def _levels(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    sizes = max(1.0, float(np.abs(q).max())), max(1.0, float(np.abs(v).max()))
    return crossed_levels(t, q, v) / np.repeat(sizes, 2)


def _sprung(power: int) -> Problem:
    problem = load_problem(PROBLEM.format(power))
    if power <= LAST:
        return problem
    return replace(problem, reference=load_problem("stiff_spring_pendulum(stiffness=inf)").reference)


def _sway(power: int) -> float:
    return SWAY * 9.81 / 10.0**power


@family("order", "stiffness of the spring [N/m]")
def order(seed: int) -> Iterator[Cell]:
    """Order at intermediate stiffness: a pendulum on a stiff spring, steps around its period: certified references."""
    for power in (2, 4, 6, 8, 10, 12, 14):
        make, beyond = partial(_sprung, power), _sway(power) * (power > LAST)
        ways = [Way(f"rtol {x:g}", {"rtol": x}, ACCURACY * x + beyond) for x in (1e-3, 1e-5, 1e-7)]
        for h in (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4):
            unresolved = h * math.sqrt(10.0**power) >= 1.0
            ways.append(step(h, min(BEND * h**2 + (_sway(power) if unresolved else beyond) + ROUNDOFF, THERE)))
        for way in ways:
            small = power in (2, 10) and way.line in ("rtol 1e-05", "h = 0.01 s")
            expected = {"end": Expected(error=at_the_end, most=way.most)}
            yield from cells(10.0**power, make, [way], expected, t_eval=[1.0], small=small)
        if power in FITTED:
            first, *others = ({"step": h, "t_eval": [1.0]} for h in SLOPE)
            fitted = {"order below 2 by": Expected(error=partial(_shortfall, beyond), most=SHORT)}
            given: dict[str, Any] = {"x": 10.0**power, "make": make, "small": power in (2, 10)}
            further = tuple((make, request) for request in others)
            yield Cell(line="fitted order", request=first, expected=fitted, further=further, **given)


def _shortfall(floor: float, problem: Problem, *runs: Solution) -> float:
    """Return 2 minus the fitted order of the error at the end from the runs above ``floor``; 0 if fewer than two are."""
    errors = np.array([at_the_end(problem, run) for run in runs])
    above = errors > 3 * floor
    if np.count_nonzero(above) < 2:
        return 0.0
    return max(0.0, 2.0 - float(np.polyfit(np.log(np.array(SLOPE)[above]), np.log(errors[above]), 1)[0]))
