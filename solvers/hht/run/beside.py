"""Rows of output beside a singular position: where a projection, (H47), would move v by roundoff over sigma, (H51)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import Dynamics
from solvers.hht.equations.formulas import EPS
from solvers.hht.run.history import OutputRows
from solvers.hht.run.singular import LARGEST, Place, UnitRows, dense

FALLEN = 1e-3  # of what it is elsewhere: below that a singular value falls towards zero
LOUD = 10.0  # times the median of the multipliers: those of rows beside a singular position are larger by far
ALL_UP_TO = 64  # rows that are all looked at; of more, only those with loud multipliers: a look takes 0.2 ms


@dataclass(frozen=True)
class Beside:
    """Rows between the steps of one run, and how they were interpolated before they were projected."""

    dynamics: Dynamics
    rows: OutputRows
    q: Matrix  #: (k, n) of the rows that lie between steps
    v: Matrix  #: (k, n) likewise

    def keep(self, done: Any) -> str:
        """Put back as interpolated, without multipliers, what a projection does not determine; in words how many rows.

        ``done`` (k,) tells which rows have their multipliers from the acceleration level; those put back have.
        """
        s, rows = self.dynamics.structure, self.rows
        if not s.constrained or s.n > LARGEST or not np.count_nonzero(rows.between):
            return ""
        between, times = np.flatnonzero(rows.between), list[float]()
        with suppress(NonFiniteValue, ValueError, linalg.LinAlgError):  # no rank where something is not finite
            for k in np.flatnonzero(self._loud(between) | ~done[between]).tolist():
                i = between[k]
                if self._undetermined(float(rows.t[i]), (self.q[k], self.v[k]), (rows.q[i], rows.v[i])):
                    rows.q[i], rows.v[i] = self.q[k], self.v[k]
                    rows.lam[i], rows.mu[i], done[i] = np.nan, np.nan, True
                    times.append(float(rows.t[i]))
        if not times:
            return ""
        return (
            f"At {len(times)} rows, first at t = {times[0]:.17g}, beside a singular position, the constraints' rank is "
            "so nearly lost that nothing better than the interpolated state is known: it stands, without multipliers (nan)."
        )

    def _loud(self, between: Any) -> Any:
        """Which rows may be such."""
        largest = np.abs(np.concatenate([self.rows.lam, self.rows.mu], axis=1)).max(axis=1)
        found = ~(largest[between] <= LOUD * np.median(largest))
        return found if between.size > ALL_UP_TO else np.ones(between.size, dtype=bool)

    @cached_property
    def _unit(self) -> UnitRows:
        return UnitRows(self.dynamics, self._place(0))

    @cached_property
    def _elsewhere(self) -> float:
        """The least singular value where it is largest of a few rows."""
        last = len(self.rows.t) - 1
        return max(self._unit.least(self._place(i)) for i in {0, last // 2, last})

    def _place(self, i: int) -> Place:
        rows = self.rows
        return Place(float(rows.t[i]), rows.q[i], rows.v[i], rows.v[i])

    def _undetermined(self, t: float, before: tuple[Vector, Vector], after: tuple[Vector, Vector]) -> bool:
        """Whether what a projection from ``before`` to ``after`` has moved v by leaves no digit of the multipliers."""
        place, mass = Place(t, *after, after[1]), dense(self._unit.projection.mass(t, after[0]))
        _, sizes, right = linalg.svd(self._unit.at(place), full_matrices=False)
        weak = sizes <= FALLEN * self._elsewhere
        if not weak.any():
            return False
        root = np.eye(mass.shape[0])
        with suppress(linalg.LinAlgError):  # as in UnitRows
            root = linalg.cholesky(mass, lower=True).T
        moved = np.abs(right[weak] @ root @ (after[1] - before[1]))
        sigma = sizes[weak] / self._elsewhere
        return bool(np.any((moved > sigma**2 * linalg.norm(root @ before[1])) | (sigma**3 < EPS)))  # (H51)
