"""Projection of states onto both constraint levels in the metric of the mass matrix, (H20), for any system.

Used for starts, changes by events, and rows and steps that :mod:`solvers.kernel.projection` cannot project in its loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy import linalg

from hhtbench.lowering import Dynamics, compile_function, mass_at
from hhtbench.lowering.dynamics.kkt import solve_scaled_sparse
from hhtbench.lowering.dynamics.products import large
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.printing import exact
from solvers._finite import expect_finite
from solvers._start import finite_levels, of_dynamics

DEPENDENT = 1e-13  # relative singular values of the scaled matrix below this come from dependent rows
PROJECTED = 1e-12  # scaled violation that a projected state must reach
MAX_ITERATIONS = 50  # quadratic convergence needs 5; from far away it fails in bounded time
MIN_SIZE = 1e-2  # lower bound on a coordinate's size, relative to the largest coordinate
FAR = 0.1  # displacement relative to the largest coordinate above which a projection is rejected
VISIBLE, UNMOVED = 1e-8, 1e-10  # violations above are no roundoff; relative changes of q and v below are
SMALL, STALLED = 1e-15, 1e-12  # relative increments that end the iteration; the same if they are no longer halved


class Projection:
    """Projects states of one system; its evaluations may raise :class:`~hhtbench.protocol.errors.NonFiniteValue`."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.levels = of_dynamics(dynamics).levels
        self._products = large(dynamics)
        self._mass = compile_function(mass_at, dynamics) if self._products is None else None

    def nearest(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Nearest q (n,), then nearest v (n,) at that q."""
        q = self.position(t, q, v)
        return q, self.velocity(t, q, v)

    def position(self, t: float, q: Vector, v: Vector) -> Vector:
        """Nearest q (n,) that satisfies the position constraints."""

        def level(x: Vector) -> tuple[Any, Any, Vector]:
            at = finite_levels(self.levels, t, x, v)
            return self.mass(t, x), at.position_jacobian, at.position

        return _nearest(q, level) if self.levels.structure.m else q

    def velocity(self, t: float, q: Vector, v: Vector) -> Vector:
        """Nearest v (n,) that satisfies the velocity level at ``q``."""

        def level(x: Vector) -> tuple[Any, Any, Vector]:
            at = finite_levels(self.levels, t, q, x)
            return mass, at.rows, at.velocity_drift

        mass = self.mass(t, q)
        return _nearest(v, level)

    def violated(self, t: float, q: Vector, v: Vector, sizes: Vector) -> float:
        """Largest relative violation of both constraint levels, for ``sizes`` (2n,) of q and v; may be infinite."""
        at = self.levels.at(t, q, v)
        found = np.concatenate([at.scaled_position(sizes[: q.size]), at.scaled_velocity(sizes[q.size :])])
        return float(np.max(np.where(np.isfinite(found), found, np.inf)))

    def mass(self, t: float, q: Vector) -> Any:
        """M (n, n), sparse for large systems."""
        if self._mass is None:
            products: Any = self._products
            return products.mass_at(t, q).entries()
        mass = np.asarray(self._mass(t, q))
        expect_finite("mass_matrix", mass, t)
        return mass


@dataclass(frozen=True)
class ProjectionFailure:
    """States that could not be projected and stay as they were."""

    times: tuple[float, ...] = ()  #: [s]
    worst: float = 0.0  #: largest relative constraint violation there
    late: int = 0  #: number of states skipped because the time budget ended

    def __str__(self) -> str:
        """Warning text; empty if all states were projected."""
        text = ""
        if self.times:
            text = (
                f"At {len(self.times)} rows no state near the interpolated one meets the constraints, first at "
                f"t = {exact(self.times[0])}: they are violated by up to {self.worst:.2g} of their size."
            )
        if self.late:
            text += f" The time budget ended before {self.late} rows were put onto the constraints."
        return text.strip()


def sizes_from(q: Matrix, v: Matrix) -> Vector:
    """Typical sizes (2n,) of q and v from states (k, n) of a motion, for measuring constraint violations.

    A coordinate that stays near zero gets a hundredth of the largest one, whose roundoff it carries.
    """
    largest = [np.maximum(x.max(axis=0), -x.min(axis=0)) for x in (q, v)]
    return np.concatenate([np.maximum(x, MIN_SIZE * x.max()) for x in largest])


def near(q: Matrix, moved: Matrix, sizes: Vector) -> Any:
    """True where coordinates (..., n) were moved by no more than ``FAR``; ``sizes`` (2n,) are typical of q and v."""
    return np.abs(moved - q).max(axis=-1) <= FAR * sizes[: q.shape[-1]].max()


class OneByOne:
    """Projects states of one system onto both constraint levels, one after the other."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics

    @cached_property
    def _projection(self) -> Projection:
        return Projection(self._dynamics)

    def project_all(self, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> ProjectionFailure:
        """Project all rows in place, as :meth:`project_rows`."""
        return self.project_rows(np.arange(t.size), t, q, v, sizes, lambda: True)

    def project_rows(
        self, which: Any, t: Vector, q: Matrix, v: Matrix, sizes: Vector, going: Callable[[], bool]
    ) -> ProjectionFailure:
        """Project the rows ``which`` of q and v (k, n) at ``t`` (k,) in place, while ``going()`` is true."""
        times, worst = list[float](), 0.0
        for count, i in enumerate(which.tolist()):
            late = ProjectionFailure(tuple(times), worst, which.size - count)
            if not going():
                return late
            try:
                left = self._move(float(t[i]), q[i], v[i], sizes)
            except BudgetSpent:
                return late
            if left > 0.0:
                times.append(float(t[i]))
                worst = max(worst, left)
        return ProjectionFailure(tuple(times), worst)

    def _move(self, t: float, q: Vector, v: Vector, sizes: Vector) -> float:
        """Project q and v (n,) in place; returns 0.0, or the violation where they could not be moved."""
        try:
            found = self._projection.nearest(t, q, v)
        except NonFiniteValue:  # recovery of the row's multipliers names the function
            found = q, v
        if not (near(q, found[0], sizes) and self._meets(t, *found, sizes)):
            return self._projection.violated(t, q, v, sizes)
        q[:], v[:] = found
        return 0.0

    def _meets(self, t: float, q: Vector, v: Vector, sizes: Vector) -> bool:
        """True if the remaining violation is roundoff: small, or a further projection does not move q and v."""
        left = self._projection.violated(t, q, v, sizes)
        if left <= PROJECTED or not left <= VISIBLE:
            return left <= PROJECTED
        again = self._projection.nearest(t, q, v)
        return all(np.abs(x - y).max() <= UNMOVED * np.abs(y).max() for x, y in zip(again, (q, v), strict=True))


def closest(mass: Any, rows: Any, pull: Vector, value: Vector) -> Vector:
    """The change x (n,) of a state that minimises x^T M x / 2 + pull^T x subject to ``rows x = -value``.

    ``pull`` is M times the distance from the state projected; zero to stay near the present one.  Dense rows
    may depend on one another, sparse ones not.
    """
    right = -np.concatenate([pull, value])
    if isinstance(rows, sp.csr_array):
        blocks: Any = [[mass, rows.transpose()], [rows, None]]
        solved, _ = solve_scaled_sparse(sp.block_array(blocks, format="csr"), right)
        return np.full(pull.size, np.nan) if solved is None else solved[: pull.size]
    weight = np.diag(mass)
    root = np.sqrt(np.where(weight > 0.0, weight, np.max(weight, initial=0.0) or 1.0))
    along = rows / root  # in coordinates whose masses are one
    length = np.abs(along).max(axis=1)  # squares of what is huge are not numbers
    length[length == 0.0] = 1.0
    along /= length[:, None]
    matrix = np.block([[mass / np.outer(root, root), along.T], [along, np.zeros((value.size, value.size))]])
    right = np.concatenate([right[: pull.size] / root, right[pull.size :] / length])
    solution, *_ = linalg.lstsq(matrix, right, cond=DEPENDENT, check_finite=False)
    return np.asarray(solution[: pull.size] / root)


def _nearest(start: Vector, level: Callable[[Vector], tuple[Any, Any, Vector]]) -> Vector:
    """Newton's iteration from ``start`` (n,) to the nearest root; ``level``: x -> mass, Jacobian and value."""
    x, last = start.copy(), np.inf
    for _ in range(MAX_ITERATIONS):
        mass, rows, value = level(x)
        change = closest(mass, rows, mass @ (x - start), value)
        x = x + change
        size = float(max(np.max(np.abs(x)), np.max(np.abs(start)))) or 1.0
        moved = float(np.max(np.abs(change))) / size
        if moved <= SMALL or (moved <= STALLED and moved > last / 2):
            break
        last = moved
    return x
