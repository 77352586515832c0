"""Operation counts of one residual and of one acceleration of a system, independent of the machine.

An acceleration solves (H16) for v', lam and mu, and so needs the matrix and its factorisation; a residual does not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.coloured import Indices, find_pattern
from hhtbench.lowering.compile.routes import MAX_UNKNOWNS, route_of
from hhtbench.lowering.dynamics.derive import derive
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure
from hhtbench.lowering.dynamics.kkt_rows import kkt_residual, kkt_terms
from hhtbench.lowering.dynamics.matrix_free import kkt_entries
from hhtbench.lowering.dynamics.products import matrix_free
from hhtbench.lowering.scalar_compiler import NotNative, count_operations, places_of
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import NumpySystem, System

_counted = Cache(64)  # a second for some mechanisms


def operations(system: System | NumpySystem, t: float, q: Vector, v: Vector) -> dict[str, int] | None:
    """Numbers of operations of one residual and of one acceleration of ``system``, by name.

    None where its functions cannot be read, or determine no acceleration.
    For a reaction nonlinear in the multipliers, one iteration of Newton's method counts as an acceleration.
    """
    dynamics = derive(system, t, q, v)
    found: dict[str, int] | None = _counted.find(by_id(dynamics), lambda: _operations(dynamics))
    return found


def _operations(dynamics: Any) -> dict[str, int] | None:
    s = dynamics.structure
    if route_of(dynamics) == "numpy":
        return None
    if s.n + s.m + s.p > MAX_UNKNOWNS:
        dynamics = matrix_free(dynamics) or dynamics
    try:
        residual = count_operations(kkt_residual, dynamics, shapes=((s.n + s.m + s.p,), (), (s.n,), (s.n,)))
        return {"residual": residual, "acceleration": _of_acceleration(dynamics, s)}
    except (NotNative, NotImplementedError, RuntimeError):  # a pattern that cannot be read; SuperLU: it is singular
        return None


def _of_acceleration(dynamics: Dynamics, s: Structure) -> int:
    """Operations of residual and matrix together, and of the linear solve."""
    size, vector = s.n + s.m + s.p, (s.n,)
    shapes = (), vector, vector, (size,)
    if dynamics.matrices:
        made = count_operations(kkt_terms, dynamics, shapes=shapes)
        places = places_of(kkt_terms, dynamics, shapes=shapes)
        rows, columns = np.divmod(places[places >= size] - size, size)
    else:
        pattern = find_pattern(kkt_residual, dynamics, example=(np.zeros(size), 0.0, np.zeros(s.n), np.zeros(s.n)))
        made = count_operations(kkt_entries, dynamics, pattern, shapes=shapes)
        rows, columns = pattern.rows, pattern.columns
    factors, solve = _of_solve(rows, columns, size)
    return made + solve + (factors if s.constrained or s.mass == "variable" else 0)


def _of_solve(rows: Indices, columns: Indices, size: int) -> tuple[int, int]:
    """Operations of factorising a matrix of this pattern by SuperLU, and of one solve.

    An elimination step divides the column below its pivot and subtracts it from as many columns as the row has entries.
    """
    values = 1.0 + np.random.default_rng(0).random(rows.size)
    made = splu(sp.csc_array((values, (rows, columns)), shape=(size, size)))
    below = np.diff(made.L.tocsc().indptr) - 1
    beside = np.diff(made.U.tocsr().indptr) - 1
    return int(np.sum(below * (1 + 2 * beside))), int(2 * (below.sum() + beside.sum()) + size)
