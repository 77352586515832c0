"""Ten million steps of a pendulum: levels of the constraint, energy and phase.

It is released at rest at a right angle, with a period of 2 s: after every swing it is back there, after half of it on the
other side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ellipe, ellipk, ellipkinc

from hhtbench.catalogue.registry import load_problem
from hhtbench.conformance.cell import Cell, Error, Expected, family
from hhtbench.conformance.families.errors import held, kept
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

STEPS = 500  # a swing
ROWS = 40  # number of output rows, about
LEVELS = 1e-12  # violation of both levels, however long the run
COARSE = (2 * math.pi / STEPS) ** 2  # (h w)^2, by which a method of second order errs
ENERGY = COARSE  # over its range, however many steps of one length are made: it varies along a swing, and does not grow
RTOL = 1e-6
LOST = 5 * RTOL  # of the energy, a swing under error control: five tolerances, of as many swings as MIN_SWINGS at least
PHASE = 2 * math.pi * COARSE / 4  # [rad] a swing: it grows in proportion to them
MIN_SWINGS = 200  # over which a loss of energy is allowed
DRIFTING = 20  # swings, in which levels may drift under error control, by a hundred times the tolerance each
CONTROLLED, MAX_STEPS = 2000, 100_000_000  # swings under error control, and steps of one run
MAX_SECONDS = 30.0  # of one solve
M = 0.5  # sin^2 of half the amplitude, the parameter of the elliptic functions
QUARTER = float(ellipk(M))
PULL = (2 * QUARTER) ** 2  # gravity [m/s^2]
FASTEST = 4 * math.sqrt(M) * QUARTER  # [rad/s]


@family("long_run", "number of steps")
def long_run(seed: int) -> Iterator[Cell]:
    """Up to ten million steps of a pendulum, 500 a swing, and under error control: levels, energy, phase at half swings."""
    for swings in (2, 20, 200, 2000, 20_000):
        yield _cell(swings, f"{STEPS} steps a swing", {"steps": STEPS * swings}, (LEVELS, ENERGY, PHASE * swings))
        if swings <= CONTROLLED:
            yield _cell(swings, f"rtol {RTOL:g}", {"rtol": RTOL, "max_num_steps": MAX_STEPS}, _drifting(swings))


def _drifting(swings: int) -> tuple[float, float, float]:
    """Return the allowed errors of levels, energy and phase under error control, where errors accumulate.

    The period goes with K(m), and m with half the energy over its range: energy that is lost turns the phase by pi/2 K'/K
    times the loss per swing times the square of the number of swings.  A phase error of half a turn is the largest
    measurable.
    """
    slope = (ellipe(M) / ellipk(M) / (1 - M) - 1) / (2 * M)
    phase = PHASE * swings + math.pi / 2 * slope * LOST * swings**2
    return 100 * RTOL * min(swings, DRIFTING), LOST * max(swings, MIN_SWINGS), min(phase, math.pi)


def _cell(swings: int, way: str, request: dict[str, Any], limits: tuple[float, float, float]) -> Cell:
    halves = half_swings(swings)
    errors: tuple[Error, ...] = (
        held(_levels),
        kept(lambda q, v: float(v @ v / 2 + PULL * q[1]), PULL),
        partial(_phase, halves),
    )
    names = "both levels", "energy", "phase"
    return Cell(
        x=float(STEPS * swings),
        line=way,
        make=partial(load_problem, f"pendulum_period2(t_end={float(halves[-1])!r})"),
        request={**request, "t_eval": halves.astype(float)},
        expected={name: Expected(error=error, most=most) for name, error, most in zip(names, errors, limits, strict=True)},
        seconds=MAX_SECONDS,
        small=swings == 20,
    )


def _levels(t: float, q: Vector, v: Vector) -> Vector:
    return np.array([(q @ q - 1.0) / 2, q @ v])


def half_swings(swings: int) -> Vector:
    """Return the half swings at which there are rows, 1 s each: odd and even ones alternately, and the last."""
    apart = max(1, 2 * swings // ROWS) | 1
    return np.append(np.arange(0, 2 * swings, apart), 2 * swings)


def _phase(halves: Vector, problem: Problem, found: Solution) -> float:
    """Return the largest phase error after half swings [rad], where the pendulum is at rest on the other side.

    From Jacobi's u: sin(angle/2) = k sn u and rate = 2 k w cn u, k^2 = M and w = QUARTER / 0.5 s.
    """
    angle = np.arctan2(found.q[:, 0], -found.q[:, 1])
    rate = found.v[:, 1] * found.q[:, 0] - found.v[:, 0] * found.q[:, 1]  # the rod is 1 m long
    sides = np.where(halves % 2, -1.0, 1.0)
    u = ellipkinc(np.arctan2(sides * np.sin(angle / 2) / math.sqrt(M), sides * rate / FASTEST), M)
    return float(np.max(np.abs(np.unwrap(math.pi / 2 * (u / QUARTER - 1.0)))))
