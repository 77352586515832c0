"""The accepted steps of a run as rows of one growing array, and its events."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from hhtbench.lowering import Structure
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.solution.result import StepsData
from solvers._projection import sizes_from
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.events.event import Occurrence
from solvers.hht.run.blend import StepEnds
from solvers.hht.run.interpolate import interpolate

GROWTH = 4  # factor by which the array grows
OVERLAP = 4  # last steps kept when others are dropped: later output rows need them, (H60)
ROOM = 512 + OVERLAP  # initial rows: those kept and those of a first call; untouched memory costs nothing
MAX_KEPT = 24 * 2**20  # bytes of rows of steps kept where output times were asked for and not the steps
BLOCK = 65_536  # output rows interpolated at once; the time budget is checked between blocks
PER_NUMBER = 5e-9  # [s] to copy a number of a row when arrays exceed the caches
RECOVERED = 0.45  # time to recover the multipliers of a row, relative to that of a step


class OutputRows:
    """Rows at output times, with the stage multipliers of the steps' ends next to them, (H8)."""

    def __init__(self, rows: Matrix, between: Any, steps: StepEnds, parts: Sequence[Any]) -> None:
        """``rows`` (k, 1 + 2n + m + p); ``parts`` are the slices of q, v (k, n), lam (k, m) and mu (k, p)."""
        self.rows, self.t = rows, rows[:, 0].copy()
        self.between = between  #: (k,) True for rows between the ends of steps; None: all are ends
        self.steps = steps  #: ends of steps around the rows between
        self.q, self.v, self.lam, self.mu = [rows[part] for part in parts]


