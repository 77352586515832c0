"""The rows of a run with events, phase by phase."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.solution.phases import Phase
from hhtbench.solution.result import Solution
from solvers.eventful.phase import PhaseFunctions
from solvers.eventful.steps import Point

NAMES = "t", "q", "v", "lam", "mu"


class Rows:
    """Rows in the order of the motion, with the phase of each."""

    def __init__(self, n: int) -> None:
        self._n = n
        self.parts = list[tuple[int, tuple[Any, ...]]]()  #: number of the phase; t (k,), q, v (k, n), lam (k, m), mu (k, p)

    def keep(self, phase: int, part: Solution, some: slice) -> None:
        """Add ``some`` rows of a solution."""
        self.parts.append((phase, tuple(getattr(part, name)[some] for name in NAMES)))

    def add(self, phase: int, place: Point, functions: PhaseFunctions) -> None:
        """Add one row with the multipliers of the acceleration level."""
        lam, mu = functions.multipliers(place.t, place.q, place.v)
        self.parts.append((phase, (np.array([place.t]), place.q[None], place.v[None], lam[None], mu[None])))

    def at(self, times: Vector, pieces: Sequence[Any], ahead: float, solve: Callable[..., Solution]) -> Rows:
        """Rows at ``times`` (k,): each motion between changes is solved again with them.

        ``pieces``: phase, its functions, start and end [s] of each; ``ahead``: direction of time.
        """
        rows = Rows(self._n)
        if not self.parts:
            return rows
        (first, *_), last = self.parts[0][1], self.parts[-1][1][0][-1]
        if times.size and times[0] == first[0]:  # the start itself, before any change there
            rows.parts.append((0, tuple(column[:1] for column in self.parts[0][1])))
            times = times[1:]
        for i, (number, phase, start, end) in enumerate(pieces):
            closed = i == len(pieces) - 1
            end = last if closed else end
            inside = ahead * (times - start.t) >= 0
            inside &= ahead * (end - times) >= 0 if closed else ahead * (end - times) > 0
            if start.t != end and inside.any():
                rows.keep(number, solve(phase, start, end, times[inside]), slice(None))
        return rows

    def joined(self) -> dict[str, Matrix]:
        """All rows by name; multipliers that a phase does not have are zero."""
        if not self.parts:
            shapes = (0,), (0, self._n), (0, self._n), (0, 0), (0, 0)
            return {name: np.zeros(shape) for name, shape in zip(NAMES, shapes, strict=True)}
        columns = zip(*(part for _, part in self.parts), strict=True)
        return {name: np.concatenate(_widened(parts)) for name, parts in zip(NAMES, columns, strict=True)}

    def phases(self, begun: list[tuple[Any, str, Point]]) -> tuple[Phase, ...]:
        """The phases that ``begun`` with these systems, events and states."""
        counts = np.zeros(len(begun) + 1, int)
        for number, (t, *_) in self.parts:
            counts[number + 1] += t.size
        ends = np.cumsum(counts).tolist()
        return tuple(
            Phase(system=system, event=event, t=place.t, q=place.q, v=place.v, first=first, stop=stop)
            for (system, event, place), (first, stop) in zip(begun, pairwise(ends), strict=True)
        )


def _widened(parts: Sequence[Any]) -> Sequence[Any]:
    """Arrays (k, ...) with zeros added to the columns that they lack."""
    if parts[0].ndim == 1:
        return parts
    width = max(part.shape[1] for part in parts)
    return [np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in parts]
