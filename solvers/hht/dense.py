"""Dense output: cubic Hermite polynomials through the accepted steps, (H17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import ProblemError
from hhtbench.result import DenseOutput


@dataclass(frozen=True)
class HermiteOutput:
    """q is the cubic through q and v at both ends of a step, error O(h^4); v its derivative, error O(h^3)."""

    t: Vector  #: (k,) step ends, monotone
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)

    def __call__(self, t: Any) -> DenseOutput:
        """q and v at ``t``: scalar -> (n,), (j,) -> (j, n).  Times outside the steps are refused."""
        times = np.atleast_1d(np.asarray(t, dtype=np.float64))
        low, high = min(self.t[0], self.t[-1]), max(self.t[0], self.t[-1])
        if not np.all((times >= low) & (times <= high)):
            raise ProblemError(f"the solution covers [{low:.17g}, {high:.17g}] s; it is not extrapolated.")
        q, v = self._evaluate(times)
        return DenseOutput(q[0], v[0]) if np.ndim(t) == 0 else DenseOutput(q, v)

    def _evaluate(self, times: Vector) -> tuple[Matrix, Matrix]:
        if self.t.size == 1:
            return np.repeat(self.q, times.size, axis=0), np.repeat(self.v, times.size, axis=0)
        direction = -1.0 if self.t[-1] < self.t[0] else 1.0
        i = np.clip(np.searchsorted(direction * self.t, direction * times, side="left") - 1, 0, self.t.size - 2)
        h = (self.t[i + 1] - self.t[i])[:, None]
        s = (times - self.t[i])[:, None] / h
        rise = self.q[i + 1] - self.q[i]
        v0, v1 = self.v[i], self.v[i + 1]
        # (H17)
        q = self.q[i] + s * (h * v0 + s * (3 * rise - h * (2 * v0 + v1) + s * (h * (v0 + v1) - 2 * rise)))
        v = v0 + s * (2 * (3 * rise / h - 2 * v0 - v1) + 3 * s * (v0 + v1 - 2 * rise / h))
        at_end = s[:, 0] == 1.0  # step ends are returned as they are, not as the polynomial rounds them
        q[at_end], v[at_end] = self.q[i + 1][at_end], self.v[i + 1][at_end]
        return q, v
