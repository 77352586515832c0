"""Pendulums: masses, variable steps, units, origins of time, spans, and vibrations that the tension carries."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.catalogue.registry import load_problem
from hhtbench.conformance.cell import ROWS, Cell, Expected, Way, cells, family, rtol, step
from hhtbench.conformance.families.errors import held, motion, off
from hhtbench.conformance.families.springs import CURVATURE, beside
from hhtbench.conformance.scenes.circles import stiff
from hhtbench.conformance.scenes.linkages import DoublePendulum, double_pendulum, double_pendulum_angles
from hhtbench.conformance.scenes.pendulum import PERIOD, Frame, pendulum
from hhtbench.conformance.scenes.scene import SPAN, Scene
from hhtbench.conformance.subject import ACCURACY
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

SWING = 100.0  # error over h^2 of a method of second order in a swing of the pendulum [1/s^2]; HHT's is near 10
ROUNDOFF = 1e-9
COUNT = 200  # steps of a run with variable ones
STIFF, STIFF_SPAN = 1e8, 5.0  # [1/s^2], [s]
IN_PHASE = 0.3  # error of a scaled motion, however long: a phase lost gives 2
MOVED = 0.5  # least distance from the start over the amplitude: damped or not, a vibration leaves it
ROUNDED = 1e-12  # violation of both levels, per second
RESOLVED = 0.1  # of the amplitude, where sixty steps make a period: a phase of 0.02 rad is HHT's in 200 steps
OFF = 5e-9  # violation of a start that is accepted as consistent
FAINT = 1e-6  # amplitude of a vibration [rad]


@family("masses", "lower mass over upper mass")
def masses(seed: int) -> Iterator[Cell]:
    """A double pendulum of masses up to 1e8 apart: DOP853 in minimal coordinates."""
    for power in range(-8, 9, 2):
        ratio = 10.0**power
        for way in (rtol(1e-4), rtol(1e-6), step(1e-3, 1e-3)):
            small = power in (-8, -4, 4) and way.line != "rtol 1e-06"
            make = partial(double_pendulum, ratio, 1.0)
            expected = {"end": Expected(error=partial(_off_angles, ratio), most=way.most)}
            yield from cells(ratio, make, [way], expected, t_eval=[1.0], small=small)


def _off_angles(ratio: float, problem: Problem, found: Solution) -> float:
    exact, _ = DoublePendulum.bent(*double_pendulum_angles(0.5, ratio, 1.0))
    return float(np.max(np.abs(found.q[-1] - exact)))


@family("ratios", "largest ratio of neighbouring steps")
def ratios(seed: int) -> Iterator[Cell]:
    """Variable steps, alternating and drawn, on a swing and beside a stiff spring: closed solutions."""
    for ratio in (1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 100.0, 1000.0):
        for name, lengths in (("1 : r", _alternating(ratio)), ("drawn", _drawn(ratio, seed))):
            h = float(lengths.max())
            ways: list[tuple[str, Any, float, Any]] = [
                ("swing", _swing_over, SPAN[1], motion),
                ("stiff", partial(stiff, STIFF), STIFF_SPAN, partial(beside, STIFF)),
            ]
            for which, make, length, known in ways:
                most = (SWING if which == "swing" else CURVATURE) * (length * h) ** 2 + ROUNDOFF
                way = Way(f"{name}, {which}", {"steps": length * lengths}, most)
                yield from cells(ratio, partial(make, length), [way], known, small=ratio in (2.0, 100.0))


UNITS = Frame()


def _swing_over(length: float, begin: float = 0.0, frame: Frame = UNITS) -> Problem:
    return pendulum(frame=frame, t_span=(begin, begin + length)).problem


def _alternating(ratio: float) -> Vector:
    """Step lengths 1, r, 1, r, ..., normalised to the sum 1."""
    lengths = np.tile([1.0, ratio], COUNT // 2)
    return lengths / math.fsum(lengths)


def _drawn(ratio: float, seed: int) -> Vector:
    """Random step lengths between 1 and r, log-uniform, normalised to the sum 1."""
    lengths = ratio ** np.random.default_rng(seed).uniform(size=COUNT)
    return np.asarray(lengths / math.fsum(lengths))


PLAIN = rtol(1e-5), Way("300 steps", {"steps": 300}, SWING * (SPAN[1] / 300) ** 2)


@family("units", "new units in an old one")
def units(seed: int) -> Iterator[Cell]:
    """The swing in micrometres and megametres, micrograms and gigagrams, microseconds and weeks: closed solution."""
    for power in (-6, -3, 0, 3, 6):
        for name in ("length", "mass", "time"):
            frame = replace(Frame(), **{name: 10.0**power})  # type: ignore[arg-type]
            make = partial(_swing_over, SPAN[1] * frame.time, frame=frame)
            yield from cells(10.0**power, make, PLAIN, motion, named=f"{name}, {{}}", small=abs(power) == 6)


@family("origin", "time at the start [s]")
def origin(seed: int) -> Iterator[Cell]:
    """The swing begun at up to 1e12 s: closed solution, and what a rounded time moves."""
    for t0 in (0.0, 1e3, 1e6, 1e9, 1e12):
        rounded = 1e3 * float(np.spacing(t0))  # a hundred times the distance of times, at 10 m/s^2
        ways = [way._replace(most=way.most + rounded) for way in PLAIN]
        yield from cells(t0, partial(_swing_over, SPAN[1], t0), ways, motion, small=t0 == 1e9)


@family("span", "length of the interval [s]")
def span(seed: int) -> Iterator[Cell]:
    """The swing over intervals from 1e-100 s to 1000 s: closed solution, its phase within a third of a radian."""
    for length in (1e-100, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e1, 1e2, 1e3):
        count, longer = max(100, round(200 * length)), max(1.0, length)
        most = SWING * (length / count) ** 2 * longer + 1e-12
        ways = rtol(1e-6, longer), Way("100 steps, at least 200 a second", {"steps": count}, most)
        ways_in_phase = [way._replace(most=min(way.most, IN_PHASE)) for way in ways]
        rows = np.linspace(0.0, length, ROWS)
        small = length in (1e-12, 1e2)
        yield from cells(length, partial(_swing_over, length), ways_in_phase, motion, t_eval=rows, small=small)


@family("tension", "frequency times step")
def tension(seed: int) -> Iterator[Cell]:
    """A vibration that the tension of a rod carries, steps up to 200 times too long: it neither grows nor stands still."""
    h, amplitude = 0.01, 1e-3
    for o in (0.1, 0.5, 1.0, 1.9, 2.1, 5.0, 20.0, 200.0):
        small, expected = o in (0.1, 2.1, 200.0), _vibrates(amplitude)
        resolved = {"resolved": Expected(error=off, most=RESOLVED * amplitude)}
        if o == 0.1:
            expected |= resolved
        given: dict[str, Any] = {"x": o, "make": partial(_swing, o / h, amplitude, 200 * h), "expected": expected}
        yield Cell(line="h = 0.01 s", request={"step": h}, small=small, **given)
        for b in (0.0, 0.2, 0.4, 1.0):
            yield Cell(line=f"h = 0.01 s, b = {b:g}", request={"step": h}, options={"b": b}, families=("hht",), **given)
        damped: dict[str, Any] = {"options": {"extrapolate_reaction": True}, "families": ("hht",), **given}
        yield Cell(line="h = 0.01 s, extrapolated", request={"step": h}, **damped)
        yield Cell(line="rtol 1e-06", request={"rtol": 1e-6}, **given | {"expected": expected | resolved})
        few = partial(_swing, o / h, FAINT, 20 * h)  # what grows ends before Newton's iteration fails
        yield Cell(x=o, line="h = 0.01 s, few, faint", make=few, request={"step": h}, expected=_vibrates(FAINT))


def _swing(omega: float, amplitude: float, length: float) -> Problem:
    """Pendulum of frequency ``omega`` [rad/s] over ``length`` [s]."""
    return load_problem(f"simple_pendulum(g={omega**2!r}, amplitude={amplitude!r}, t_end={length!r})")


def _vibrates(released: float) -> dict[str, Expected]:
    """Expect a vibration that stays below three times the ``released`` angle [rad] and does not stand still."""
    return {
        "size": Expected(error=partial(_amplitude, released), most=3.0),
        "standstill": Expected(error=partial(_standstill, released), most=1.0 / MOVED),
    }


def _angles(found: Solution) -> Vector:
    return np.arctan2(found.q[:, 0], -found.q[:, 1])


def _standstill(released: float, problem: Problem, found: Solution) -> float:
    """Ratio of the starting angle to the largest distance from it."""
    return released / max(float(np.max(np.abs(_angles(found) - released))), np.finfo(np.float64).tiny)


def _amplitude(released: float, problem: Problem, found: Solution) -> float:
    """Ratio of the largest angle to that at the start."""
    return float(np.max(np.abs(_angles(found)))) / released


@family("perturbations", "error of the start [m, m/s]")
def perturbations(seed: int) -> Iterator[Cell]:
    """A start a little off one level of the constraints, against one that is not: what is left grows at most as a line."""
    length = 3 * PERIOD
    scene = pendulum(t_span=(PERIOD / 5, PERIOD / 5 + length), start=0.0)
    for size in (1e-10, 1e-9, OFF):
        for mode, off_q, off_v in (("position", size, 0.0), ("velocity", 0.0, size)):
            make = partial(_off_start, scene, off_q, off_v)
            for line, request, noise, slack in (
                (f"{mode}, rtol 1e-08", {"rtol": 1e-8}, 1e-8, ACCURACY * 1e-8),
                (f"{mode}, h = 0.005 s", {"step": 5e-3}, ROUNDED, SWING * 5e-3**2),
            ):
                expected = {
                    "both levels": Expected(error=held(partial(_both, scene)), most=(3 * size + slack) * (1 + length)),
                    "what is left": Expected(error=partial(_left, scene), most=(3 * size + noise) * (1 + length)),
                }
                further = ((partial(_off_start, scene, 0.0, 0.0), request),)
                small = size == OFF and "rtol" not in request
                given: dict[str, Any] = {"make": make, "request": request, "further": further, "small": small}
                yield Cell(x=size, line=line, expected=expected, **given)


def _off_start(scene: Scene, off_q: float, off_v: float) -> Problem:
    given = scene.problem
    normal = given.q0 / np.linalg.norm(given.q0)
    return replace(given, q0=given.q0 + off_q * normal, v0=given.v0 + off_v * normal, exact=None)


def _both(scene: Scene, t: float, q: Vector, v: Vector) -> Vector:
    return np.concatenate(scene.levels(t, q, v))


def _left(scene: Scene, problem: Problem, found: Solution, besides: Solution) -> float:
    """Largest difference of both constraint levels between two runs."""

    def both(run: Solution) -> Vector:
        return np.array([_both(scene, *row) for row in zip(run.t, run.q, run.v, strict=True)])

    return float(np.max(np.abs(both(found) - both(besides))))
