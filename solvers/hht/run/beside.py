"""States beside a singular position, where a projection, (H47), would move v by roundoff over sigma, (H51)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

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
FEW, MOST = 3, 64  # states that are looked at in any case, evenly spread; and where one is put back, with all others
SECONDS = 1.0  # of looks at the states of one array, about

States = tuple[Matrix, Matrix]  # q and v, (k, n) each


class Looks(NamedTuple):
    """Which states to look at: the ``first`` of them in any case, the others where one of these was put back."""

    states: list[int]
    first: int


@dataclass(frozen=True)
class Beside:
    """Finds such states of one run."""

    dynamics: Dynamics
    places: Sequence[Place]  #: some of the run, which tell what singular values are elsewhere

    def put_back(
        self, looks: Looks, t: Vector, after: States, before: States, moved: Callable[[int], Vector] | None = None
    ) -> tuple[list[int], str]:
        """Which states at ``t`` (k,) are ``before`` again, since ``after`` their projection no digit is left; and in words.

        Looked at are as many of ``looks`` as there is time for.  ``moved(i)`` (n,) of v where the projection does not tell.
        """
        (q, v), found, worst, late = after, list[int](), 0.0, 0
        for count, i in enumerate(looks.states):
            if count >= looks.first and not found:
                break
            if count >= self._affordable:
                late = len(looks.states) - count if found else 0
                break
            place = Place(float(t[i]), q[i], v[i])  # views
            try:
                if self._undetermined(place, moved(i) if moved else v[i] - before[1][i]):
                    q[i], v[i] = before[0][i], before[1][i]
                    found.append(i)
                    worst = max(worst, self._violated(place))
            except BudgetSpent:
                late = len(looks.states) - count
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
        _, sizes, right = np.linalg.svd(self._unit.at(place), full_matrices=False)
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


def keep(
    dynamics: Dynamics, start: Place, rows: OutputRows, before: States, done: Any, kink: Callable[[float], Vector]
) -> str:
    """:meth:`Beside.put_back` of ``rows``, which lose their multipliers; what is to be said of it.

    ``done`` (k,) tells which have their multipliers from the acceleration level, and of those put back that they need none.
    ``kink(t)`` (n,) of v at the end of a step stands for what moves it.
    """
    multipliers, bent = rows.rows[:, 1 + 2 * rows.q.shape[1] :], np.zeros_like(done)
    loud = _over_median(multipliers)
    with np.errstate(invalid="ignore"):  # infinite ones, which are looked at
        bent[1:-1] = ~(np.abs(loud[2:] - 2.0 * loud[1:-1] + loud[:-2]) <= 1.0)
    between = np.zeros_like(done) if rows.between is None else rows.between
    if rows.between is not None:
        loud = np.maximum(loud, _over_median(rows.v - before[1]))
    looks = _looks(loud, bent, between)
    if not looks.first:
        return ""

    def moved(i: int) -> Vector:
        return np.asarray(rows.v[i] - before[1][i]) if between[i] else kink(float(rows.t[i]))

    beside = Beside(dynamics, [start, *some_of(rows.t, rows.q, rows.v)[1:]])
    which, text = beside.put_back(looks, rows.t, (rows.q, rows.v), before, moved)
    multipliers[which], done[which] = np.nan, True
    return text


def most_moved(v: Matrix, before: Matrix) -> Looks:
    """Which of the states with ``v`` (k, n) are to be looked at, those first that are furthest from ``before``."""
    every = np.ones(len(v), dtype=bool)
    return _looks(_over_median(v - before), ~every, every)


def some_of(t: Vector, q: Matrix, v: Matrix) -> list[Place]:
    """The first, a middle one and the last of states (k, n) at ``t`` (k,)."""
    last = t.size - 1
    return [Place(float(t[i]), q[i], v[i]) for i in sorted({0, last // 2, last})]


def _looks(loud: Vector, also: Any, between: Any) -> Looks:
    """Of states those that are ``loud``, ``also`` others, and a few ``between`` steps; then more of these."""
    inside, first = np.flatnonzero(between), (loud > LOUD) | also
    first[inside[np.unique(np.linspace(0, inside.size - 1, min(FEW, inside.size)).astype(int))]] = True
    if not first.any():
        return Looks([], 0)
    order = np.argsort(-loud)
    wanted = order[first[order]].tolist()
    return Looks([*wanted, *order[(between & ~first)[order]].tolist()[: max(MOST - len(wanted), 0)]], len(wanted))


def _over_median(x: Matrix) -> Vector:
    """The largest of each row over the median of these, zeros apart."""
    size = np.abs(x).max(axis=1)
    some = size[size > 0.0]
    with np.errstate(over="ignore"):
        return np.asarray(size / np.partition(some, some.size // 2)[some.size // 2]) if some.size else size


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
        text += f" The time ended before {late} rows were looked at for a singular position beside them."
    return text.strip()
