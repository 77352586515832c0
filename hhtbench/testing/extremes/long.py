"""A million steps of a pendulum and of a closed chain: levels of the constraints, energy and phase."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ellipk

from hhtbench.arguments import Vector
from hhtbench.protocol import Problem
from hhtbench.registry import load_problem
from hhtbench.result import Solution
from hhtbench.testing.extremes.cell import Cell, Expected, axis
from hhtbench.testing.extremes.known import held, kept
from hhtbench.testing.extremes.linkages import parallelogram, parallelogram_levels
from hhtbench.testing.scenes.pendulum import GRAVITY, PERIOD, RADIUS

STEPS = 500  # a swing
ROWS = 40  # of output, about
LEVELS = 1e-12  # of both levels, however long
ENERGY = 1e-5  # over its range, after up to two thousand swings of prescribed steps: 1e-6 for HHT with alpha = -0.05
LOST = 1e-3  # the same under error control, whose steps lose 2e-4 in two hundred swings
PHASE = 5e-4  # [rad] a swing: 1e-4 is what the period is too long by at 500 steps a swing and alpha = -0.05
RTOL = 1e-6
DRIFTING = 20  # swings, in which levels may drift under error control, by a hundred times the tolerance each
SECONDS, LONGER_SECONDS = 30.0, 300.0
PULL = float(2 * ellipk(0.5)) ** 2  # gravity of the pendulum with a period of 2 s [m/s^2]


@dataclass(frozen=True)
class Run:
    """A mechanism released at rest: after every period it is back at its start, after half of it on the other side."""

    name: str
    period: float  #: [s]
    make: Callable[[float], Problem]  #: over an interval [s]
    levels: Callable[[float, Vector, Vector], Vector]
    energy: Callable[[Vector, Vector], float]
    depth: float  #: of the energy [J]
    angle: Callable[[Vector, Vector], tuple[float, float]]  #: of the first rod from below [rad], its rate


def _pendulum(end: float) -> Problem:
    return load_problem(f"pendulum_period2(t_end={end!r})")


def _angle(q: Vector, v: Vector) -> tuple[float, float]:
    return math.atan2(q[0], -q[1]), float((v[1] * q[0] - v[0] * q[1]) / (q[:2] @ q[:2]))


RUNS = (
    Run(
        "pendulum",
        2.0,
        _pendulum,
        lambda t, q, v: np.array([(q @ q - 1.0) / 2, q @ v]),
        lambda q, v: float(v @ v / 2 + PULL * q[1]),
        PULL,
        _angle,
    ),
    Run(
        "closed chain",
        PERIOD,
        parallelogram,
        parallelogram_levels,
        lambda q, v: float(v @ v / 2 + GRAVITY * (q[1] + q[3])),
        2 * GRAVITY * RADIUS,
        _angle,
    ),
)


@axis("long_run", "number of steps")
def long_run(seed: int) -> Iterator[Cell]:
    """Up to a million steps, 500 a swing, of a pendulum and a closed chain: levels, energy, phase after half swings."""
    for swings in (2, 20, 200, 2000):
        yield from _cells(swings, SECONDS, small=swings == 20)


@axis("longer_run", "number of steps")
def longer_run(seed: int) -> Iterator[Cell]:
    """Ten million of them."""
    yield from _cells(20_000, LONGER_SECONDS, small=False)


def _cells(swings: int, seconds: float, small: bool) -> Iterator[Cell]:
    for run in RUNS:
        halves = half_swings(swings)
        rows = halves * run.period / 2
        for line, request, level, energy in (
            (f"{run.name}, {STEPS} steps a swing", {"steps": STEPS * swings}, LEVELS, ENERGY),
            (f"{run.name}, rtol {RTOL:g}", {"rtol": RTOL}, 100 * RTOL * min(swings, DRIFTING), LOST),
        ):
            longer = max(1.0, swings / 2000)
            expected = {
                "both levels": Expected(error=held(run.levels), most=level),
                "energy": Expected(error=kept(run.energy, run.depth), most=energy * longer),
                "phase": Expected(error=partial(_phase, run, halves), most=PHASE * swings),
            }
            given: dict[str, Any] = {"make": partial(run.make, float(rows[-1])), "seconds": seconds, "small": small}
            asked = {**request, "t_eval": rows}
            yield Cell(x=float(STEPS * swings), line=line, request=asked, expected=expected, **given)


def half_swings(swings: int) -> Vector:
    """At which the rows are: odd and even ones in turn, and the last."""
    apart = max(1, 2 * swings // ROWS) | 1
    return np.append(np.arange(0, 2 * swings, apart), 2 * swings)


def _phase(run: Run, halves: Vector, problem: Problem, found: Solution) -> float:
    """Largest phase after half swings [rad], at each of which it stands still on the other side."""
    sides = np.where(halves % 2, -1.0, 1.0)
    states = [run.angle(q, v) for q, v in zip(found.q, found.v, strict=True)]
    phases = [
        math.atan2(-side * rate * run.period / (2 * math.pi), side * angle)
        for side, (angle, rate) in zip(sides, states, strict=True)
    ]
    return float(np.max(np.abs(np.unwrap(phases))))
