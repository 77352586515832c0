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
from solvers.hht.discretise import unpack_matrix
from solvers.hht.layout import Layout
from solvers.hht.linear import Factor, factorise


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    margin: float = 0.01  #: of a predicted error: contraction is measured on the whole step, single rows are slower
    stagnation: float = 1e-10  #: below it increments that stop shrinking are roundoff, above it they are failure
    standstill: float = 1e-8  #: the same where an exact matrix does not shrink them at all: coordinates far from the origin
    other_step: float = 0.01  #: relative change of h from which a kept matrix is not used: its maps misjudge every increment
    refresh_rate: float = 0.02  #: contraction above which a new matrix costs less than the iterations it saves
    worst_rate: float = 0.9  #: contraction above which a fresh matrix has failed
    max_iterations: int = 15  #: with a kept matrix; a fresh one needs 2 to 4
    max_damped: int = 40  #: for the damped restart after a failure
    max_halvings: int = 12  #: of one damped increment: 2^-12 of a step that fails is no progress


@dataclass(frozen=True)
class Functions:
    """The compiled functions of a step, counted."""

    residual: Callable[..., Any]  #: (x, packed) -> (size,)
    matrix: Callable[..., Any]  #: (x, packed) -> residual, matrix and maps, packed


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
    exact: bool  #: no derivative in the matrix was written by a user: only roundoff keeps small increments from shrinking
    options: NewtonOptions = NewtonOptions()

    def solve(self, x: Vector, factor: Factor | None) -> Outcome:
        """Iterate from ``x`` with ``factor`` as long as it contracts, with fresh ones where it does not."""
        options, last, sizes = self.options, math.inf, None
        fresh = False
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
            rate = moved / last if math.isfinite(last) else 0.0  # only this step's own: the last step's may have been better
            slowest = max(rate, factor.rate)  # one lucky ratio is no rate: with this matrix the worst seen counts
            candidate = x - increment
            if self._converged(moved, slowest if rate else 0.0) or (fresh and self._stagnated(moved, rate)):
                return Outcome(candidate, replace(factor, rate=slowest), "")
            if last < math.inf and rate > (options.worst_rate if fresh else options.refresh_rate):
                if fresh and rate > options.worst_rate:
                    return Outcome(None, None, "diverged", candidate)
                factor, x = None, (candidate if rate < 1 else x)
                continue
            x, last = candidate, moved
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
            if self._converged(moved, rate) or self._stagnated(moved, rate) or self._stands_still(moved, rate):
                return Outcome(x - increment, factor, "")
            size = float(np.linalg.norm(increment))
            for halving in range(self.options.max_halvings):
                candidate = x - increment * 0.5**halving
                try:
                    residual = self.functions.residual(candidate, self.packed)
                except NonFiniteValue as error:  # a NumPy system's way to say what a compiled one says with NaN
                    residual, cause = np.full_like(x, np.nan), error
                # the natural monotonicity test, independent of how rows are scaled; at the end roundoff of a, lam blinds it
                if float(np.linalg.norm(self._solve(factor, residual))) < size or moved <= self.options.standstill:
                    break
            else:
                finite = bool(np.all(np.isfinite(residual)))
                return Outcome(None, None, "diverged" if finite else "nonfinite", candidate, None if finite else cause)
            x, last = candidate, moved
            factor, residual = self._factorise(x)
        return Outcome(None, None, "diverged", x)

    def _factorise(self, x: Vector) -> tuple[Factor | None, Vector]:
        """Matrix and residual at ``x``; no factor for a singular matrix, nor for values that are not finite, then NaN."""
        residual, blocks = unpack_matrix(self.layout, self.functions.matrix(x, self.packed))
        if not np.all(np.isfinite(blocks)) or not np.all(np.isfinite(residual)):
            return None, np.full_like(x, np.nan)
        self.count("factorisations")
        return factorise(blocks[: x.size], blocks[x.size :], self.h), residual

    def _solve(self, factor: Factor, residual: Vector) -> Vector:
        self.count("linear_solves")
        return factor.solve(residual)

    def _typical(self, factor: Factor, increment: Vector) -> tuple[float, float]:
        """The typical sizes, at least the first change of q1 and v1: a system starting from nothing has no other."""
        change = np.abs(factor.change(increment))
        n = self.layout.structure.n
        first = float(change[:n].max()), float(change[n:].max())
        return (max(self.sizes[0], first[0]), max(self.sizes[1], first[1])) if math.isfinite(sum(first)) else self.sizes

    def _size(self, factor: Factor, increment: Vector, sizes: tuple[float, float]) -> float:
        """Largest change of q1 and v1 over typical sizes, (H15)."""
        change = np.abs(factor.change(increment))
        n = self.layout.structure.n
        return max(float(change[:n].max()) / sizes[0], float(change[n:].max()) / sizes[1])

    def _converged(self, moved: float, rate: float) -> bool:
        """Whether the last increment, or with a margin what contraction leaves of it, is below the tolerance."""
        left = moved * rate / (1.0 - rate) if 0.0 < rate < 1.0 else moved
        return moved <= self.options.tolerance or left <= self.options.margin * self.options.tolerance

    def _stagnated(self, moved: float, rate: float) -> bool:
        """Whether what is left is roundoff: small, and not shrinking although the matrix is fresh."""
        return moved <= self.options.stagnation and rate >= 0.5

    def _stands_still(self, moved: float, rate: float) -> bool:
        """The same for increments that each come from a matrix at its own iterate: with exact ones only roundoff is left."""
        return self.exact and moved <= self.options.standstill and rate >= self.options.worst_rate
