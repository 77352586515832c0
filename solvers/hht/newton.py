"""Newton's iteration for one step: one factorisation kept while it contracts, convergence judged where it counts.

The test looks at increments of q1 and v1 relative to typical sizes (H15).  Increments of a and of the multipliers do
not serve: they carry roundoff of g divided by h^2 and stop shrinking near h = 1e-4 for a pendulum of metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.errors import NonFiniteValue
from solvers.hht.laws import NOTHING
from solvers.hht.layout import Layout
from solvers.hht.linear import Analysis, Factor


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    margin: float = 0.01  #: of a predicted error: contraction is measured on the whole step, single rows are slower
    stagnation: float = 1e-10  #: below it increments that stop shrinking are roundoff, above it that is measured, (H30)
    stalled: float = 0.5  #: contraction of a matrix at the very iterate from which it counts as none
    blinded: float = 1e-8  #: increments up to it are not halved: roundoff of a and lam hides whether the next is smaller
    second: float = 0.5  #: what of an increment is left two later at most, (H29)
    other_step: float = 0.01  #: relative change of h from which a kept matrix is not used: its maps misjudge every increment
    refresh_rate: float = 0.02  #: contraction above which a new matrix costs less than the iterations it saves
    worst_rate: float = 0.9  #: contraction above which a fresh matrix has failed
    noise_margin: float = 4.0  #: times the measured roundoff: several sums take part, increments above it still shrink
    matrix_cost: float = 0.0  #: of a new matrix, in iterations; 0: judged by ``refresh_rate``
    least_rate: float = 1e-3  #: a first increment far too long makes the next look like contraction: no ratio counts as less
    max_iterations: int = 15  #: with a kept matrix; a fresh one needs 2 to 4
    max_damped: int = 40  #: for the damped restart after a failure
    max_halvings: int = 12  #: of one damped increment: 2^-12 of a step that fails is no progress


@dataclass(frozen=True)
class Functions:
    """The compiled functions of a step, counted."""

    residual: Callable[..., Any]  #: (x, packed) -> (size,)
    matrix: Callable[..., Any]  #: (x, packed) -> residual (size,), then the entries of matrix and maps, packed
    linear: Analysis  #: takes the entries
    disturb: Callable[[Vector], Vector] | None = (
        None  #: packed -> the same moved by one roundoff; None: noise is not measured
    )


@dataclass(frozen=True)
class Outcome:
    """How an iteration ended."""

    x: Vector | None  #: (size,) the solution, or None
    factor: Factor | None  #: the factorisation to keep
    failure: str  #: "" | "diverged" | "nonfinite" | "singular"
    at: Vector | None = None  #: (size,) where it failed
    cause: NonFiniteValue | None = None  #: the value that was not finite, where a callback told of it


@dataclass(frozen=True)
class Iteration:
    """One step's equations for Newton."""

    functions: Functions
    layout: Layout
    packed: Vector  #: known values
    h: float  #: signed step [s]
    sizes: tuple[float, float]  #: typical sizes of q and of v
    count: Callable[[str], None]  #: raises a counter
    options: NewtonOptions = NewtonOptions()

    def solve(self, x: Vector, factor: Factor | None) -> Outcome:
        """Iterate from ``x`` with ``factor`` as long as it contracts, with fresh ones where it does not."""
        options, last, sizes, first, taken = self.options, math.inf, None, 0.0, 0
        fresh = stood = False
        before = math.inf  # the last increment of a matrix that stood still
        if factor is not None and abs(factor.h - self.h) > options.other_step * abs(self.h):
            factor = None
        for _ in range(options.max_iterations):
            self.count("newton_iterations")
            if factor is None:
                factor, residual = self._factorise(x)
                if factor is None:
                    return Outcome(None, None, "singular" if np.isfinite(residual).all() else "nonfinite", x)
                fresh, last = True, math.inf
            else:
                residual = self.functions.residual(x, self.packed)
            increment = self._solve(factor, residual)
            sizes = sizes or self._typical(factor, increment)
            moved = self._size(factor, increment, sizes)
            if not math.isfinite(moved):
                if fresh:
                    return Outcome(None, None, "nonfinite", x)
                factor = sizes = None
                continue
            last, before = min(last, before), math.inf
            rate = moved / last if math.isfinite(last) else 0.0  # only this step's own: the last step's may have been better
            slowest = max(rate, factor.rate, options.least_rate)  # one lucky ratio is no rate: the worst seen counts
            candidate = x - increment
            enough = self._enough(factor, sizes)
            if self._converged(moved, slowest if rate else 0.0, enough):
                return Outcome(candidate, replace(factor, rate=slowest), "")
            if fresh and rate >= options.stalled and self._is_roundoff(x, increment, factor, sizes):
                if stood:  # with a matrix at the very iterate too: roundoff is left
                    return Outcome(candidate, replace(factor, rate=slowest), "")
                stood, factor, x, before = True, None, candidate, moved
                continue
            first, taken = (first, taken + 1) if last < math.inf else (moved, 0)
            mean = (moved / first) ** (1.0 / taken) if taken else 0.0  # single ratios alternate
            if taken and (rate > options.worst_rate if fresh else self._outworn(moved, rate, mean, enough)):
                if fresh:
                    return Outcome(None, None, "diverged", candidate)
                factor, x = None, (candidate if rate < 1 else x)
                continue
            x, last = candidate, moved
        return Outcome(None, None, "diverged", x)

    def solve_whole(self, x: Vector) -> Outcome:
        """Newton with a fresh matrix each time and whole increments, as long as every second one is half as long, (H29)."""
        last, before, sizes = math.inf, math.inf, None
        for _ in range(self.options.max_iterations):
            factor, residual = self._factorise(x)
            if factor is None:
                return Outcome(None, None, "singular" if np.isfinite(residual).all() else "nonfinite", x)
            self.count("newton_iterations")
            increment = self._solve(factor, residual)
            sizes = sizes or self._typical(factor, increment)
            moved = self._size(factor, increment, sizes)
            if self._is_last(x, increment, factor, sizes, moved / last):
                return Outcome(x - increment, factor, "")
            if not moved <= self.options.second * before:
                break
            x, last, before = x - increment, moved, last
        return Outcome(None, None, "diverged", x)

    def solve_damped(self, x: Vector) -> Outcome:
        """Newton with a fresh matrix each time and increments halved while the residual is not smaller or not finite."""
        cause = None
        factor, residual = self._factorise(x)
        last, sizes, halving = math.inf, None, 0
        for _ in range(self.options.max_damped):
            if factor is None:
                return Outcome(None, None, "singular" if np.isfinite(residual).all() else "nonfinite", x)
            self.count("newton_iterations")
            increment = self._solve(factor, residual)
            sizes = sizes or self._typical(factor, increment)
            moved = self._size(factor, increment, sizes)
            rate = moved / last if math.isfinite(last) and not halving else 0.0  # a halved increment tells no rate
            if self._is_last(x, increment, factor, sizes, rate):
                return Outcome(x - increment, factor, "")
            size = float(np.linalg.norm(increment))
            for halving in range(self.options.max_halvings):
                candidate = x - increment * 0.5**halving
                try:
                    residual = self.functions.residual(candidate, self.packed)
                except NonFiniteValue as error:  # a NumPy system's way to say what a compiled one says with NaN
                    residual, cause = np.full_like(x, np.nan), error
                # the natural monotonicity test, independent of how rows are scaled; at the end roundoff of a, lam blinds it
                if float(np.linalg.norm(self._solve(factor, residual))) < size or moved <= self.options.blinded:
                    break
            else:
                finite = bool(np.all(np.isfinite(residual)))
                return Outcome(None, None, "diverged" if finite else "nonfinite", candidate, None if finite else cause)
            x, last = candidate, moved
            factor, residual = self._factorise(x)
        return Outcome(None, None, "diverged", x)

    def _factorise(self, x: Vector) -> tuple[Factor | None, Vector]:
        """Matrix and residual at ``x``; no factor for a singular matrix, nor for values that are not finite, then NaN."""
        residual, entries = np.split(self.functions.matrix(x, self.packed), [x.size])
        if not np.all(np.isfinite(entries)) or not np.all(np.isfinite(residual)):
            return None, np.full_like(x, np.nan)
        self.count("factorisations")
        factor = self.functions.linear.factor(entries, self.h)
        return factor if factor is None else self._with_noise(factor, x, residual), residual

    def _with_noise(self, factor: Factor, x: Vector, residual: Vector) -> Factor:
        """``factor`` with what one roundoff of the known values does to q1 and v1, where that is measured."""
        if self.functions.disturb is None:
            return factor
        shift = self.functions.residual(x, self.functions.disturb(self.packed)) - residual
        return replace(factor, noise=factor.largest(self._solve(factor, shift), self.layout.structure.n))

    def _enough(self, factor: Factor, sizes: tuple[float, float]) -> float:
        """Increments, over typical sizes, that need not shrink further: the tolerance, or roundoff where it is larger."""
        noise = max(factor.noise[0] / sizes[0], factor.noise[1] / sizes[1])
        return max(self.options.tolerance, self.options.noise_margin * noise)

    def _outworn(self, moved: float, rate: float, mean: float, enough: float) -> bool:
        """Whether a new matrix costs less than the iterations that the kept one still takes, told by its mean rate."""
        if not self.options.matrix_cost:
            return rate > self.options.refresh_rate and moved * rate > self.options.margin * enough  # else one more ends it
        return rate >= 1.0 or math.log(enough / moved) < self.options.matrix_cost * math.log(mean)

    def _solve(self, factor: Factor, residual: Vector) -> Vector:
        self.count("linear_solves")
        return factor.solve(residual)

    def _typical(self, factor: Factor, increment: Vector) -> tuple[float, float]:
        """The typical sizes; for a system that starts from nothing, the first change of q1 and v1."""
        first = factor.largest(increment, self.layout.structure.n)
        if not math.isfinite(sum(first)):
            return self.sizes
        q, v = (size if size > NOTHING else max(size, change) for size, change in zip(self.sizes, first, strict=True))
        return q, v

    def _size(self, factor: Factor, increment: Vector, sizes: tuple[float, float]) -> float:
        """Largest change of q1 and v1 over typical sizes, (H15)."""
        q_change, v_change = factor.largest(increment, self.layout.structure.n)
        return max(q_change / sizes[0], v_change / sizes[1])

    def _converged(self, moved: float, rate: float, enough: float) -> bool:
        """Whether the last increment, or with a margin what contraction leaves of it, is at most ``enough``."""
        left = moved * rate / (1.0 - rate) if 0.0 < rate < 1.0 else moved
        return moved <= enough or left <= self.options.margin * enough

    def _is_last(self, x: Vector, increment: Vector, factor: Factor, sizes: tuple[float, float], rate: float) -> bool:
        """Whether ``increment``, by a matrix at ``x`` and ``rate`` times the last one (0: the first), ends the iteration."""
        slowest = max(rate, self.options.least_rate) if rate else 0.0
        if self._converged(self._size(factor, increment, sizes), slowest, self._enough(factor, sizes)):
            return True
        return rate >= self.options.stalled and self._is_roundoff(x, increment, factor, sizes)

    def _is_roundoff(self, x: Vector, increment: Vector, factor: Factor, sizes: tuple[float, float]) -> bool:
        """Whether an increment at ``x`` that a fresh matrix did not shrink is of the size that roundoff makes it, (H30)."""
        moved = self._size(factor, increment, sizes)
        if moved <= self.options.stagnation:
            return True
        disturbed = (self.functions.residual(x, packed) for packed in self.layout.disturbances(self.packed))
        noise = max(self._size(factor, self._solve(factor, residual) - increment, sizes) for residual in disturbed)
        return moved <= self.options.noise_margin * noise
