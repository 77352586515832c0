"""Constraints that are nearly dependent, dependent, or become so on the way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.catalogue.registry import load_problem
from hhtbench.conformance.cell import Cell, Expected, cells, family, rtol, step
from hhtbench.conformance.families.errors import at_the_end, held, reacting
from hhtbench.conformance.scenes.circles import crossed_levels, leaning
from hhtbench.conformance.subject import ACCURACY
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.problem import Motion, Problem

SPAN = 2.0  # [s]
LEVELS = 1e-12
ROUNDED = 20 * float(np.finfo(np.float64).eps)
BRANCH = 0.3  # distance in scaled positions below which it is this branch and no other
CURVATURE = 200.0  # error over h^2 of a method of second order on the branch [1/s^2]; HHT's is 104 on the slider-crank
CRANK_ANGLE, CRANK_RATE = math.pi / 4, 4.0  # at the start of the slider-crank [rad], [rad/s]


def _leaning(rows: Matrix, x: float, small: bool, known: float) -> Iterator[Cell]:
    """Yield cells with constraint ``rows``; ``known``: roundoff of the rows divided by their difference."""
    for way, level in ((rtol(1e-5), ACCURACY * 1e-5), (step(1e-2, 1e-3), LEVELS)):
        levels = {"both levels": Expected(error=held(crossed_levels), most=level + known)}
        expected = reacting(way.most + known, rows) | levels
        given: dict[str, Any] = {"small": small, "cause": "depend on the others and were left out"}
        yield from cells(x, partial(leaning, rows, SPAN), [way], expected, **given)


@family("rank", "angle between two rows of constraints [rad]")
def rank(seed: int) -> Iterator[Cell]:
    """Two rows that are nearly one: motion, levels and reaction as if they were apart, but for the roundoff of the rows."""
    for power in (0, -2, -4, -6, -8, -10, -12, -14):
        x = 10.0**power
        yield from _leaning(np.array([[1.0, 0.0], [1.0, x]]), x, power in (-4, -10), ROUNDED / x)


@family("redundant", "a row once more, times")
def redundant(seed: int) -> Iterator[Cell]:
    """A row of constraints twice, at every scale: motion, levels and sum of reactions as if it were there once, closed."""
    for power in (-12, -8, -4, 0, 4, 8, 12):
        x = 10.0**power
        yield from _leaning(np.array([[1.0, 0.0], [0.0, 1.0], [x, 0.0]]), x, power in (-8, 0), 0.0)


def _slider_crank() -> Problem:
    return replace(load_problem("slider_crank_equal_lengths"), exact=_smooth_branch)


def _smooth_branch(t: float) -> Motion:
    """Motion of the slider-crank (all lengths and masses 1) on the smooth branch, from the energy by DOP853."""

    def inertia(angle: float) -> float:
        return 1 / 3 + 3 * math.sin(angle) ** 2

    total = inertia(CRANK_ANGLE) * CRANK_RATE**2 + 9.81 * math.sin(CRANK_ANGLE)

    def rate(_: float, y: Any) -> Any:
        return [math.sqrt((total - 9.81 * math.sin(y[0])) / inertia(y[0]))]

    angle = float(solve_ivp(rate, (0.0, t), [CRANK_ANGLE], "DOP853", rtol=1e-11, atol=1e-12).y[0, -1]) if t else CRANK_ANGLE
    turn = rate(t, [angle])[0]
    q = np.array([angle, -angle, 2 * math.cos(angle)])
    return Motion(q, turn * np.array([1.0, -1.0, -2 * math.sin(angle)]), np.full(2, np.nan), np.zeros(0))


@family("dead_points", "relative tolerance, or 1 / number of steps")
def dead_points(seed: int) -> Iterator[Cell]:
    """Positions where constraints lose rank and branches cross: the smooth one, closed, or by DOP853 from the energy."""
    for name, make, end in (
        ("four-bar window", partial(load_problem, "four_bars(n_windows=1, t_end=1.0)"), 1.0),
        ("two windows", partial(load_problem, "four_bars(n_windows=2, t_end=1.0)"), 1.0),
        ("slider-crank", _slider_crank, 2.0),
    ):
        ways = [(f"{name}, rtol", x, {"rtol": x}, ACCURACY * x) for x in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)]
        for count in (200, 500, 1000, 2000, 5000):
            ways.append((f"{name}, steps", 1 / count, {"steps": count}, CURVATURE * (end / count) ** 2))
        for line, x, request, most in ways:
            bounds = {"branch": BRANCH, "accuracy on it": most}
            expected = {what: Expected(error=at_the_end, most=bound) for what, bound in bounds.items()}
            small = name == "slider-crank" and "rtol" in request and x in (1e-4, 1e-6)
            asked = {**request, "t_eval": [end]}
            yield Cell(x=x, line=line, make=make, request=asked, expected=expected, small=small)
