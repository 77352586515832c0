"""The nearest state on both levels of the constraints in the metric of the mass matrix, (H20): one by one, any system.

For starts, changes by events, and rows and steps that no loop puts there (:mod:`solvers.kernel.projection`).
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

DEPENDENT = 1e-13  # singular values below this of the scaled matrix are roundoff of dependent rows
PROJECTED = 1e-12  # scaled violation that a projected state must reach
MOST_ITERATIONS = 50  # quadratic convergence needs 5; from far away it fails in bounded time
BESIDE = 1e-2  # of the largest coordinate: by less than that no other is measured
FAR = 0.1  # of the largest coordinate: a row is off the constraints by its error; what lies further away is another place
VISIBLE, UNMOVED = 1e-8, 1e-10  # violations that are no roundoff; relative changes that are, of g with large constants
SMALL, STALLED = 1e-15, 1e-12  # increments of such a size change nothing; or nothing if they are no longer halved


class Projection:
    """Finds it for one system; what it evaluates may raise :class:`~hhtbench.protocol.errors.NonFiniteValue`."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.levels = of_dynamics(dynamics).levels
        self._products = large(dynamics)
        self._mass = compile_function(mass_at, dynamics) if self._products is None else None

    def nearest(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """q and then v, (n,) each."""
        q = self.position(t, q, v)
        return q, self.velocity(t, q, v)

    def position(self, t: float, q: Vector, v: Vector) -> Vector:
        """The nearest q (n,) at the position level."""

        def level(x: Vector) -> tuple[Any, Any, Vector]:
            at = finite_levels(self.levels, t, x, v)
            return self.mass(t, x), at.position_jacobian, at.position

        return _nearest(q, level) if self.levels.structure.m else q

    def velocity(self, t: float, q: Vector, v: Vector) -> Vector:
        """The nearest v (n,) at the velocity level of ``q``."""

        def level(x: Vector) -> tuple[Any, Any, Vector]:
            at = finite_levels(self.levels, t, q, x)
            return mass, at.rows, at.velocity_drift

        mass = self.mass(t, q)
        return _nearest(v, level)

    def violated(self, t: float, q: Vector, v: Vector, sizes: Vector) -> float:
        """The largest constraint of both levels over its row's size, for ``sizes`` (2n,) of q and v; may be infinite."""
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
    """States at which no projection has met the constraints, which stay as they were."""

    times: tuple[float, ...] = ()  #: [s]
    worst: float = 0.0  #: the largest constraint there over its row's size
    late: int = 0  #: others for which the time did not suffice

    def __str__(self) -> str:
        """What to say of it; empty where all is well."""
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
    """Typical sizes (2n,) for what constraints are measured by, from states (k, n) of a motion.

    A coordinate that stays near zero carries the roundoff of the largest beside it.
    """
    largest = [np.maximum(x.max(axis=0), -x.min(axis=0)) for x in (q, v)]
    return np.concatenate([np.maximum(x, BESIDE * x.max()) for x in largest])


def near(q: Matrix, moved: Matrix, sizes: Vector) -> Any:
    """Whether coordinates (..., n) were moved by no more than ``FAR``; ``sizes`` (2n,) are typical of q and v."""
    return np.abs(moved - q).max(axis=-1) <= FAR * sizes[: q.shape[-1]].max()


class OneByOne:
    """States of one system put onto both levels of its constraints, one after the other."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics

    @cached_property
    def _projection(self) -> Projection:
        return Projection(self._dynamics)

    def put_all(self, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> ProjectionFailure:
        """:meth:`put` of all rows."""
        return self.put(np.arange(t.size), t, q, v, sizes, lambda: True)

    def put(
        self, which: Any, t: Vector, q: Matrix, v: Matrix, sizes: Vector, going: Callable[[], bool]
    ) -> ProjectionFailure:
        """Move the rows ``which`` of q and v (k, n) at ``t`` (k,), as long as it is ``going`` on."""
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
        """0.0 after q and v (n,) were moved, or what is violated there where they stay."""
        try:
            found = self._projection.nearest(t, q, v)
        except NonFiniteValue:  # which function, is said where the row's multipliers are looked for
            found = q, v
        if not (near(q, found[0], sizes) and self._meets(t, *found, sizes)):
            return self._projection.violated(t, q, v, sizes)
        q[:], v[:] = found
        return 0.0

    def _meets(self, t: float, q: Vector, v: Vector, sizes: Vector) -> bool:
        """Whether what is violated is roundoff: of its size, or because a further projection does not move q and v."""
        left = self._projection.violated(t, q, v, sizes)
        if left <= PROJECTED or not left <= VISIBLE:
            return left <= PROJECTED
        again = self._projection.nearest(t, q, v)
        return all(np.abs(x - y).max() <= UNMOVED * np.abs(y).max() for x, y in zip(again, (q, v), strict=True))


def closest(mass: Any, rows: Any, pull: Vector, value: Vector) -> Vector:
    """The change x (n,) of a state: least x^T M x / 2 + pull^T x subject to ``rows x = -value``.

    ``pull`` is M times how far the state is from where it came, zero for the nearest to where it is now.  Dense rows
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
    """Newton's iteration from ``start`` (n,) to the nearest root of a level: x -> mass, Jacobian and value."""
    x, last = start.copy(), np.inf
    for _ in range(MOST_ITERATIONS):
        mass, rows, value = level(x)
        change = closest(mass, rows, mass @ (x - start), value)
        x = x + change
        size = float(max(np.max(np.abs(x)), np.max(np.abs(start)))) or 1.0
        moved = float(np.max(np.abs(change))) / size
        if moved <= SMALL or (moved <= STALLED and moved > last / 2):
            break
        last = moved
    return x
