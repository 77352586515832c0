"""Dense output: cubic Hermite polynomials through the accepted steps, (H17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import DenseOutput
from solvers.hht.equations.formulas import cubic, smooth_rise


@dataclass(frozen=True)
class HermiteOutput:
    """Dense output: q is the cubic through q and v at both ends of a step, error O(h^4); v its derivative, error O(h^3).

    Two rows with one time are an event that changed the state: before that time the output is from the first row, from
    it on from the second.
    """

    t: Vector  #: (k,) step ends, monotone
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)

    def __call__(self, t: Any) -> DenseOutput:
        """q and v at ``t``: scalar -> (n,), (j,) -> (j, n).  Raises ProblemError outside the steps."""
        times = np.atleast_1d(np.asarray(t, dtype=np.float64))
        low, high = min(self.t[0], self.t[-1]), max(self.t[0], self.t[-1])
        if not np.all((times >= low) & (times <= high)):
            raise ProblemError(f"the solution covers [{exact(low)}, {exact(high)}] s; it is not extrapolated.")
        q, v = self.at(times, self.rows_before(times))
        return DenseOutput(q[0], v[0]) if np.ndim(t) == 0 else DenseOutput(q, v)

    def rows_before(self, times: Vector) -> Any:
        """(j,) index of the last row at or before each of ``times`` (j,), in the direction of time."""
        if self.t[-1] < self.t[0]:
            return (-self.t).searchsorted(-times, side="right") - 1
        return self.t.searchsorted(times, side="right") - 1

    def at(self, times: Vector, row: Vector) -> tuple[Matrix, Matrix]:
        """q and v (j, n) at ``times`` (j,), each in the step that begins at its ``row``."""
        q, v = self.q[row], self.v[row]
        between = self.t[row] != times  # step ends are returned as they are, not as the polynomial rounds them
        i = row[between]
        if i.size:
            h = (self.t[i + 1] - self.t[i])[:, None]
            s = (times[between] - self.t[i])[:, None] / h
            v0, v1 = self.v[i], self.v[i + 1]
            rise = smooth_rise(h, self.q[i], self.q[i + 1], v0, v1)
            q[between], v[between] = cubic(s, h, self.q[i], rise, v0, v1)
        return q, v
