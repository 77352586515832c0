"""The accepted steps, kept in arrays that grow by doubling."""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import Structure
from hhtbench.result import StepsData
from solvers.hht.dense import HermiteOutput
from solvers.hht.state import State, Step


class History:
    """Start and accepted steps of one integration, one packed row each."""

    def __init__(self, structure: Structure, start: State) -> None:
        n, m, p = structure.n, structure.m, structure.p
        self._cuts = np.cumsum([1, 1, n, n, n, m, m])
        self._rows = np.zeros((64, 2 + 3 * n + 2 * m + p))
        self._count = 0
        self._sizes = (m, p)
        self._append(start, start.lam, start.lam, start.mu)

    def add(self, step: Step) -> None:
        """Append an accepted step."""
        self._append(step.state, step.lam_start, step.lam_end, step.mu_half)

    def _append(self, state: State, lam_start: Vector, lam_end: Vector, mu_half: Vector) -> None:
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        h = 0.0 if state.h is None else state.h
        self._rows[self._count] = np.concatenate([[state.t, h], state.q, state.v, state.a, lam_start, lam_end, mu_half])
        self._count += 1

    def _columns(self) -> list[Matrix]:
        return np.split(self._rows[: self._count], self._cuts, axis=1)

    def steps_data(self) -> StepsData:
        """Stage values, one row per accepted step."""
        t, h, _, _, a, lam_start, lam_end, mu_half = (column[1:].copy() for column in self._columns())
        return StepsData(t=t[:, 0], h=h[:, 0], a=a, lam_start=lam_start, lam_end=lam_end, mu_half=mu_half)

    def dense_output(self) -> HermiteOutput:
        """Interpolant through all rows."""
        t, _, q, v = (column.copy() for column in self._columns()[:4])
        return HermiteOutput(t[:, 0], q, v)

    def multiplier_guess(self, times: Vector) -> tuple[Matrix, Matrix]:
        """Stage multipliers at the step ends next to ``times``: (k, m) and (k, p), first order."""
        columns = self._columns()
        t = columns[0][:, 0]
        direction = -1.0 if t[-1] < t[0] else 1.0
        index = np.clip(np.searchsorted(direction * t, direction * times), 0, t.size - 1)
        return columns[6][index], columns[7][index]
