"""States beside a singular position, where a projection, (H47), would move v by roundoff over sigma, (H51)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import Dynamics
from solvers._projection import BESIDE, sizes_from
from solvers._start import Place
from solvers.hht.equations.formulas import EPS
from solvers.hht.run.history import OutputRows
from solvers.hht.run.singular import UnitRows, seconds_of_look

FALLEN = 1e-3  # of what it is elsewhere: below that a singular value falls towards zero
DOUBTFUL = 0.3  # of their size: multipliers so far from those of the step; regular motions stay below 0.1
MOVED = 10.0  # times the median: what a move of v between steps is measured by, where there are no multipliers
FEW, MANY = 3, 20  # looks in a row that restore nothing, after which there are no more: at any states; at doubtful ones
SECONDS = 1.0  # of looks

States = tuple[Matrix, Matrix]  # q and v, (k, n) each


class Restored(NamedTuple):
    """What :meth:`Beside.restore` has done."""

    found: list[int]  #: states beside a singular position, which are again as before their projection
    worst: float  #: the largest constraint there over its row's size
    unseen: list[int]  #: others for which the time did not suffice: they are so too, where some were found

    @property
    def states(self) -> list[int]:
        """All that are as before."""
        return [*self.found, *self.unseen] if self.found else []

    def text(self, where: str, lost: str = "") -> str:
        """In words; ``where`` those are that were found, and what else is ``lost`` there."""
        said, late = "", ""
        if self.found:
            said = (
                f"{where}, beside a singular position, the constraints' rank is so nearly lost that nothing better is known "
                "than the state of the step, or as interpolated in it: it stands, off the constraints by up to "
                f"{self.worst:.2g} of their size{lost}."
            )
        if self.unseen:
            late = f"No time was left to look for a singular position beside {len(self.unseen)} of the states"
            late += f", which stand likewise{lost}." if self.found else "."
        return f"{said} {late}".strip()


@dataclass
class Beside:
    """Finds such states of one run."""

    dynamics: Dynamics
    places: Sequence[Place]  #: some of the run, which tell what singular values are elsewhere
    left: float = field(default_factory=lambda: SECONDS)  #: of the time for looks [s]

    def restore(self, doubt: Vector, few: int, t: Vector, after: States, before: States) -> Restored:
        """Make those states at ``t`` (k,) ``before`` again of which no digit is left ``after`` their projection.

        ``doubt`` (k,) is how far multipliers are from what is known of them, over their size.  Looked at are the most
        doubtful first, until ``MANY`` doubtful ones in a row, or ``few`` of the others, may stay.
        """
        (q, v), found, worst, stay = after, list[int](), 0.0, 0
        order, doubtful = np.argsort(-doubt).tolist(), int(np.count_nonzero(doubt > DOUBTFUL))
        for count, i in enumerate(order):
            if stay >= (MANY if count < doubtful else few):
                break
            place, began = Place(float(t[i]), q[i], v[i]), time.perf_counter()  # views
            try:
                self._expect_time(1 if count else 2 + len(self.places))
                stay += 1
                if self._undetermined(place, v[i] - before[1][i], doubtful=bool(doubt[i] > 1.0)):
                    q[i], v[i] = before[0][i], before[1][i]
                    found.append(i)
                    worst, stay = max(worst, self._violated(place)), 0
            except BudgetSpent:
                unseen = order[count : t.size if few and found else max(doubtful, few)]
                if found:
                    q[unseen], v[unseen] = before[0][unseen], before[1][unseen]
                return Restored(found, worst, unseen)
            except (NonFiniteValue, linalg.LinAlgError):  # no rank where something is not finite
                continue
            finally:
                self.left -= time.perf_counter() - began
        return Restored(found, worst, [])

    def _expect_time(self, looks: int) -> None:
        """Raise :class:`BudgetSpent` where so many ``looks`` would take more time than is left for them."""
        if looks * seconds_of_look(self.dynamics) > self.left:
            raise BudgetSpent("seconds", SECONDS)

    @cached_property
    def _unit(self) -> UnitRows:
        return UnitRows(self.dynamics, self.places[0])

    @cached_property
    def _elsewhere(self) -> float:
        """The least singular value where it is largest of the ``places``."""
        return max(map(self._unit.least, self.places))

    def _undetermined(self, place: Place, moved: Vector, *, doubtful: bool) -> bool:
        """Whether at ``place``, to which a projection has ``moved`` (n,) v, no digit of the multipliers is known."""
        elsewhere = self._elsewhere
        _, sizes, right = np.linalg.svd(self._unit.at(place), full_matrices=False)
        weak = sizes <= FALLEN * elsewhere
        if doubtful or not weak.any():
            return bool(weak.any())
        root, sigma = self._unit.root(place), sizes[weak] / elsewhere
        along, speed = np.abs(right[weak] @ (root.T @ moved)), linalg.norm(root.T @ (place.v - moved))
        return bool(np.any((along > sigma**2 * speed) | (sigma**3 < EPS)))  # (H51)

    def _violated(self, place: Place) -> float:
        """The largest constraint there over its row's size."""
        near = *self.places, place
        sizes = sizes_from(np.array([x.q for x in near]), np.array([x.v for x in near]))
        return self._unit.projection.violated(place.t, place.q, place.v, sizes)


