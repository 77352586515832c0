"""Newton's iteration for one step: one factorisation kept while it contracts, convergence judged where it counts.

The test looks at increments of q1 and v1 relative to typical sizes (H15).  Increments of a and of the multipliers do
not serve: they carry roundoff of g divided by h^2 and stop shrinking near h = 1e-4 for a pendulum of metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from solvers.hht.discretise import Layout, unpack_matrix
from solvers.hht.linear import Factor, factorise


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """Heuristic constants of the iteration."""

    tolerance: float = 1e-13  #: error left in q1, v1 over typical sizes: just above roundoff, both levels then hold to it
    stagnation: float = 1e-10  #: below it increments that stop shrinking are roundoff, above it they are failure
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


@dataclass(frozen=True)
class Iteration:
    """One step's equations for Newton."""

    functions: Functions
    layout: Layout
    packed: Vector  #: known values
    h: float  #: signed step [s]
    sizes: Vector  #: (2n,) typical sizes of q, then of v
    count: Callable[[str], None]  #: raises a counter
    options: NewtonOptions = NewtonOptions()

    def solve(self, x: Vector, factor: Factor | None) -> Outcome:
        """Iterate from ``x`` with ``factor`` as long as it contracts, with fresh ones where it does not."""
        options, last = self.options, math.inf
        fresh = False
        for _ in range(options.max_iterations):
            self.count("newton_iterations")
            if factor is None:
                factor, residual = self._factorise(x)
                if factor is None:
                    return Outcome(None, None, "nonfinite" if residual is None else "singular", x)
                fresh, last = True, math.inf
            else:
                residual = self.functions.residual(x, self.packed)
            increment = self._solve(factor, residual)
            moved = self._size(factor, increment)
            if not math.isfinite(moved):
                if fresh:
                    return Outcome(None, None, "nonfinite", x)
                factor = None
                continue
            rate = moved / last if math.isfinite(last) else 0.0  # only this step's own: the last step's may have been better
            candidate = x - increment
            if self._converged(moved, rate, last):
                return Outcome(candidate, factor, "")
            if last < math.inf and rate > (options.worst_rate if fresh else options.refresh_rate):
                if fresh and rate > options.worst_rate:
                    return Outcome(None, None, "diverged", candidate)
                factor, x = None, (candidate if rate < 1 else x)
                continue
            x, last = candidate, moved
        return Outcome(None, None, "diverged", x)

    def solve_damped(self, x: Vector) -> Outcome:
        """Newton with a fresh matrix each time and increments halved while the residual is not smaller or not finite."""
        factor, residual = self._factorise(x)
        last = math.inf
        for _ in range(self.options.max_damped):
            if factor is None:
                return Outcome(None, None, "nonfinite" if residual is None else "singular", x)
            self.count("newton_iterations")
            increment = self._solve(factor, residual)
            moved = self._size(factor, increment)
            if self._converged(moved, moved / last if math.isfinite(last) else 0.0, last):
                return Outcome(x - increment, factor, "")
            size = float(np.linalg.norm(increment))
            for halving in range(self.options.max_halvings):
                candidate = x - increment * 0.5**halving
                residual = self.functions.residual(candidate, self.packed)
                # the natural monotonicity test: independent of how the rows are scaled
                if float(np.linalg.norm(self._solve(factor, residual))) < size:
                    break
            else:
                return Outcome(None, None, "nonfinite" if not np.all(np.isfinite(residual)) else "diverged", candidate)
            x, last = candidate, moved
            factor, residual = self._factorise(x)
        return Outcome(None, None, "diverged", x)

    def _factorise(self, x: Vector) -> tuple[Factor | None, Vector | None]:
        """Matrix and residual at ``x``; (None, None) for values that are not finite, (None, residual) for a singular matrix."""
        residual, blocks = unpack_matrix(self.layout, self.functions.matrix(x, self.packed))
        if not np.all(np.isfinite(blocks)) or not np.all(np.isfinite(residual)):
            return None, None
        self.count("factorisations")
        return factorise(blocks[: x.size], blocks[x.size :], self.h), residual

    def _solve(self, factor: Factor, residual: Vector) -> Vector:
        self.count("linear_solves")
        return factor.solve(residual)

    def _size(self, factor: Factor, increment: Vector) -> float:
        """Largest change of q1 and v1 over typical sizes, (H15)."""
        return float((np.abs(factor.maps @ increment) / self.sizes).max())

    def _converged(self, moved: float, rate: float, last: float) -> bool:
        options = self.options
        left = moved * rate / (1.0 - rate) if 0.0 < rate < 1.0 else moved
        if min(left, moved) <= options.tolerance:
            return True
        return moved <= options.stagnation and last < math.inf and moved >= 0.5 * last
