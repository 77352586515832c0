"""How large the states of a solution are: what its errors are measured by."""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import Problem

BESIDE = 1e-3  # of the largest component: solvers measure the errors of small ones by what is beside them


def sizes_of(problem: Problem, q: Matrix, v: Matrix) -> Vector:
    """Typical sizes of y = [q, v] (2n,): the largest of the rows ``q`` and ``v`` (k, n), or the declared scales."""
    n, parts = problem.q0.size, []
    for rows, scale in ((q, problem.scales.q), (v, problem.scales.v)):
        size = np.maximum(np.max(np.abs(rows), axis=0), np.broadcast_to(np.asarray(scale, dtype=np.float64), (n,)))
        parts.append(np.maximum(size, BESIDE * np.max(size)))
    return np.concatenate(parts)