def settle(dynamics: Dynamics, start: Place, rows: OutputRows, before: States, steps: Matrix, done: Any) -> str:
    """:meth:`Beside.restore` of ``rows``, which lose their multipliers; what is to be said of it.

    ``steps`` (k, m + p) are those of the steps, ``done`` (k,) tells which have others, and of those restored that they need
    none.
    """
    multipliers = rows.rows[:, 1 + 2 * rows.q.shape[1] :]
    doubt = np.where(done, differences(multipliers, steps), np.inf)
    if not (doubt > DOUBTFUL).any():
        return ""
    beside = Beside(dynamics, [start, *some_of(rows.t, rows.q, rows.v)[1:]])
    restored = beside.restore(doubt, 0, rows.t, (rows.q, rows.v), before)
    multipliers[restored.states], done[restored.states] = np.nan, True
    return restored.text(_at(rows.t[restored.found]), ", without multipliers (nan)")


def restore_moved(beside: Beside, t: Vector, after: States, before: States) -> str:
    """:meth:`Beside.restore` of states between steps, the furthest moved first, on a clock of its own; in words."""
    beside.left = SECONDS
    moved = np.abs(after[1] - before[1]).max(axis=1)
    some = moved[moved > 0.0]
    doubt = moved / (MOVED * np.median(some)) if some.size else moved
    restored = beside.restore(doubt, FEW, t, after, before)
    return restored.text(_at(t[restored.found]))


def some_of(t: Vector, q: Matrix, v: Matrix) -> list[Place]:
    """The first, a middle one and the last of states (k, n) at ``t`` (k,)."""
    last = t.size - 1
    return [Place(float(t[i]), q[i], v[i]) for i in sorted({0, last // 2, last})]


def differences(multipliers: Matrix, steps: Matrix) -> Vector:
    """The largest of each row of ``multipliers`` from those of the ``steps``, over the size of these there or in the mean.

    The mean is that without the largest tenth: a step's own may be poles.  A multiplier that stays near zero is measured by
    the largest one.
    """
    sizes = np.abs(steps)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # infinite ones, and zeros all along
        mean = np.sort(sizes, axis=0)[: max(1, 9 * len(sizes) // 10)].mean(axis=0)  # nan ones are last
        found = (np.abs(multipliers - steps) / np.maximum(sizes, np.maximum(mean, BESIDE * mean.max()))).max(axis=1)
    return np.where(np.isnan(found), np.inf, found)


def _at(times: Vector) -> str:
    return f"At {times.size} rows, first at t = {times.min():.17g}" if times.size else ""
