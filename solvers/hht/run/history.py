"""The accepted steps, in one array that grows fourfold, and the events on the way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import Structure
from hhtbench.result import StepsData
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.step.state import State

GROWTH = 4  # times the rows there are
ROOM = 64  # rows at first
PER_NUMBER = 5e-9  # [s] of a row: copies of arrays that do not fit into the nearer memories


class History:
    """Start, accepted steps and changes of state of one integration, one packed row each.

    An event that changes the state has two rows with one time: the end of the step, then the state after the change.
    """

    def __init__(self, structure: Structure, start: State, events: int = 0) -> None:
        n, m = structure.n, structure.m
        self._n, self._cuts = n, np.cumsum([1, 1, n, n, n, m, m])
        self._rows = np.empty((ROOM, columns(structure)))
        self._count = self._changes = 0
        self._occurrences: tuple[list[Occurrence], ...] = tuple([] for _ in range(events))
        self.restart(start)

    def restart(self, state: State) -> None:
        """Append a state that no step has led to: the start, or what an event made of the last."""
        self._changes += 1
        self.room(1)[0] = np.concatenate([[state.t, 0.0], state.q, state.v, state.a, state.lam, state.lam, state.mu])
        self.commit(1)

    def room(self, count: int) -> Matrix:
        """Rows for ``count`` steps to be written to, (count, columns): t, h, q, v, a, lam at both ends, mu."""
        if self._count + count > len(self._rows):  # several times what is there: untouched memory costs nothing
            rows = np.empty((max(GROWTH * len(self._rows), self._count + count), self._rows.shape[1]))
            rows[: self._count] = self._rows[: self._count]
            self._rows = rows
        return self._rows[self._count : self._count + count]

    def commit(self, count: int) -> None:
        """``count`` of those rows hold accepted steps now."""
        self._count += count

    def handing_over(self) -> float:
        """About how many seconds it takes to hand over the rows, multipliers apart."""
        return PER_NUMBER * self._count * self._rows.shape[1]

    def note(self, occurrences: Sequence[Occurrence]) -> None:
        """Append events."""
        for occurrence in occurrences:
            self._occurrences[occurrence.index].append(occurrence)

    def _columns(self) -> list[Matrix]:
        return np.split(self._rows[: self._count], self._cuts, axis=1)

    def steps_data(self) -> StepsData:
        """Stage values, one row per accepted step; parts of the rows themselves, which nobody changes any more."""
        made: Any = slice(1, None) if self._changes == 1 else self._rows[: self._count, 1] != 0.0
        t, h, _, _, a, lam_start, lam_end, mu_half = (column[made] for column in self._columns())
        return StepsData(t=t[:, 0], h=h[:, 0], a=a, lam_start=lam_start, lam_end=lam_end, mu_half=mu_half)

    def dense_output(self) -> HermiteOutput:
        """Interpolant through all rows; parts of them."""
        t, _, q, v = self._columns()[:4]
        return HermiteOutput(t[:, 0].copy(), q, v)

    def multiplier_guess(self, times: Vector | None) -> tuple[Matrix, Matrix]:
        """Stage multipliers at the step ends next to ``times``: (k, m) and (k, p), first order; None: of all rows."""
        columns = self._columns()
        if times is None:
            return columns[6].copy(), columns[7].copy()
        t = columns[0][:, 0]
        row = HermiteOutput(t, columns[2], columns[3]).rows_before(times)
        index = np.minimum(row + (t[row] != times), t.size - 1)
        return columns[6][index], columns[7][index]

    def events(self) -> dict[str, Any]:
        """Times and states of the events, as :class:`~hhtbench.result.Solution` names them."""
        found, n = self._occurrences, self._n
        return {
            "t_events": tuple(np.array([o.t for o in each]) for each in found),
            "q_events": tuple(np.array([o.q for o in each]).reshape(-1, n) for each in found),
            "v_events": tuple(np.array([o.v for o in each]).reshape(-1, n) for each in found),
        }


def columns(structure: Structure) -> int:
    """Of a row: t, h, q, v, a, lam at both ends, mu."""
    return 2 + 3 * structure.n + 2 * structure.m + structure.p
