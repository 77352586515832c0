"""Dense output over the runs of a solver between events."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import DenseOutput, Solution


@dataclass(frozen=True)
class Joined:
    """Interpolants of runs that follow one another; at the time of a change the state after it."""

    starts: Vector  #: (k,) times [s] at which the runs begin
    outputs: tuple[Callable[[Any], DenseOutput], ...]  #: (k,)
    end: float  #: [s]

    def __call__(self, t: Any) -> DenseOutput:
        """State at ``t``: scalar -> (n,) arrays, (k,) -> (k, n) arrays."""
        times = np.atleast_1d(np.asarray(t, dtype=np.float64))
        low, high = sorted((float(self.starts[0]), self.end))
        if not np.all((times >= low) & (times <= high)):
            raise ProblemError(f"the solution covers [{exact(low)}, {exact(high)}] s; it is not extrapolated.")
        ahead = 1.0 if self.end >= self.starts[0] else -1.0
        which = np.clip(np.searchsorted(ahead * self.starts, ahead * times, side="right") - 1, 0, None)
        rows = [self.outputs[i](float(at)) for i, at in zip(which, times, strict=True)]
        found = DenseOutput(np.array([row.q for row in rows]), np.array([row.v for row in rows]))
        return DenseOutput(found.q[0], found.v[0]) if np.ndim(t) == 0 else found


def joined(runs: Sequence[Solution], end: float) -> Joined | None:
    """Dense output of runs, the last of which holds up to ``end`` [s]; None without any."""
    if not runs:
        return None
    return Joined(np.array([run.t[0] for run in runs]), tuple(run.interpolant for run in runs), end)  # type: ignore[misc]
