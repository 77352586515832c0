"""Find the times at which the velocity of a prescribed motion jumps, and the impulse of the constraints there.

A table of positions in ``g`` has kinks: ``g_t`` jumps, and with it the velocities, by ``-M^-1 G^T p``.  The jumps are found
without a solution: ``g_t`` depends on time and coordinates, and is evaluated over time at fixed coordinates.  Intervals in
which seven of its values do not lie on a polynomial of degree five are bisected, until two neighbouring times are left: a
jump changes the sixth difference by its size at least, wherever in the interval it lies.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.checks.independent import independent
from hhtbench.lowering import (
    ConstraintLevels,
    Dynamics,
    derive,
)
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System

SAMPLES = 400  # equal parts of the interval that are searched; a motion that jumps and returns within a sixth is not seen
SMALLEST_JUMP, BY_DIFFERENCES = 1e-9, 1e-6  # smaller jumps, over the largest value of the same row, are not searched for
#: where functions are evaluated in an interval; of even or symmetric places a jump with the mean of both sides may be missed
PLACES = np.array([0.0, 0.18, 0.3, 0.45, 0.66, 0.85, 1.0])
_WEIGHTS = 1.0 / np.prod(PLACES[:, None] - PLACES + np.eye(7), axis=1)
SIXTH_DIFFERENCE = _WEIGHTS / np.abs(np.cumsum(_WEIGHTS)[:-1]).min()  # a jump changes it by its size or more
MAX_EVALUATIONS = 4_000_000, 40_000  # of one search, by machine code and in Python: a function that needs more is no table
MAX_NUMBERS = 2_000_000  # that are held at once
DIFFERENCES = 1e-7  # s: half the length over which g_t of plain callables is the mean slope of g
NEIGHBOURS = 8  # spacings of floating-point times within which two jumps are one
BESIDE = 0.1  # distance from the start, over the scales, at which functions are compared too: at the start terms may vanish
ROUNDOFF = 1e-12  # roundoff over the largest value of the same kind

_known = Cache(16)


@dataclass(frozen=True)
class Jumps:
    """Jumps of a problem's prescribed velocities, in the order in which the motion reaches them."""

    times: Vector  #: (k,) [s]
    before: Vector  #: (k,) the last times at which the functions are those before the jumps [s]
    after: Vector  #: (k,) the first times at which they are those behind them [s]
    declined: str = ""  #: which jump makes the motion undetermined, or cannot be resolved, at what time; "" where none does
    _dynamics: Dynamics | None = None

    def between(self, start: float, end: float) -> list[int]:
        """Return the indices of the jumps that a motion from ``start`` [s] to ``end`` [s] crosses."""
        sign = 1.0 if end > start else -1.0
        inside = (sign * self.before >= sign * start) & (sign * self.after <= sign * end)
        return [int(i) for i in np.flatnonzero(inside)]

    def towards(self, direction: float) -> Jumps:
        """Return these jumps ordered for a motion in that ``direction`` of time."""
        if not self.times.size or (self.after[0] > self.before[0]) == (direction > 0.0):
            return self
        return replace(self, times=self.times[::-1], before=self.after[::-1], after=self.before[::-1])

    def near(self, t: Any, distance: float) -> Any:
        """Mark those of the times ``t`` (k,) that are within ``distance`` [s] of a jump."""
        return np.any(np.abs(np.asarray(t)[:, None] - self.times) <= distance, axis=1)

    def beside(self, t: Vector, q: Matrix, v: Matrix, distance: float) -> Vector:
        """Move the times ``t`` (k,) within ``distance`` [s] of a jump to the side of it on which ``v`` (k, n) fits."""
        t = np.array(t)
        for k in np.flatnonzero(self.near(t, distance)):
            i = int(np.argmin(np.abs(self.times - t[k])))
            sides = [float(x[i]) for x in (self.before, self.after)]
            t[k] = min(sides, key=lambda side: float(np.abs(self._levels.at(side, q[k], v[k]).velocity_drift).max()))
        return t

    @property
    def _driven(self) -> Dynamics:
        assert self._dynamics is not None  # noqa: S101 - there are jumps, so constraints depend on time
        return self._dynamics

    @property
    def _levels(self) -> ConstraintLevels:
        return ConstraintLevels(self._driven, full=True)

    def velocities(self, i: int, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Return the velocities (n,) after jump ``i`` of a motion with ``q, v`` (n,) before it, and the impulse p (m + p,).

        ``M (v_after - v) = -G^T p`` and ``G (v_after - v) = -(g_t after - g_t before)``; a declared linear reaction
        replaces ``-G^T p``, and velocity constraints hold on both sides.  Impulses of redundant rows are zero.

        Raises
        ------
        ValueError
            The mass and the constraints determine no impulse at q.
        """
        levels, dynamics = self._levels, self._driven
        s = dynamics.structure
        before, after = (float(x[i]) for x in (self.before, self.after))
        g_t = [levels.at(t, q, v).time_derivative for t in (before, after)]
        reduced, redundant = independent(dynamics, after, q, v)
        kept = np.setdiff1d(np.arange(s.m + s.p), redundant)
        if reduced is None:
            raise ValueError("constraints are redundant, and a declared reaction may depend on every multiplier")
        change = np.concatenate([g_t[1] - g_t[0], np.zeros(s.p)])[kept]
        _, matrix = AccelerationLevel(reduced, full=True).terms(after, q, v, np.zeros(s.n + kept.size))
        try:
            found = np.linalg.solve(matrix, np.concatenate([np.zeros(s.n), -change]))
        except np.linalg.LinAlgError as error:
            raise ValueError(f"the KKT matrix is singular at the jump at t = {exact(self.times[i])}") from error
        impulse = np.zeros(s.m + s.p)
        impulse[kept] = found[s.n :]
        return v + found[: s.n], impulse


NONE = Jumps(np.zeros(0), np.zeros(0), np.zeros(0))


def find_jumps(problem: Problem) -> Jumps:
    """Return the times within the interval of ``problem`` at which its prescribed velocities jump."""
    if not isinstance(problem.system, System):  # what plain callables refer to may have changed
        return _search(problem)
    arrays = problem.q0, problem.v0, *(np.asarray(x, dtype=np.float64) for x in (problem.scales.q, problem.scales.v))
    key = by_id(problem.system), problem.t_span, *(x.tobytes() for x in arrays)
    found: Jumps = _known.find(key, lambda: _search(problem))
    return found


def _search(problem: Problem) -> Jumps:
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    s = dynamics.structure
    if not ((s.m and s.rheonomic) or s.p):
        return NONE
    search = _Search(dynamics, problem)
    try:
        before, after = search.jumps(np.linspace(min(problem.t_span), max(problem.t_span), SAMPLES + 1))
    except _TooMany as error:
        return Jumps(np.zeros(0), np.zeros(0), np.zeros(0), str(error), dynamics)
    if problem.t_span[1] < problem.t_span[0]:
        before, after = after[::-1], before[::-1]
    at = np.array([_shortest(*pair) for pair in zip(before, after, strict=True)])
    return Jumps(at, before, after, search.declined(at, before, after) if at.size else "", dynamics)


class _TooMany(Exception):
    """The constraints depend too irregularly on time; the text says where."""


class _Search:
    """Search for jumps of g, g_t, g_q, k and k_v as functions of time at fixed states."""

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
        self._found: list[tuple[float, float]] = []
        self._left = MAX_EVALUATIONS[self._rows is None]
        start = problem.q0, problem.v0
        self._states = [start, tuple(x + BESIDE * other for x, other in zip(start, beside, strict=True))]
        kinds = {"g": s.m, "g_t": s.m, "g_q": s.m * s.n, "k": s.p, "k_v": s.p * s.n}
        self._kinds = np.tile(np.repeat(list(kinds), list(kinds.values())), len(self._states))  #: kind of every column
        self._v_scale = float(np.max(problem.scales.v))

    def jumps(self, times: Vector) -> tuple[Vector, Vector]:
        """Return neighbouring times (k,) before and after every jump within the rising ``times``."""
        f = self._at(times)
        smallest = BY_DIFFERENCES if self._by_slope else SMALLEST_JUMP
        self._allowed = self._roundoff(f) + smallest * np.max(np.abs(f), axis=0, initial=0.0, where=np.isfinite(f))
        at_once = max(MAX_NUMBERS // (7 * f.shape[1]), 1)
        waiting: list[tuple[Any, ...]] = [(times[:-1], times[1:], f[:-1], f[1:])]
        while waiting:  # depth first
            part = tuple(x[:at_once] for x in waiting[-1])
            rest = tuple(x[at_once:] for x in waiting.pop())
            waiting += [rest] if rest[0].size else []
            low, high, of_low, of_high = part
            short = high - low <= np.maximum(self._shortest, NEIGHBOURS * NEIGHBOURS * np.spacing(np.abs(low)))
            changes = short & self._beyond(of_high - of_low)
            waiting += self._halved(*(x[changes] for x in part)) if changes.any() else []
            waiting += self._split(*(x[~short] for x in part)) if not short.all() else []
        return self._merged(sorted(self._found))

    def _split(self, low: Vector, high: Vector, of_low: Matrix, of_high: Matrix) -> list[tuple[Any, ...]]:
        """Split intervals in which a function is no polynomial of degree five: in three around a kink of g, else in two."""
        inside = low[:, None] + PLACES[1:-1] * (high - low)[:, None]
        values = self._at(inside.ravel()).reshape(*inside.shape, -1)
        values = np.concatenate([of_low[:, None], values, of_high[:, None]], axis=1)
        bent = self._beyond(np.einsum("i,kij->kj", SIXTH_DIFFERENCE, values))
        if not bent.any():
            return []
        low, high, of_low, of_high = (x[bent] for x in (low, high, of_low, of_high))
        middle, of_middle = inside[bent, 2], values[bent, 3]
        sides = self._kinks(low, high, of_low, of_high)
        of_sides = [self._at(side) for side in sides]
        kink = (low < sides[0]) & (sides[0] < sides[1]) & (sides[1] < high) & self._beyond(of_sides[1] - of_sides[0])
        first, of_first = np.where(kink, sides[0], middle), np.where(kink[:, None], of_sides[0], of_middle)
        last, of_last = np.where(kink, sides[1], middle), np.where(kink[:, None], of_sides[1], of_middle)
        return [
            (last, high, of_last, of_high),
            *([(first[kink], last[kink], of_first[kink], of_last[kink])] if kink.any() else []),
            (low, first, of_low, of_first),
        ]

    def _kinks(self, low: Vector, high: Vector, of_low: Matrix, of_high: Matrix) -> tuple[Vector, Vector]:
        """Times just before and after those at which tangents of g meet, of the row whose slope changes most."""
        slopes, m = np.flatnonzero(self._kinds == "g_t"), self._s.m
        if not slopes.size:
            return low, low
        change = (of_high - of_low)[:, slopes]
        most = np.argmax(np.abs(change) / self._allowed[slopes], axis=1)
        row, each = slopes[most], np.arange(low.size)
        with np.errstate(divide="ignore", invalid="ignore"):
            g = of_low[each, row - m], of_high[each, row - m]
            at = low + (of_high[each, row] * (high - low) - (g[1] - g[0])) / change[each, most]
            blur = 4.0 * np.finfo(float).eps * np.maximum(*np.abs(g)) / np.abs(change[each, most])
        at = np.where(np.isfinite(at), np.clip(at, low, high), low)
        beside = np.maximum(NEIGHBOURS * np.spacing(np.abs(at)), np.where(np.isfinite(blur), blur, 0.0))
        beside = np.maximum(beside, self._shortest)
        return np.maximum(at - beside, low), np.minimum(at + beside, high)

    def _halved(self, low: Vector, high: Vector, of_low: Matrix, of_high: Matrix) -> list[tuple[Any, ...]]:
        """Halve intervals too short for seven values in which a function changes; those that cannot be halved are jumps."""
        middle = low + 0.5 * (high - low)
        splits = (low < middle) & (middle < high) & (high - low > self._shortest)
        self._found += zip(low[~splits].tolist(), high[~splits].tolist(), strict=True)
        low, middle, high, of_low, of_high = (x[splits] for x in (low, middle, high, of_low, of_high))
        of_middle = self._at(middle)
        return [(middle, high, of_middle, of_high), (low, middle, of_low, of_middle)] if low.size else []

    def declined(self, at: Vector, before: Vector, after: Vector) -> str:
        """Return why the motion across one of the jumps is not determined or not resolved, or "".

        Takes the times (k,) [s] of the jumps, and the last before and the first after each; k > 0. Only a jump of g_t, with
        a reaction that is linear in lam and free of v, determines the motion after it.
        """
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
        """Evaluate all functions at ``times`` (k,), (k, columns); NaN where one is not finite."""
        self._left -= times.size
        if self._left < 0:
            raise _TooMany(f"the constraints depend too irregularly on time near t = {times[0]:.9g} to find their jumps")
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
        """Return the mean of g_t (m,) over a short time by a difference of g."""
        ends = t - DIFFERENCES, t + DIFFERENCES
        g = [self._dynamics.constraint(at, q) for at in ends]
        return np.asarray((g[1] - g[0]) / (ends[1] - ends[0]))

    def _roundoff(self, f: Matrix) -> Vector:
        """Return the roundoff errors of the functions, (columns,)."""
        largest = {kind: float(np.nanmax(np.abs(f[:, self._kinds == kind]), initial=0.0)) for kind in set(self._kinds)}
        if self._s.m:
            largest["g_t"] += self._v_scale * largest["g_q"]
            if self._by_slope:
                blur = np.abs(SIXTH_DIFFERENCE).sum() * np.finfo(float).eps
                largest["g_t"] += largest["g"] * blur / (DIFFERENCES * ROUNDOFF)
        return np.array([ROUNDOFF * largest[kind] for kind in self._kinds])

    def _beyond(self, change: Matrix) -> Any:
        """Mark the rows of ``change`` with an entry above roundoff; entries that are not finite count as none."""
        return np.any(np.abs(change) > self._allowed, axis=1)

    def _merged(self, found: list[tuple[float, float]]) -> tuple[Vector, Vector]:
        """Merge neighbouring jumps into one, as at a jump where the function has the mean of both sides."""
        merged: list[list[float]] = []
        for low, high in found:
            if merged and low - merged[-1][1] <= max(NEIGHBOURS * np.spacing(abs(low)), self._shortest):
                merged[-1][1] = high
            else:
                merged.append([low, high])
        before, after = np.array(merged).reshape(-1, 2).T
        return before, after


def _shortest(*sides: float) -> float:
    """Return the time between both ``sides`` with the fewest digits, as its author probably wrote it."""
    low, high = sorted(sides)
    if high - low > NEIGHBOURS * NEIGHBOURS * np.spacing(abs(low)):
        return (low + high) / 2
    times = [low]
    while times[-1] < high:
        times.append(float(np.nextafter(times[-1], np.inf)))
    return min(times, key=lambda t: len(repr(t)))
