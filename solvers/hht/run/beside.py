"""States beside a singular position, where a projection, (H47), would move v by roundoff over sigma, (H51)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import Dynamics
from solvers._projection import sizes_from
from solvers._start import Place
from solvers.hht.equations.formulas import EPS
from solvers.hht.run.history import OutputRows
from solvers.hht.run.singular import UnitRows, seconds_of_look

FALLEN = 1e-3  # of what it is elsewhere: below that a singular value falls towards zero
LOUD = 10.0  # times the median: so much further such states are moved, or so much larger are multipliers there
ALL_UP_TO = 64  # states that are all looked at; of more, only those that are loud
SECONDS = 1.0  # of looks at the states of one array, about

States = tuple[Matrix, Matrix]  # q and v, (k, n) each


@dataclass(frozen=True)
class Beside:
    """Finds such states of one run."""

    dynamics: Dynamics
    places: Sequence[Place]  #: some of the run, which tell what singular values are elsewhere

    def keep(self, rows: OutputRows, before: States, done: Any, kink: Callable[[float], Vector]) -> str:
        """:meth:`put_back` of ``rows``, which lose their multipliers; what is to be said of it.

        ``done`` (k,) tells which have their multipliers from the acceleration level: those put back are, and the others,
        found one by one, cost as much as a look.  ``kink(t)`` (n,) of v at the end of a step stands for what moves it.
        """
        multipliers, also = rows.rows[:, 1 + 2 * rows.q.shape[1] :], ~done
        loud, ends = _over_median(np.abs(multipliers).max(axis=1)), np.ones_like(done)
        if rows.between is not None:
            ends = ~rows.between
            also |= rows.between & (np.count_nonzero(rows.between) <= ALL_UP_TO)
        also[1:-1] |= ends[1:-1] & (np.abs(np.diff(loud, 2)) > 1.0)
        moved = lambda i: kink(float(rows.t[i])) if ends[i] else rows.v[i] - before[1][i]  # noqa: E731
        which, text = self.put_back(rows.t, (rows.q, rows.v), before, loud, also, moved)
        multipliers[which], done[which] = np.nan, True
        return text

    def put_back(
        self,
        t: Vector,
        after: States,
        before: States,
        loud: Any = 0.0,
        also: Any = False,
        moved: Callable[[int], Vector] | None = None,
    ) -> tuple[list[int], str]:
        """Which states at ``t`` (k,) are ``before`` again, since ``after`` their projection no digit is left; and in words.

        Looked at are those that v was moved by most or that are ``loud`` (k,), from the loudest on, and those ``also``, as
        many as there is time for.  ``moved(i)`` (n,) of v where it is not the projection alone that tells.
        """
        (q, v), found, worst, late = after, list[int](), 0.0, 0
        change = v - before[1]
        loud = np.maximum(_over_median(np.abs(change).max(axis=1)), loud)
        order = np.argsort(-loud)
        looks = order[((loud > LOUD) | also)[order]][: self._affordable]
        for count, i in enumerate(looks.tolist()):
            place = Place(float(t[i]), q[i], v[i])  # views
            try:
                if self._undetermined(place, moved(i) if moved else change[i]):
                    q[i], v[i] = before[0][i], before[1][i]
                    found.append(i)
                    worst = max(worst, self._violated(place))
            except BudgetSpent:
                late = looks.size - count
                break
            except (NonFiniteValue, linalg.LinAlgError):  # no rank where something is not finite
                continue
        return found, _told(t[sorted(found)], worst, late)

    @property
    def _affordable(self) -> int:
        """How many looks, beside those at the ``places``."""
        few = int(SECONDS / seconds_of_look(self.dynamics)) - len(self.places)
        return max(few, 0) if self.dynamics.structure.constrained else 0

    @cached_property
    def _unit(self) -> UnitRows:
        return UnitRows(self.dynamics, self.places[0])

    @cached_property
    def _elsewhere(self) -> float:
        """The least singular value where it is largest of the ``places``."""
        return max(map(self._unit.least, self.places))

    def _undetermined(self, place: Place, moved: Vector) -> bool:
        """Whether at ``place``, to which a projection has ``moved`` (n,) v, no digit of the multipliers is known."""
        _, sizes, right = linalg.svd(self._unit.at(place), full_matrices=False)
        weak = sizes <= FALLEN * self._elsewhere
        if not weak.any():
            return False
        root, sigma = self._unit.root(place), sizes[weak] / self._elsewhere
        along, speed = np.abs(right[weak] @ (root.T @ moved)), linalg.norm(root.T @ (place.v - moved))
        return bool(np.any((along > sigma**2 * speed) | (sigma**3 < EPS)))  # (H51)

    def _violated(self, place: Place) -> float:
        """The largest constraint there over its row's size."""
        near = *self.places, place
        sizes = sizes_from(np.array([x.q for x in near]), np.array([x.v for x in near]))
        return self._unit.projection.violated(place.t, place.q, place.v, sizes)


def some_of(t: Vector, q: Matrix, v: Matrix) -> list[Place]:
    """The first, a middle one and the last of states (k, n) at ``t`` (k,)."""
    last = t.size - 1
    return [Place(float(t[i]), q[i], v[i]) for i in sorted({0, last // 2, last})]


def _over_median(x: Vector) -> Vector:
    """Each over the median of those that are not zero."""
    some = x[x > 0.0]
    return np.asarray(x / np.partition(some, some.size // 2)[some.size // 2]) if some.size else x


def _told(times: Vector, worst: float, late: int) -> str:
    """What to say of rows that were put back, and of others for which the time did not suffice."""
    text = ""
    if times.size:
        text = (
            f"At {times.size} rows, first at t = {times[0]:.17g}, beside a singular position, the constraints' rank is so "
            "nearly lost that nothing better is known than the state of the step, or as interpolated in it: it stands, off "
            f"the constraints by up to {worst:.2g} of their size, without multipliers (nan)."
        )
    if late:
        text += f" The time budget ended before {late} rows were looked at for a singular position beside them."
    return text.strip()
