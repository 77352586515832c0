"""The accepted steps, in one array that grows fourfold, and the events on the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import Structure
from hhtbench.result import StepsData
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.step.state import State

GROWTH = 4  # times the rows there are
ROOM = 64  # rows at first
KEPT = 24 * 2**20  # bytes of rows of steps, at most, where output times were asked for and not the steps
BLOCK = 65_536  # output rows that are interpolated at once: the time budget is looked at between
PER_NUMBER = 5e-9  # [s] of a row: copies of arrays that do not fit into the nearer memories


class OutputRows(NamedTuple):
    """Rows at output times, with the stage multipliers of the steps' ends next to them, (H8)."""

    t: Vector  #: (k,)
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)
    lam: Matrix  #: (k, m)
    mu: Matrix  #: (k, p)


class History:
    """Start, accepted steps and changes of state of one integration, one packed row each.

    An event that changes the state has two rows with one time: the end of the step, then the state after the change.
    Where the rows of the steps would take more than ``KEPT``, only those at the times of ``t_eval`` are kept, if there are.
    """

    def __init__(self, structure: Structure, start: State, events: int = 0, t_eval: Vector | None = None) -> None:
        self._n, self._parts = structure.n, parts_of(structure)
        self._rows = np.empty((ROOM, self._parts[-1].stop))
        self._count = self._changes = self._dropped = 0
        self._elapsed, self._begin = 0.0, start.t
        self._ahead = t_eval  # those that are not in ``_output`` yet
        self._output: list[OutputRows] = []
        self._occurrences: tuple[list[Occurrence], ...] = tuple([] for _ in range(events))
        self.restart(start)

    def restart(self, state: State) -> None:
        """Append a state that no step has led to: the start, or what an event made of the last."""
        self._changes += 1
        self.room(1)[0] = np.concatenate([[state.t, 0.0], state.q, state.v, state.a, state.lam, state.lam, state.mu])
        self.commit(1)

    def room(self, count: int) -> Matrix:
        """Rows for ``count`` steps to be written to, (count, columns): t, h, q, v, a, lam at both ends, mu."""
        if self._ahead is not None and self._count > 1 and (self._count + count) * self._rows[0].nbytes > KEPT:
            self._drop_steps(self._ahead)
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

    def _columns(self, *which: int) -> list[Matrix]:
        """Of t, h, q, v, a, lam at both ends, mu those that are asked for."""
        return [self._rows[: self._count, self._parts[i]] for i in which]

    def _drop_steps(self, ahead: Vector) -> None:
        """Keep the output rows before the last step's end, which an event may change yet, and that end."""
        output = self.dense_output()
        direction = np.sign(output.t[-1] - output.t[0])
        if direction == 0.0:
            return
        passed = int(np.searchsorted(direction * ahead, direction * output.t[-1], "left"))
        self._output.append(self._output_rows(output, ahead[:passed]))
        self._dropped, self._elapsed = self.steps
        self._ahead, self._rows[0], self._count = ahead[passed:], self._rows[self._count - 1], 1
        self._rows[0, 1] = 0.0  # its step is counted

    def output_rows(self, output: HermiteOutput, enough: Callable[[], bool]) -> tuple[OutputRows, int]:
        """The rows at the times of ``t_eval`` that were reached, or of every step, until ``enough()``; how many were.

        ``output``: the :meth:`dense_output` by now.
        """
        if self._ahead is None:
            t, q, v, lam, mu = (column.copy() for column in self._columns(0, 2, 3, 6, 7))
            return OutputRows(t[:, 0], q, v, lam, mu), self._count
        rows, times, (low, high) = [*self._output], self._ahead, sorted((output.t[0], output.t[-1]))
        if times.size and not (low <= times[0] <= high and low <= times[-1] <= high):  # sorted: else all were reached
            times = times[(times >= low) & (times <= high)]
        asked = times.size + sum([part.t.size for part in rows])
        for first in range(0, max(times.size, 1), BLOCK):
            rows.append(self._output_rows(output, times[:0] if enough() else times[first : first + BLOCK]))
        return rows[0] if len(rows) == 1 else OutputRows(*(np.concatenate(x) for x in zip(*rows, strict=True))), asked

    def _output_rows(self, output: HermiteOutput, times: Vector) -> OutputRows:
        """At ``times`` (k,), with the stage multipliers at the step ends next to them, first order."""
        row = output.rows_before(times)
        ends = self._rows[row + (output.t[row] != times)]
        return OutputRows(times, *output.at(times, row), ends[:, self._parts[6]].copy(), ends[:, self._parts[7]].copy())

    @property
    def span(self) -> tuple[float, float]:
        """From the start to the end of the last step [s]."""
        return self._begin, float(self._rows[self._count - 1, 0])

    @property
    def steps(self) -> tuple[int, float]:
        """How many were accepted, and the sum of their signed lengths [s]."""
        h = self._rows[: self._count, 1][self._made()]
        return self._dropped + h.size, self._elapsed + float(h.sum())

    def _made(self) -> Any:
        """Which rows are ends of steps."""
        return slice(1, None) if self._changes == 1 else self._rows[: self._count, 1] != 0.0

    def kept(self, output: HermiteOutput) -> dict[str, Any]:
        """What the Solution says of events and, if the steps were kept, of these; ``output``: the dense output."""
        steps = {} if self._dropped else {"steps_data": self._steps_data(), "interpolant": output}
        return steps | self._events()

    def _steps_data(self) -> StepsData:
        """Stage values, one row per accepted step; parts of the rows themselves, which nobody changes any more."""
        rows = self._rows[: self._count][self._made()]
        _, _, _, _, a, lam_start, lam_end, mu = self._parts
        stages = {"a": rows[:, a], "lam_start": rows[:, lam_start], "lam_end": rows[:, lam_end], "mu_half": rows[:, mu]}
        return StepsData(t=rows[:, 0], h=rows[:, 1], **stages)

    def dense_output(self) -> HermiteOutput:
        """Interpolant through all rows; parts of them."""
        t, q, v = self._columns(0, 2, 3)
        return HermiteOutput(t[:, 0].copy(), q, v)

    def _events(self) -> dict[str, Any]:
        """Times and states of the events, as :class:`~hhtbench.result.Solution` names them."""
        found, n = self._occurrences, self._n
        if not found:
            return {}
        return {
            "t_events": tuple(np.array([o.t for o in each]) for each in found),
            "q_events": tuple(np.array([o.q for o in each]).reshape(-1, n) for each in found),
            "v_events": tuple(np.array([o.v for o in each]).reshape(-1, n) for each in found),
        }


@lru_cache
def parts_of(structure: Structure) -> tuple[slice, ...]:
    """Where in a row t, h, q, v, a, lam at both ends and mu stand."""
    n, m = structure.n, structure.m
    ends = tuple(accumulate((1, 1, n, n, n, m, m, structure.p)))
    return tuple(map(slice, (0, *ends), ends))


def columns(structure: Structure) -> int:
    """Of a row."""
    return int(parts_of(structure)[-1].stop)
