"""Ten million steps of a pendulum and of a closed chain: levels of the constraints, energy and phase."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ellipe, ellipk, ellipkinc

from hhtbench.catalogue.registry import load_problem
from hhtbench.conformance.cell import Cell, Expected, family
from hhtbench.conformance.families.errors import Error, held, kept
from hhtbench.conformance.scenes.linkages import parallelogram, parallelogram_levels
from hhtbench.conformance.scenes.pendulum import AMPLITUDE, GRAVITY, PERIOD, RADIUS
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Problem
from hhtbench.solution.result import Solution

STEPS = 500  # a swing
ROWS = 40  # of output, about
LEVELS = 1e-12  # of both levels, however long
COARSE = (2 * math.pi / STEPS) ** 2  # (h w)^2, by which a method of second order errs
ENERGY = COARSE  # over its range, however many steps of one length are made: it varies along a swing, and does not grow
RTOL = 1e-6
LOST = 5 * RTOL  # of the energy, a swing under error control: five tolerances, of as many swings as MIN_SWINGS at least
PHASE = 2 * math.pi * COARSE / 4  # [rad] a swing: it grows in proportion to them
MIN_SWINGS = 200  # over which a loss of energy is allowed
DRIFTING = 20  # swings, in which levels may drift under error control, by a hundred times the tolerance each
CONTROLLED, MAX_STEPS = 2000, 100_000_000  # swings under error control, and steps of one run
MAX_SECONDS = 30.0  # of one solve
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
    amplitude: float  #: of the rods [rad]


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
        math.pi / 2,
    ),
    Run(
        "closed chain",
        PERIOD,
        parallelogram,
        parallelogram_levels,
        lambda q, v: float(v @ v / 2 + GRAVITY * (q[1] + q[3])),
        2 * GRAVITY * RADIUS,
        AMPLITUDE,
    ),
)


@family("long_run", "number of steps")
def long_run(seed: int) -> Iterator[Cell]:
    """Up to ten million steps, 500 a swing, of a pendulum and a closed chain: levels, energy, phase after half swings."""
    for swings in (2, 20, 200, 2000, 20_000):
        for run in RUNS:
            limits = LEVELS, ENERGY, PHASE * swings
            yield _cell(run, swings, f"{STEPS} steps a swing", {"steps": STEPS * swings}, limits)
            if swings <= CONTROLLED:
                request = {"rtol": RTOL, "max_num_steps": MAX_STEPS}
                yield _cell(run, swings, f"rtol {RTOL:g}", request, _drifting(run, swings))


def _drifting(run: Run, swings: int) -> tuple[float, float, float]:
    """What levels, energy and phase may be off by under error control, whose errors add up.

    The period goes with K(m), and m with half the energy over its range: energy that is lost turns the phase by pi/2 K'/K
    times what a swing loses times the square of the swings.  Of a phase that is off by half a turn nothing is known.
    """
    m = math.sin(run.amplitude / 2) ** 2
    slope = (ellipe(m) / ellipk(m) / (1 - m) - 1) / (2 * m)
    phase = PHASE * swings + math.pi / 2 * slope * LOST * swings**2
    return 100 * RTOL * min(swings, DRIFTING), LOST * max(swings, MIN_SWINGS), min(phase, math.pi)


def _cell(run: Run, swings: int, way: str, request: dict[str, Any], limits: tuple[float, float, float]) -> Cell:
    halves = half_swings(swings)
    rows = halves * run.period / 2
    errors: tuple[Error, ...] = (held(run.levels), kept(run.energy, run.depth), partial(_phase, run, halves))
    names = "both levels", "energy", "phase"
    expected = {name: Expected(error=error, most=most) for name, error, most in zip(names, errors, limits, strict=True)}
    make, asked = partial(run.make, float(rows[-1])), {**request, "t_eval": rows}
    given: dict[str, Any] = {
        "make": make,
        "request": asked,
        "expected": expected,
        "seconds": MAX_SECONDS,
        "small": swings == 20,
    }
    return Cell(x=float(STEPS * swings), line=f"{run.name}, {way}", **given)


def half_swings(swings: int) -> Vector:
    """At which the rows are: odd and even ones in turn, and the last."""
    apart = max(1, 2 * swings // ROWS) | 1
    return np.append(np.arange(0, 2 * swings, apart), 2 * swings)


def _phase(run: Run, halves: Vector, problem: Problem, found: Solution) -> float:
    """Largest phase after half swings [rad], at each of which it stands still on the other side.

    Of Jacobi's u: sin(angle/2) = k sn u and rate = 2 k w cn u, k = sin(amplitude/2) and w = 4 K/period.
    """
    k = math.sin(run.amplitude / 2)
    quarter = float(ellipk(k * k))
    fastest = 8 * k * quarter / run.period
    sides = np.where(halves % 2, -1.0, 1.0)
    angle, rate = np.array([_angle(q, v) for q, v in zip(found.q, found.v, strict=True)]).T
    u = ellipkinc(np.arctan2(sides * np.sin(angle / 2) / k, sides * rate / fastest), k * k)
    return float(np.max(np.abs(np.unwrap(math.pi / 2 * (u / quarter - 1.0)))))
