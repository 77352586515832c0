"""Multipliers that are disturbed at the start, step by step against the closed recurrences of the methods.

Along y, across a straight guide, a unit mass has y'' = f - lam and every method is a recurrence of steps of length h in what
it hands on: v, a, and s = f - lam where a holds reactions. Of differences of two runs, with y = 0 at every step:

    HHT, b = 0:       a1 = -alpha f0,   lam0 = 2 v0 / h + (1 - 2 beta) a0 + 2 beta a1,
                      lam1 = 2 v0 / h + 2 (1 - gamma) a0 + 2 gamma a1 - lam0,   v1 = 0
    index 3:          a1 = -(v0 / h + (1/2 - beta) a0) / beta,   v1 = v0 + h ((1 - gamma) a0 + gamma a1)
    stabilised:       a1 = -(v0 / h + (1 - gamma) a0) / gamma,   v1 = 0
    both of these:    lam1 = -s1,   (1 - af) s1 + af s0 = (1 - am) a1 + am a0
    RATTLE:           lam1 = 0

A force that was wrong at the start has left HHT's multipliers after two steps, whatever alpha: reactions are no part of a.
In the others a velocity off the level leaves a vibration of the step's frequency that each step multiplies by the roots of
the method at infinity, in the stabilised form by -(1 - gamma) / gamma and -af / (1 - af).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.conformance import cell
from hhtbench.conformance.cell import Cell, Expected
from hhtbench.conformance.families.errors import motion, own_multipliers
from hhtbench.conformance.families.recurrence import METHODS, Weights
from hhtbench.conformance.scenes.scene import on_motion
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Motion, Problem, System, parameter
from hhtbench.solution.result import Solution

COUNT = 12  # steps
EPS = float(np.finfo(np.float64).eps)
ROUNDED = 100 * EPS  # of a position, which multipliers hold divided by h^2
PRESS, PUSH = 1.0, 1.0  # against the guide: at all times, and besides [m/s^2]
OFF = 5e-9  # of a velocity at the start [m/s]: accepted as consistent
CURVATURE = 10.0  # error over h^2 of a method of second order on a motion of frequency 1 [1/s^2]
ALONG, ACROSS = np.array([0.8, -0.6]), np.array([0.6, 0.8])
SMALL = ("hht, alpha = -0.3", "generalised_alpha, index 3, rho = 0.8", "rattle")
NEVER = -1.0  # [s], before which it has begun


class Guided(System):
    """A unit mass on a straight guide, on a spring along it and pressed against it."""

    begin: Any = parameter(NEVER, doc="of the push [s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """(2,) [m/s^2]."""
        return -(ALONG @ q) * ALONG + (PRESS + PUSH * (t > self.begin)) * ACROSS

    def constraint(self, t: Any, q: Any) -> Any:
        """The guide."""
        return (ACROSS @ q)[None]


def guided(h: float, begin: float = NEVER, off: float = 0.0) -> Problem:
    """cos t - sin t along the guide; the push wakes after ``begin``, the start is ``off`` across [m/s]."""

    def exact(t: float) -> Motion:
        c, s = np.cos(t), np.sin(t)
        return Motion((c - s) * ALONG, -(c + s) * ALONG, np.array([PRESS + PUSH]), np.zeros(0))

    given = on_motion("guided", Guided(begin=begin), exact, COUNT * h)
    return replace(given, v0=given.v0 + off * ACROSS)


Modes = Callable[[float, float, float], Vector]  #: h, jump of the force, v off the level -> (COUNT,) differences of lam


def of_hht(weights: Weights, h: float, jump: float, off: float) -> Vector:
    """The extended HHT with b = 0, whose a0 is that of the force."""
    alpha, found = -weights.af, np.zeros(COUNT)
    a, v, f = -jump, off, -jump
    for k in range(COUNT):
        after = -alpha * f
        first = 2 * v / h + (1 - 2 * weights.beta) * a + 2 * weights.beta * after
        found[k] = 2 * v / h + 2 * (1 - weights.gamma) * a + 2 * weights.gamma * after - first
        a, v, f = after, 0.0, 0.0
    return found


def of_newmark(weights: Weights, stabilised: bool, h: float, jump: float, off: float) -> Vector:
    """Where a holds the reactions: a jump of the force is taken up at once."""
    found, a, v, s = np.zeros(COUNT), 0.0, off, 0.0
    for k in range(COUNT):
        if stabilised:
            after, v = -(v / h + (1 - weights.gamma) * a) / weights.gamma, 0.0
        else:
            after = -(v / h + (0.5 - weights.beta) * a) / weights.beta
            v += h * ((1 - weights.gamma) * a + weights.gamma * after)
        s = ((1 - weights.am) * after + weights.am * a - weights.af * s) / (1 - weights.af)
        found[k], a = -s, after
    return found


def of_rattle(h: float, jump: float, off: float) -> Vector:
    """Its multipliers are those of the end of each step alone."""
    return np.zeros(COUNT)


def _methods() -> Iterator[tuple[str, str, dict[str, Any], Modes]]:
    """Line, solver, options and closed form."""
    for line, families, options, weights in METHODS:
        for family in families:
            if family == "hht":
                yield f"{family}, {line}", family, options, partial(of_hht, weights)
            elif family == "rattle":
                yield family, family, options, of_rattle
            else:
                yield f"{family}, {line}", family, options, partial(of_newmark, weights, family == "generalised_alpha")
            if family == "generalised_alpha":
                more = {**options, "form": "index3"}
                yield f"{family}, index 3, {line}", family, more, partial(of_newmark, weights, False)


@cell.family("multiplier_modes", "length of a step [s]")
def multiplier_modes(seed: int) -> Iterator[Cell]:
    """Multipliers disturbed at the start, by a force that was wrong or a velocity: their way back, step by step, closed."""
    for h in (1e-3, 1e-2, 1e-1):
        undisturbed = (partial(guided, h), {"steps": COUNT, "t_eval": None})
        for name, begin, off in (("force", 0.0, 0.0), ("velocity", NEVER, OFF)):
            unit = PUSH if begin == 0.0 else off / h
            for line, family, options, closed in _methods():
                known = closed(h, PUSH * (begin == 0.0), off) / unit
                noise = ROUNDED / (h * h * unit) * max(1.0, float(np.max(np.abs(known))))
                modes = {"multipliers": Expected(error=partial(_off_modes, known, unit), most=noise)}
                yield Cell(
                    x=h,
                    line=f"{name}: {line}",
                    make=partial(guided, h, begin, off),
                    request=undisturbed[1],
                    expected=modes | motion(CURVATURE * h**2 + 10 * off),
                    options=options,
                    families=(family,),
                    further=(undisturbed,),
                    small=h == 1e-2 and line in SMALL,
                )


def _off_modes(known: Vector, unit: float, problem: Problem, found: Solution, besides: Solution) -> float:
    """Largest difference of the multipliers' disturbance from the closed one over the steps, which must be all of them."""
    if found.t.size != known.size + 1:
        return math.inf
    disturbed = (own_multipliers(found) - own_multipliers(besides))[1:, 0] / unit
    return float(np.max(np.abs(disturbed - known)))
