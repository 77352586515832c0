"""Singular positions, where the constraints lose rank, (H48): detected from the rows of a run that failed."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from hhtbench.lowering import Dynamics
from hhtbench.lowering.dynamics.regular import redundant_rows
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.solution.counting import check_time
from hhtbench.solution.result import Status
from solvers._projection import Projection
from solvers._start import Failure, PhasePoint
from solvers.hht.run.engine import Engine
from solvers.kernel import memory as mem

MAY_BE_SINGULAR = (  # failures that a singular position may cause
    Status.newton_failed,
    Status.step_too_small,
    Status.singular_iteration_matrix,
    Status.time_resolution,
)
MAX_PRODUCTS = 1e8  # n^2 (m + p) up to which some forty singular value decompositions take a second or two
CLEAR = 1e-4  # least singular value relative to that elsewhere above which roundoff does not hide its decrease
LAST_ROWS = 400  # last rows of a run that are used: near the position each step is shorter by a factor
APART = 50  # every so many of these rows the singular value is compared with the last
PROBE = 1e-6  # time step of the difference of singular values, relative to |q| / |v|
BESIDE = 1e-3  # distance in time, relative to |q| / |v|, within which a position is the cause of a run's end
LOST = 0.05  # ratio of singular values below which one counts as vanished


@dataclass(frozen=True)
class AcceleratedPoint(PhasePoint):
    """A point of a motion, with its acceleration (n,)."""

    vdot: Vector

    @property
    def scale(self) -> float:
        """Time |q| / |v| [s] in which the motion crosses its own size; infinite at rest."""
        speed = float(np.abs(self.v).max())
        return float(np.abs(self.q).max()) / speed if speed > 0.0 else np.inf

    def moved(self, s: float) -> AcceleratedPoint:
        """The motion extrapolated by ``s`` [s], to second order."""
        return replace(self, t=self.t + s, q=self.q + s * self.v + s * s / 2 * self.vdot, v=self.v + s * self.vdot)


@dataclass(frozen=True)
class SingularPosition:
    """When rows of the constraints become dependent, their rank there, and which rows; for a message."""

    t: float  #: [s]
    rows: int  #: number of constraints
    rank: int
    dependent: tuple[int, ...]  #: rows of [g; k] that depend on the others there; the choice may not be unique

    @property
    def text(self) -> str:
        """Description for a message."""
        return (
            f"the constraints lose rank at t = {self.t:.10g}: a singular position, of rank {self.rank} of {self.rows} rows; "
            f"for example rows {list(self.dependent)} of [g; k] depend on the others there"
        )


class UnitRows:
    """Rows of [g_q; k_v] over the root of the mass, scaled to unit length at ``first``; singular values show their rank.

    They are not scaled elsewhere, since a single row loses rank where it vanishes.

    Raises
    ------
    LinAlgError
        The rank is undefined: a value is not finite, or a row is zero at ``first``.
    """

    def __init__(self, dynamics: Dynamics, first: PhasePoint) -> None:
        self.dynamics, self.projection = dynamics, Projection(dynamics)
        self.first, self._lengths = first, np.ones((1, 1))
        self._lengths = np.linalg.norm(self.at(first), axis=1, keepdims=True)

    def at(self, place: PhasePoint) -> Matrix:
        """The scaled rows (m + p, n) at ``place``."""
        rows = self._rows(place)
        if not (self._lengths > 0.0).all():
            raise linalg.LinAlgError("the constraints have no rank, where a row is zero")
        return np.asarray(linalg.lapack.dtrtrs(self.root(place), rows.T, lower=1)[0].T / self._lengths)

    def _rows(self, place: PhasePoint) -> Matrix:
        check_time()
        rows = dense(self.projection.levels.at(place.t, place.q, place.v).rows)
        if not np.isfinite(rows).all():
            raise linalg.LinAlgError("the constraints have no rank, where something is not finite")
        return rows

    def root(self, place: PhasePoint) -> Matrix:
        """Lower Cholesky factor (n, n) of the mass; the identity for a singular one, as rank does not depend on it."""
        mass = dense(self.projection.mass(place.t, place.q))
        if not np.isfinite(mass).all():
            raise linalg.LinAlgError("the mass is not finite")
        try:
            return np.asarray(np.linalg.cholesky(mass), dtype=np.float64)
        except linalg.LinAlgError:
            return np.eye(len(mass))

    def least(self, place: PhasePoint) -> float:
        """Least singular value at ``place``."""
        return float(np.linalg.svd(self.at(place), compute_uv=False)[-1])


def dense(matrix: Any) -> Matrix:
    """``matrix`` as a dense array."""
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())


def singular_position(
    dynamics: Dynamics, start: PhasePoint, places: list[AcceleratedPoint], reach: float
) -> SingularPosition | None:
    """The singular position that ends a run from ``start`` at the last of ``places``; None if there is none.

    ``reach`` [s]: distance within which it counts as the cause.  It is extrapolated from the last place not too close to it.
    """
    s = dynamics.structure
    if not s.constrained or s.n**2 * (s.m + s.p) > MAX_PRODUCTS:
        return None
    last = places[-1]
    try:
        rows = UnitRows(dynamics, start)
        elsewhere = max([start, *places[::APART]], key=rows.least)
        bound = CLEAR * rows.least(elsewhere)
        clear = _last(places, lambda place: rows.least(place) >= bound)
        found = last if clear is None else _vanishing(rows, clear)
        near = max(reach, BESIDE * last.scale)
        if found is None or not abs(found.t - last.t) <= near:
            return None
        return _dependent(rows, clear or elsewhere, _on_constraints(rows, found))
    except (BudgetSpent, NonFiniteValue, linalg.LinAlgError):
        return None


def _on_constraints(rows: UnitRows, place: AcceleratedPoint) -> AcceleratedPoint:
    """The nearest place on the constraints, since an extrapolated motion may leave them and lose rank elsewhere."""
    q, v = rows.projection.nearest(place.t, place.q, place.v)
    return replace(place, q=q, v=v) if np.isfinite(q).all() else place


def _last(places: list[AcceleratedPoint], is_clear: Callable[[AcceleratedPoint], bool]) -> AcceleratedPoint | None:
    """The last of ``places`` that ``is_clear``, by doubling the distance from the end and then bisection."""
    near, far = 0, 1
    while far < len(places) and not is_clear(places[-far]):
        near, far = far, 2 * far
    back = range(near + 1, min(far, len(places)) + 1)
    found = bisect_left(back, True, key=lambda k: is_clear(places[-k]))
    return places[-back[found]] if found < len(back) else None


def _vanishing(rows: UnitRows, place: AcceleratedPoint) -> AcceleratedPoint | None:
    """The place where the least singular value vanishes along the motion from ``place``, (H48), by a secant iteration."""
    start, probe = rows.least(place), PROBE * place.scale
    if not np.isfinite(probe):
        return None
    ahead, behind = rows.least(place.moved(probe)), rows.least(place.moved(-probe))
    if ahead == behind:
        return None
    away = 2 * probe * start / (behind - ahead)
    for _ in range(5):
        near, nearer = rows.least(place.moved(0.8 * away)), rows.least(place.moved(0.9 * away))
        if not near > nearer:
            return None
        away *= 0.9 + 0.1 * nearer / (near - nearer)
    found = place.moved(away)
    return found if rows.least(found) <= LOST * start else None


def _dependent(rows: UnitRows, before: PhasePoint, found: AcceleratedPoint) -> SingularPosition | None:
    """The rank lost at ``found``, from left singular vectors of values that fell since ``before``; None if none did."""
    were = linalg.svdvals(rows.at(before))
    left, sizes, _ = linalg.svd(rows.at(found))
    lost = sizes <= np.minimum(LOST * were, were[-1] / 2)
    return dependent_at(rows, found, left[:, : sizes.size][:, lost]) if lost.any() else None


def dependent_at(rows: UnitRows, found: PhasePoint, null: Matrix) -> SingularPosition:
    """The rows that depend on others at ``found``; ``null`` (m + p, d): left singular vectors of vanished values."""
    pivots = linalg.qr(null.T, mode="r", pivoting=True)[1][: null.shape[1]]
    s, out = rows.dynamics.structure, redundant_rows(rows.dynamics)
    kept = [i for i in range(s.m + s.p + len(out)) if i not in out]
    dependent = tuple(sorted(kept[int(i)] for i in pivots))
    return SingularPosition(found.t, len(kept), len(kept) - len(dependent), dependent)


def places_of(t: Matrix, q: Matrix, v: Matrix) -> list[AcceleratedPoint]:
    """Ends of steps in the rows ``t`` (k, 1), ``q`` and ``v`` (k, n) of a run, with v' by differences."""
    h = np.diff(t[:, 0])
    return [
        AcceleratedPoint(float(t[i + 1, 0]), q[i + 1], v[i + 1], (v[i + 1] - v[i]) / h[i])
        for i in np.flatnonzero(h).tolist()
    ]


def cause_of(engine: Engine, failure: Failure, places: list[AcceleratedPoint]) -> SingularPosition | Failure:
    """The singular position that caused the ``failure`` of a run through ``places``, or the failure itself."""
    if failure.status not in MAY_BE_SINGULAR or not places:
        return failure
    reach = 2 * abs(float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED]))
    return singular_position(engine.dynamics, engine.place, places, reach) or failure


OTHERS = "Several motions may follow; end before it, or choose other coordinates"


def ends_at(position: SingularPosition, why: str) -> Failure:
    """Failure of a run at a singular ``position``; ``why``: reason why no step across it is made."""
    return Failure(Status.singular_iteration_matrix, f"{position.text}. It is not stepped over: {why}. {OTHERS}.")
