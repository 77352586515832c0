"""Where the velocity of a prescribed motion jumps, and the impulse of the constraints there.

A table of positions in ``g`` has kinks: ``g_t`` jumps, and with it the velocities, by ``-M^-1 G^T p``.  The jumps are found
without a solution: ``g_t`` depends on time and coordinates, and is looked up over time at fixed coordinates.  Bisection goes
on where it is not linear, until two neighbouring floating-point times are left; there it either jumps or it does not.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.lowering import (
    AccelerationLevel,
    ConstraintLevels,
    Dynamics,
    derive,
    reduce_redundant,
)
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.system import Problem

SAMPLES = 400  # equal parts of the interval that are searched
SMALLEST_JUMP = 1e-6  # of the largest value of the same row: smaller jumps are not searched for
SPLIT = 0.381966  # of an interval: at its middle a kink may have the mean of both sides
MAX_INTERVALS = 100_000  # that one search may split: a function that needs more is no table
DIFFERENCES = 1e-7  # s: half the length over which g_t of plain callables is the mean slope of g
NEIGHBOURS = 8  # spacings of floating-point times within which two jumps are one
BESIDE = 0.1  # of the scales: how far beside the start functions are compared too, since terms may vanish there
ROUNDOFF = 1e-12  # of the largest value of the same kind


@dataclass(frozen=True)
class Jumps:
    """The jumps of one problem's prescribed velocities, in the order in which the motion comes to them."""

    times: Vector  #: (k,) [s]
    before: Vector  #: (k,) the last times at which the functions are those before the jumps [s]
    after: Vector  #: (k,) the first times at which they are those behind them [s]
    declined: str = ""  #: which jump makes the motion undetermined, or cannot be resolved, at what time; "" where none does
    _dynamics: Dynamics | None = None

    def between(self, start: float, end: float) -> list[int]:
        """The jumps that a motion from ``start`` [s] to ``end`` [s] comes to."""
        sign = 1.0 if end > start else -1.0
        inside = (sign * self.before >= sign * start) & (sign * self.after <= sign * end)
        return [int(i) for i in np.flatnonzero(inside)]

    def towards(self, direction: float) -> Jumps:
        """These jumps as a motion comes to them in that ``direction`` of time."""
        if not self.times.size or (self.after[0] > self.before[0]) == (direction > 0.0):
            return self
        return replace(self, times=self.times[::-1], before=self.after[::-1], after=self.before[::-1])

    def near(self, t: Any, distance: float) -> Any:
        """Whether each of the times ``t`` (k,) is within ``distance`` [s] of a jump."""
        return np.any(np.abs(np.asarray(t)[:, None] - self.times) <= distance, axis=1)

    def velocities(self, i: int, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """The velocities (n,) behind jump ``i`` of a motion with ``q, v`` (n,) before it, and the impulse p (m + p,).

        ``M (v_after - v) = -G^T p`` and ``G (v_after - v) = -(g_t after - g_t before)``; a declared linear reaction stands
        for ``-G^T p``, and velocity constraints hold on both sides.  Impulses of redundant rows are zero.

        Raises
        ------
        ValueError
            The mass and the constraints determine no impulse at q.
        """
        dynamics = self._dynamics
        assert dynamics is not None  # noqa: S101 - there are jumps, so constraints depend on time
        s = dynamics.structure
        before, after = (float(x[i]) for x in (self.before, self.after))
        levels = ConstraintLevels(dynamics, full=True)
        g_t = [levels.at(t, q, v).time_derivative for t in (before, after)]
        redundant = levels.at(after, q, v).rank.redundant
        reduced = reduce_redundant(dynamics, redundant) if redundant else dynamics
        kept = np.setdiff1d(np.arange(s.m + s.p), redundant)
        if reduced is None:
            raise ValueError("constraints are redundant, and a declared reaction may depend on every multiplier")
        change = np.concatenate([g_t[1] - g_t[0], np.zeros(s.p)])[kept]
        _, matrix = AccelerationLevel(reduced, full=True).terms(after, q, v, np.zeros(s.n + kept.size))
        try:
            found = np.linalg.solve(matrix, np.concatenate([np.zeros(s.n), -change]))
        except np.linalg.LinAlgError as error:
            raise ValueError(f"the KKT matrix is singular at the jump at t = {self.times[i]:.17g}") from error
        impulse = np.zeros(s.m + s.p)
        impulse[kept] = found[s.n :]
        return v + found[: s.n], impulse


NONE = Jumps(np.zeros(0), np.zeros(0), np.zeros(0))


def find_jumps(problem: Problem, times: Any = None) -> Jumps:
    """The times within the interval of ``problem`` at which its prescribed velocities jump.

    Parameters
    ----------
    times
        (k,) between which is searched too [s], as well as in equal parts of the interval.  A velocity that jumps and
        returns between two times is not seen.
    """
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    s = dynamics.structure
    if not ((s.m and s.rheonomic) or s.p):
        return NONE
    times = np.zeros(0) if times is None else np.asarray(times, dtype=np.float64)
    times = np.unique(np.concatenate([times[np.isfinite(times)], np.linspace(*problem.t_span, SAMPLES + 1)]))
    times = times[(times >= min(problem.t_span)) & (times <= max(problem.t_span))]
    search = _Search(dynamics, problem)
    try:
        before, after = search.jumps(times)
    except _TooMany as error:
        return Jumps(np.zeros(0), np.zeros(0), np.zeros(0), str(error), dynamics)
    if problem.t_span[1] < problem.t_span[0]:
        before, after = after[::-1], before[::-1]
    at = np.array([_shortest(*pair) for pair in zip(before, after, strict=True)])
    return Jumps(at, before, after, search.declined(at, before, after) if at.size else "", dynamics)


class _TooMany(Exception):
    """The constraints depend too irregularly on time; the text says where."""


class _Search:
    """The functions of time whose jumps are searched: g, g_t, g_q, k, k_v at fixed states."""

    def __init__(self, dynamics: Dynamics, problem: Problem) -> None:
        s = self._s = dynamics.structure
        self._dynamics, self._levels = dynamics, ConstraintLevels(dynamics, full=True)
        declares = ("constraint_time_derivative", "constraint_acceleration")
        self._by_slope = dynamics.xp is np and s.m > 0 and not all(map(dynamics.gives, declares))
        self._shortest = 4.0 * DIFFERENCES if self._by_slope else 0.0
        self._rows = ConstraintLevels(dynamics).at_rows()
        beside = [
            np.cos(np.arange(s.n) + phase) * size for phase, size in ((1.0, problem.scales.q), (2.0, problem.scales.v))
        ]
        start = problem.q0, problem.v0
        self._states = [start, tuple(x + BESIDE * other for x, other in zip(start, beside, strict=True))]
        kinds = {"g": s.m, "g_t": s.m, "g_q": s.m * s.n, "k": s.p, "k_v": s.p * s.n}
        self._kinds = np.tile(np.repeat(list(kinds), list(kinds.values())), len(self._states))  #: of every column
        self._v_scale = float(np.max(problem.scales.v))

    def jumps(self, times: Vector) -> tuple[Vector, Vector]:
        """Neighbouring times (k,) before and behind every jump between the rising ``times``."""
        f = self._at(times)
        self._allowed = self._roundoff(f) + SMALLEST_JUMP * np.nanmax(np.abs(f), axis=0)
        low, high, of_low, of_high = times[:-1], times[1:], f[:-1], f[1:]
        found: list[tuple[float, float]] = []
        while low.size:
            if low.size > MAX_INTERVALS:
                raise _TooMany(
                    f"the constraints' dependence on time near t = {low[0]:.9g} is too irregular to find its jumps"
                )
            middle = low + SPLIT * (high - low)
            splits = (middle > low) & (middle < high) & (high - low > self._shortest)
            jump = ~splits & self._beyond(of_high - of_low)
            found += zip(low[jump].tolist(), high[jump].tolist(), strict=True)
            low, middle, high, of_low, of_high = (x[splits] for x in (low, middle, high, of_low, of_high))
            of_middle = self._at(middle)
            bent = self._beyond(of_middle - of_low - SPLIT * (of_high - of_low))
            low, of_low = (np.concatenate([x[bent], y[bent]]) for x, y in ((low, middle), (of_low, of_middle)))
            high, of_high = (np.concatenate([x[bent], y[bent]]) for x, y in ((middle, high), (of_middle, of_high)))
        return self._merged(sorted(found))

    def declined(self, at: Vector, before: Vector, after: Vector) -> str:
        """Which jump a motion cannot be followed across, and why; "" where there is none."""
        for t, *sides in zip(at, before, after, strict=True):
            left, right = self._at(np.array(sides))
            for kind in ("g_q", "k_v", "k", "g"):
                if np.any((np.abs(right - left) > self._allowed) & (self._kinds == kind)):
                    return f"{kind} jumps at t = {t:.9g}, and only the impulse of a jump of g_t is known"
        where = f"the velocities jump at t = {at[0]:.{6 if self._by_slope else 9}g}, and "
        if self._by_slope:
            return where + (
                "differences do not resolve that: declare constraint_time_derivative and constraint_acceleration"
            )
        if not self._s.linear_reaction or self._s.reaction_uses_v:
            return where + "the declared reaction is nonlinear, or depends on velocities: its impulse is not determined"
        return ""

    def _at(self, times: Vector) -> Matrix:
        """All functions at ``times`` (k,), (k, columns); NaN where one is not finite."""
        return np.concatenate([self._of(times, *state) for state in self._states], axis=1)

    def _of(self, times: Vector, q: Vector, v: Vector) -> Matrix:
        count = self._kinds.size // len(self._states)
        if self._rows is not None:
            return self._rows(times, np.tile(q, (times.size, 1)), np.tile(v, (times.size, 1)))[:, :count]
        found = np.full((times.size, count), np.nan)
        for i, t in enumerate(times.tolist()):
            with suppress(NonFiniteValue):
                at = self._levels.at(t, q, v)
                g_t = self._slope(t, q) if self._by_slope else at.time_derivative
                parts = at.position, g_t, at.position_jacobian, at.velocity, at.velocity_jacobian
                found[i] = np.concatenate([np.ravel(part) for part in parts])
        return found

    def _slope(self, t: float, q: Vector) -> Vector:
        """The mean of g_t (m,) over a short time, from g alone."""
        ends = t - DIFFERENCES, t + DIFFERENCES
        g = [self._dynamics.constraint(at, q) for at in ends]
        return np.asarray((g[1] - g[0]) / (ends[1] - ends[0]))

    def _roundoff(self, f: Matrix) -> Vector:
        """How far the functions may be off by roundoff, (columns,)."""
        largest = {kind: float(np.nanmax(np.abs(f[:, self._kinds == kind]), initial=0.0)) for kind in set(self._kinds)}
        if self._s.m:
            largest["g_t"] += self._v_scale * largest["g_q"]
            if self._by_slope:
                largest["g_t"] += largest["g"] * np.finfo(float).eps / (DIFFERENCES * ROUNDOFF)
        return np.array([ROUNDOFF * largest[kind] for kind in self._kinds])

    def _beyond(self, change: Matrix) -> Any:
        return np.any(np.abs(change) > self._allowed, axis=1)

    def _merged(self, found: list[tuple[float, float]]) -> tuple[Vector, Vector]:
        """Jumps beside one another, as where a function has the mean of both sides at the jump, are one."""
        merged: list[list[float]] = []
        for low, high in found:
            if merged and low - merged[-1][1] <= max(NEIGHBOURS * np.spacing(abs(low)), self._shortest):
                merged[-1][1] = high
            else:
                merged.append([low, high])
        before, after = np.array(merged).reshape(-1, 2).T
        return before, after


def _shortest(*sides: float) -> float:
    """The time between both ``sides`` that takes the fewest digits: what its author has written."""
    low, high = sorted(sides)
    if high - low > NEIGHBOURS * NEIGHBOURS * np.spacing(abs(low)):
        return (low + high) / 2
    times = [low]
    while times[-1] < high:
        times.append(float(np.nextafter(times[-1], np.inf)))
    return min(times, key=lambda t: len(repr(t)))
