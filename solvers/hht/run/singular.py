"""Singular positions, where the constraints lose rank, (H48): found from the rows of a run that fails there, and told."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg
from scipy.optimize import minimize_scalar

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import check_time
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import Dynamics
from hhtbench.lowering.dynamics.regular import redundant_rows
from hhtbench.result import Status
from solvers._projection import Projection
from solvers._start import Failure
from solvers._start import Place as Start
from solvers.hht.equations.formulas import EPS
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine

MAY_BE_SINGULAR = (  # ends that may have a singular position for their cause
    Status.newton_failed,
    Status.step_too_small,
    Status.singular_iteration_matrix,
    Status.time_resolution,
)
LOOK, PER_PRODUCT = 2e-4, 1e-9  # [s] of a look at singular values, and of each of its n^2 (m + p) products, about
LONGEST = 0.1  # [s] of a look at which a failure is told within seconds: it takes some forty, and a step across more
CLEAR = 1e-4  # of the least singular value elsewhere: from there on its fall is seen beside roundoff
LAST_ROWS = 400  # rows of a run, at most: near the position steps shrink by a factor each
APART = 50  # of those rows: where they are looked at, with the start, for what a singular value is elsewhere
PROBE = 1e-6  # of the time in which the motion crosses its own size: there the fall of a singular value is looked at
BESIDE = 1e-3  # of that time: a position so close to a run's end is the cause of it
FALL = 8.0  # of a singular value between two of three places that tell how it goes on
LOST = 0.05  # of a singular value, at most, that is left where it vanishes: all of it but errors of the way there


@dataclass(frozen=True)
class Place(Start):
    """A point of a motion, with its acceleration (n,)."""

    vdot: Vector

    @property
    def scale(self) -> float:
        """[s] in which the motion crosses its own size; infinite at rest."""
        speed = float(np.abs(self.v).max())
        return float(np.abs(self.q).max()) / speed if speed > 0.0 else np.inf

    def moved(self, s: float) -> Place:
        """Where the motion is ``s`` [s] later, to second order."""
        return replace(self, t=self.t + s, q=self.q + s * self.v + s * s / 2 * self.vdot, v=self.v + s * self.vdot)


@dataclass(frozen=True)
class SingularPosition:
    """Where rows of the constraints become dependent."""

    t: float  #: [s]
    rows: int  #: of the constraints
    rank: int
    dependent: tuple[int, ...]  #: as many rows of [g; k] that depend on the others there; other choices may be as good
    by_mass: bool = False  #: nearly, and over the root of the mass alone: some body is so light

    @property
    def text(self) -> str:
        """In words."""
        if self.by_mass:
            return (
                f"Near t = {self.t:.10g} the constraints keep their rank, but over the root of the mass rows "
                f"{list(self.dependent)} of [g; k] nearly depend on the others: a body that they hold is so light beside "
                "others that reactions throw it about far faster than these move; give it more mass, or leave it out."
            )
        return (
            f"the constraints lose rank at t = {self.t:.10g}: a singular position, of rank {self.rank} of {self.rows} rows; "
            f"for example rows {list(self.dependent)} of [g; k] depend on the others there"
        )


class UnitRows:
    """The rows of [g_q; k_v] over the root of the mass, of length one at ``first``: what their rank is told by.

    Not everywhere: of a single row the rank is lost where it vanishes.

    Raises
    ------
    LinAlgError
        There is no rank: something is not finite, or a row is zero at ``first``.
    """

    def __init__(self, dynamics: Dynamics, first: Start) -> None:
        self.dynamics, self.projection = dynamics, Projection(dynamics)
        self.first, self._lengths = first, np.ones((1, 1))
        self._lengths = np.linalg.norm(self.at(first), axis=1, keepdims=True)

    def at(self, place: Start) -> Matrix:
        """(m + p, n) there."""
        rows = self._rows(place)
        if not (self._lengths > 0.0).all():
            raise linalg.LinAlgError("the constraints have no rank, where a row is zero")
        return np.asarray(linalg.lapack.dtrtrs(self.root(place), rows.T, lower=1)[0].T / self._lengths)

    def without_mass(self, place: Start) -> Matrix:
        """(m + p, n) there, not over the root of the mass."""
        return np.asarray(self._rows(place) / np.linalg.norm(self._rows(self.first), axis=1, keepdims=True))

    def asked(self, place: Start) -> Vector:
        """The velocity level (m + p,) there, in the same units, of what is at rest: what v must differ from zero for."""
        at = self.projection.levels.at(place.t, place.q, np.zeros_like(place.v))
        return np.asarray(at.velocity_drift / self._lengths[:, 0])

    def _rows(self, place: Start) -> Matrix:
        check_time()
        rows = dense(self.projection.levels.at(place.t, place.q, place.v).rows)
        if not np.isfinite(rows).all():
            raise linalg.LinAlgError("the constraints have no rank, where something is not finite")
        return rows

    def root(self, place: Start) -> Matrix:
        """(n, n) of the mass, lower triangular; the identity for a singular one: rows tell as well in other units."""
        mass = dense(self.projection.mass(place.t, place.q))
        if not np.isfinite(mass).all():
            raise linalg.LinAlgError("the mass is not finite")
        try:
            return np.asarray(np.linalg.cholesky(mass), dtype=np.float64)
        except linalg.LinAlgError:
            return np.eye(len(mass))

    def least(self, place: Start) -> float:
        """The least singular value there."""
        return float(np.linalg.svd(self.at(place), compute_uv=False)[-1])


def seconds_of_look(dynamics: Dynamics) -> float:
    """What it takes to find the singular values at a place [s], about."""
    s = dynamics.structure
    return LOOK + PER_PRODUCT * s.n**2 * (s.m + s.p)


def dense(matrix: Any) -> Matrix:
    """As an array."""
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())


def singular_position(dynamics: Dynamics, start: Start, places: list[Place], reach: float) -> SingularPosition | None:
    """What ends a run from ``start`` at the last of ``places`` if that is a singular position; None if not.

    ``reach`` [s] is what it may be away, at least.  The place is found from the last one that is not too close to it.
    """
    if not dynamics.structure.constrained or seconds_of_look(dynamics) > LONGEST:
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
            lost = rows.least(last) ** 3 < EPS * rows.least(elsewhere) ** 3  # (H51)
            if not (lost and _to_zero(rows, places) <= near):
                return _by_mass(rows, elsewhere, last, reach)
            found = last
        return _told(rows, clear or elsewhere, found)
    except (BudgetSpent, NonFiniteValue, linalg.LinAlgError):
        return None


def _by_mass(rows: UnitRows, before: Start, last: Place, reach: float) -> SingularPosition | None:
    """What mass alone makes nearly dependent within ``reach`` [s] beyond ``last``, where nothing vanishes; or None."""
    ahead = reach if last.t >= before.t else -reach
    share = minimize_scalar(lambda x: rows.least(last.moved(x * ahead)), bounds=(0.0, 1.0), method="bounded").x
    found = _told(rows, before, last.moved(share * ahead))
    return found if found is not None and found.by_mass else None


def _last(places: list[Place], is_clear: Callable[[Place], bool]) -> Place | None:
    """The last of ``places`` that ``is_clear``, looked for twice as far from the end each time, then between."""
    near, far = 0, 1
    while far < len(places) and not is_clear(places[-far]):
        near, far = far, 2 * far
    back = range(near + 1, min(far, len(places)) + 1)
    found = bisect_left(back, True, key=lambda k: is_clear(places[-k]))
    return places[-back[found]] if found < len(back) else None


def _vanishing(rows: UnitRows, place: Place) -> Place | None:
    """Where the least singular value vanishes along the motion from ``place``, (H48): by secants from this side of it."""
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


def _to_zero(rows: UnitRows, places: list[Place]) -> float:
    """[s] from the last of ``places`` on to where the least singular value vanishes, if it falls as a power; else infinite.

    From where it was ``FALL`` and ``FALL**2`` times as large: it over its slope is linear there, and vanishes with it.
    """
    size, end = rows.least(places[-1]), places[-1].t
    far = _last(places, lambda place: rows.least(place) >= FALL**2 * size)
    near = _last(places, lambda place: rows.least(place) >= FALL * size)
    if far is None or near is None or far is near:
        return np.inf
    lengths = abs(far.t - near.t), abs(near.t - end)
    fallen = np.log([rows.least(far) / rows.least(near), rows.least(near) / size])
    (before, after), apart = lengths / fallen, sum(lengths) / 2
    return float(after / (before - after) * apart - lengths[1] / 2) if before > after else np.inf


def _told(rows: UnitRows, before: Start, found: Place) -> SingularPosition | None:
    """What is lost at ``found``, by the left singular vectors there: what has fallen since ``before``; None if nothing.

    What no row loses without the mass is not lost: between two rows may be a body so light that they are nearly one.
    """
    were = linalg.svdvals(rows.at(before))
    left, sizes, _ = linalg.svd(rows.at(found))
    lost = _fallen(were, sizes)
    if not lost.any():
        return None
    position = dependent_at(rows, found, left[:, : sizes.size][:, lost])
    kept = not _fallen(*(linalg.svdvals(rows.without_mass(place)) for place in (before, found))).any()
    return replace(position, by_mass=kept)


def _fallen(were: Vector, sizes: Vector) -> Any:
    """Which of some singular values have."""
    return sizes <= np.minimum(LOST * were, were[-1] / 2)


def dependent_at(rows: UnitRows, found: Start, null: Matrix) -> SingularPosition:
    """The rows that depend on others at ``found``; ``null`` (m + p, d) are the left singular vectors of what is lost."""
    pivots = linalg.qr(null.T, mode="r", pivoting=True)[1][: null.shape[1]]
    s, out = rows.dynamics.structure, redundant_rows(rows.dynamics)
    kept = [i for i in range(s.m + s.p + len(out)) if i not in out]
    dependent = tuple(sorted(kept[int(i)] for i in pivots))
    return SingularPosition(found.t, len(kept), len(kept) - len(dependent), dependent)


def places_of(t: Matrix, q: Matrix, v: Matrix) -> list[Place]:
    """The ends of steps in the rows ``t`` (k, 1), ``q`` and ``v`` (k, n) of a run, with v' by differences."""
    if len(t) < 2:
        return []
    vdot = np.diff(v, axis=0) / np.diff(t, axis=0)
    return [Place(float(time[0]), *rest) for time, *rest in zip(t[1:], q[1:], v[1:], vdot, strict=True)]


def cause_of(engine: Engine, failure: Failure, places: list[Place]) -> SingularPosition | Failure:
    """The singular position that has caused the ``failure`` of a run through ``places``; else the failure."""
    if failure.status not in MAY_BE_SINGULAR or not places:
        return failure
    reach = 2 * abs(float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED]))
    found = singular_position(engine.dynamics, engine.place, places, reach)
    if found is None or not found.by_mass:
        return found or failure
    return replace(failure, message=f"{failure.message.removesuffix('.')}. {found.text}")


OTHERS = "Several motions may follow; end before it, or choose other coordinates"


def told(position: SingularPosition, why: str, remedy: str = OTHERS) -> Failure:
    """That a run ends at ``position``, ``why`` it does not go on beyond, and what follows."""
    return Failure(Status.singular_iteration_matrix, f"{position.text}. It is not stepped over: {why}. {remedy}.")
