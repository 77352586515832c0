"""The step of Newton's method towards the nearest consistent state, in the metric of the mass matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy import linalg

from hhtbench.arguments import Vector
from hhtbench.lowering.dynamics.kkt import solve_scaled_sparse

DEPENDENT = 1e-13  # singular values below this of the scaled matrix are roundoff of dependent rows


def closest(mass: Any, rows: Any, pull: Vector, value: Vector) -> Vector:
    """The change x (n,) of a state: least x^T M x / 2 + pull^T x subject to ``rows x = -value``.

    ``pull`` is M times how far the state is from where it came, zero for the nearest to where it is now.  Dense rows
    may depend on one another, sparse ones not.
    """
    right = -np.concatenate([pull, value])
    if isinstance(rows, sp.csr_array):
        blocks: Any = [[mass, rows.transpose()], [rows, None]]
        solved = solve_scaled_sparse(sp.block_array(blocks, format="csr"), right)
        return np.full(pull.size, np.nan) if solved is None else solved[: pull.size]
    matrix = np.block([[mass, rows.T], [rows, np.zeros((value.size, value.size))]])
    largest = np.max(np.abs(matrix), axis=1)
    size = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))
    solution, *_ = linalg.lstsq(matrix * np.outer(size, size), right * size, cond=DEPENDENT, check_finite=False)
    return np.asarray((solution * size)[: pull.size])