class History:
    """Start, accepted steps and changes of state of one integration, one packed row each.

    An event that changes the state has two rows with one time: the end of the step, then the state after the change.
    Where the rows of steps would take more than ``MAX_KEPT``, only rows at the times of ``t_eval`` are kept, if it is given
    and not ``every`` step is asked for.
    """

    def __init__(
        self, structure: Structure, start: Vector, events: int = 0, t_eval: Vector | None = None, *, every: bool = False
    ) -> None:
        """``start``: the row of the initial state."""
        self._layout, self._constrained = row_layout(structure), structure.constrained
        self._rows = np.empty((ROOM, self._layout.columns))
        self._rows[0], self._count, self._changes, self._dropped = start, 1, 1, 0
        self._elapsed, self._begin = 0.0, float(start[0])
        self._every = every
        self._ahead = t_eval  # output times not in ``_output`` yet
        self._output: list[tuple[Matrix, Any]] = []  # output rows, and which of them are between steps
        self._around: list[Matrix] = []  # rows of the steps around these
        self._sizes: Any = 0.0  # (2n,) sizes of q and v in the steps that were dropped
        self._notes: list[str] = []
        self._occurrences: tuple[list[Occurrence], ...] = tuple([[] for _ in range(events)])

    def restart(self, row: Vector) -> None:
        """Append a state that no step has reached: the last one, changed by an event."""
        self._changes += 1
        self.room(1)[0] = row
        self.commit(1)

    def room(self, count: int) -> Matrix:
        """Empty rows for ``count`` steps, (count, columns): t, h, q, v, a, lam at both ends, mu."""
        few = self._every or self._ahead is None or self._count <= OVERLAP
        if not few and (self._count + count) * self._rows[0].nbytes > MAX_KEPT:
            self._drop_steps(self._ahead)
        if self._count + count > len(self._rows):  # several times what is there: untouched memory costs nothing
            rows = np.empty((max(GROWTH * len(self._rows), self._count + count), self._rows.shape[1]))
            rows[: self._count] = self._rows[: self._count]
            self._rows = rows
        return self._rows[self._count : self._count + count]

    def commit(self, count: int) -> None:
        """Mark ``count`` of these rows as accepted steps."""
        self._count += count

    def replace_last(self, steps: int, row: Vector, note: str) -> None:
        """Replace the last ``steps`` by one step that ends at ``row``, with a note for the solution's message."""
        self._count -= steps
        self.room(1)[0] = row
        self.commit(1)
        self._notes.append(note)

    def last(self, count: int, which: Sequence[int] = (0, 2, 3)) -> list[Matrix]:
        """t (k, 1), q and v (k, n), or ``which`` parts, of at most ``count`` last rows, after any change of state."""
        first = max(self._count - count, 0)
        changed = np.flatnonzero(self._rows[first : self._count, 1] == 0.0)
        first += int(changed[-1]) if changed.size else 0
        return [self._rows[first : self._count, self._layout.parts[i]] for i in which]

    def forced(self) -> list[Any]:
        """t and h (k,), q, v and a (n, k) of the rows kept; h is 0 where a row is no end of a step."""
        t, h, *motion = [np.ascontiguousarray(part.T) for part in self._columns(0, 1, 2, 3, 4)]
        return [t[0], h[0], *motion]

    def handing_over(self, stepping: float) -> float:
        """Estimated time [s] to hand over the rows of steps that took ``stepping`` [s]."""
        recovering = RECOVERED * stepping if self._ahead is None and self._constrained else 0.0
        return PER_NUMBER * self._count * self._rows.shape[1] + recovering

    def note(self, occurrences: Sequence[Occurrence]) -> None:
        """Append occurrences of events."""
        for occurrence in occurrences:
            self._occurrences[occurrence.index].append(occurrence)

    def _columns(self, *which: int) -> list[Matrix]:
        """Selected parts of all rows, by index into t, h, q, v, a, lam at both ends, mu."""
        return [self._rows[: self._count, self._layout.parts[i]] for i in which]

    def _drop_steps(self, ahead: Any) -> None:
        """Interpolate the output rows that can be, keep the steps around them and the last ``OVERLAP``; drop all others."""
        rows = self._rows[: self._count]
        t0, t1 = float(rows[0, 0]), float(rows[1 - OVERLAP, 0])
        if t0 == t1:
            return
        direction = math.copysign(1.0, t1 - t0)
        passed = int(np.searchsorted(direction * ahead, direction * t1, "left"))
        self._output.append(self._interpolated(ahead[:passed], lambda: False))
        around = np.union1d(np.arange(OVERLAP), self._ends(rows).around(ahead[:passed]))
        self._around.append(rows[around[around < self._count - OVERLAP]])
        self._sizes = self.sizes()
        self._count -= OVERLAP - 1
        self._dropped, self._elapsed = self.steps
        self._ahead, self._count = ahead[passed:], OVERLAP
        self._rows[:OVERLAP] = rows[-OVERLAP:].copy()

    def output_rows(self, enough: Callable[[], bool]) -> tuple[OutputRows, int]:
        """Rows at the times of ``t_eval`` that were reached, or of every step, until ``enough()``; and their full number."""
        layout, times = self._layout, self._ahead
        if times is None:
            rows = self._rows[: self._count]
            return OutputRows(rows.take(layout.own, axis=1), None, self._ends(rows), layout.output), self._count
        low, high = sorted(self.span)
        if times.size and not (low <= times.item(0) <= high and low <= times.item(-1) <= high):  # else all were reached
            times = times[(times >= low) & (times <= high)]
        rows, between = self._interpolated(times, enough)
        asked = times.size
        if self._output:
            asked += sum(len(part) for part, _ in self._output)
            rows, between = (np.concatenate(parts) for parts in zip(*self._output, (rows, between), strict=True))
        around = np.concatenate([*self._around, self._rows[: self._count]]) if self._around else self._rows[: self._count]
        return OutputRows(rows, between, self._ends(around), layout.output), asked

    def _ends(self, rows: Matrix) -> StepEnds:
        """Ends of the steps with these ``rows``, as views."""
        parts = self._layout.parts
        return StepEnds(rows[:, 0], rows[:, parts[2].start : parts[3].stop])

    def _interpolated(self, times: Vector, enough: Callable[[], bool]) -> tuple[Matrix, Any]:
        """Rows [t, q, v, lam, mu] at ``times`` (k,), and which are between steps; fewer if ``enough()`` becomes true."""
        rows, between = np.empty((times.size, self._layout.own.size)), np.empty(times.size, dtype=bool)
        for first in range(0, times.size, BLOCK):
            if enough():
                return rows[:first], between[:first]
            block = slice(first, first + BLOCK)
            asked = times[block].copy()  # the caller's array is read-only, which slows calls of compiled loops
            self._layout.interpolate(self._rows[: self._count], asked, rows[block], between[block])
        return rows, between

    def sizes(self) -> Vector:
        """Typical sizes of q and v over all steps, (2n,)."""
        return np.maximum(self._sizes, sizes_from(*self._columns(2, 3)))

    @property
    def span(self) -> tuple[float, float]:
        """Start of the run and end of its last step [s]."""
        return self._begin, float(self._rows[self._count - 1, 0])

    @property
    def steps(self) -> tuple[int, float]:
        """Number of accepted steps, and the sum of their signed lengths [s]."""
        h = self._rows[1 : self._count, 1]  # zero where a change has ended none
        return self._dropped + int(np.count_nonzero(h)), self._elapsed + float(np.add.reduce(h))

    def _made(self) -> Any:
        """Selects the rows that are ends of steps."""
        return slice(1, None) if self._changes == 1 else self._rows[: self._count, 1] != 0.0

    def kept(self, project: Callable[[HermiteOutput], Any] | None = None) -> dict[str, Any]:
        """Fields of the Solution on events and, if the steps were kept, on these; ``project`` projects dense output."""
        return ({} if self._dropped else {"_read": partial(self._read, project)}) | self._events()

    def _read(self, project: Callable[[HermiteOutput], Any] | None, name: str) -> Any:
        """Compute ``steps_data``, ``interpolant`` or ``projection`` when read."""
        if name == "steps_data":
            return self._steps_data()
        return self._dense_output() if name == "interpolant" else project and project(self._dense_output())

    def _steps_data(self) -> StepsData:
        """Stage values, one row per accepted step, as views of the rows."""
        rows = self._rows[: self._count][self._made()]
        _, _, _, _, a, lam_start, lam_end, mu = self._layout.parts
        stages = {"a": rows[:, a], "lam_start": rows[:, lam_start], "lam_end": rows[:, lam_end], "mu_half": rows[:, mu]}
        return StepsData(t=rows[:, 0], h=rows[:, 1], **stages)

    def _dense_output(self) -> HermiteOutput:
        """Interpolant through all rows, as views of these."""
        t, q, v = self._columns(0, 2, 3)
        return HermiteOutput(t[:, 0].copy(), q, v)

    def notes(self) -> list[str]:
        """Notes on singular positions, and on states at events, for the solution's message."""
        notes = Counter((o.name, o.note) for each in self._occurrences for o in each if o.note)
        times = {count: f", {count} times" if count > 1 else "" for count in notes.values()}
        return self._notes + [f"Event {name!r}{times[count]}: {note}" for (name, note), count in notes.items()]

    def _events(self) -> dict[str, Any]:
        """Times and states of the events, by the field names of :class:`~hhtbench.Solution`."""
        found, n = self._occurrences, self._layout.n
        if not found:
            return {}
        return {
            "t_events": tuple(np.array([o.t for o in each]) for each in found),
            "q_events": tuple(np.array([o.q for o in each]).reshape(-1, n) for each in found),
            "v_events": tuple(np.array([o.v for o in each]).reshape(-1, n) for each in found),
        }


class RowLayout:
    """Columns of a row of a step and of an output row, and the compiled interpolation between them."""

    def __init__(self, structure: Structure) -> None:
        n, m = structure.n, structure.m
        ends = tuple(accumulate((1, 1, n, n, n, m, m, structure.p)))
        self.n, self.columns = n, ends[-1]
        self.parts = tuple(map(slice, (0, *ends), ends))  #: t, h, q, v, a, lam at both ends and mu
        every = np.arange(self.columns)
        self.own = np.concatenate([every[self.parts[i]] for i in (0, 2, 3, 6, 7)])  #: t, q, v, lam at the end and mu
        cuts = pairwise(accumulate((1, n, n, m, structure.p)))
        self.output = [(slice(None), slice(*cut)) for cut in cuts]  #: q, v, lam, mu of such rows
        self.interpolate = interpolate.following(n, m)  #: threads share it: it keeps nothing


row_layout = lru_cache(RowLayout)
