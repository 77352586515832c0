"""The underlying ODE of larger constrained systems, solved by the entries of the KKT matrix, never the full one.

Used for systems of any size where a reaction that depends on v is nonlinear in lam, as the friction of a two-sided guide:
(F9) is solved by Newton's iteration from zero multipliers, so that y' is a function of t and y alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.linalg.lapack import dgesv
from scipy.sparse.linalg import splu

from hhtbench.lowering import Dynamics, compile_function, route_of
from hhtbench.lowering.compile.coloured import Indices, OftenCalled
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.lowering.dynamics.matrix_free import MatrixFree
from hhtbench.lowering.dynamics.products import matrix_free, paying_products
from hhtbench.protocol.arguments import Matrix, Vector
from solvers.forms.layout import Functions
from solvers.forms.underlying import kkt_along, rhs_jacobian_at, rhs_jacobian_function
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import recover
from solvers.kernel.kkt import Entries, kkt_of
from solvers.kernel.memory import view

MAX_DENSE = 100  # unknowns of (F9) up to which LAPACK solves for all columns of dy'/dy faster than SuperLU
BLOCK = 64  # right-hand sides solved at once by SuperLU: so many stay in cache

Solve = Callable[[float, Vector, Vector], Vector]  # (t, q, v) -> [v'; lam; mu], not finite where (F9) is singular


def eliminated_functions(dynamics: Dynamics) -> Functions:
    """Right-hand side and Jacobian of the underlying ODE; Newton's iteration where the reaction is nonlinear in lam."""
    eliminated, n = Eliminated(dynamics), dynamics.structure.n
    jacobian: Callable[..., Any]
    if dynamics.structure.linear_reaction:
        products = paying_products(dynamics)
        route = "xla" if products is None else None  # machine code of full matrices takes 9 s at 60 unknowns
        jacobian = compile_function(rhs_jacobian_function, dynamics, route=route)
    else:
        products, full = matrix_free(dynamics), compile_function(rhs_jacobian_at, dynamics)
        jacobian = lambda t, y: full(t, y, eliminated.solve(t, y[:n], y[n:]))  # noqa: E731
    if products is None:
        return Functions(eliminated.rhs, jacobian, outside=lambda differentiated: eliminated.native and not differentiated)
    derivative = Differentiated(eliminated, products, jacobian)

    def outside(differentiated: bool) -> bool:
        return eliminated.native and (not differentiated or derivative.native)

    return Functions(eliminated.rhs, derivative.rhs_jacobian, outside=outside)


class Eliminated:
    """y' as a function of y = [q; v]; not finite where (F9) is singular."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.n = dynamics.structure.n
        code = None if route_of(dynamics) == "numpy" else kkt_of(dynamics)
        self.native = code is not None  #: whether no code of XLA is called
        self.solve = _in_python(dynamics) if code is None else _in_loops(code, dynamics)

    def rhs(self, t: float, y: Vector) -> Vector:
        """y' (2n,)."""
        n = self.n
        return np.concatenate([y[n:], self.solve(t, y[:n], y[n:])[:n]])


class Differentiated:
    """dy'/dy for y = [q; v], by differentiating (F9)."""

    def __init__(self, eliminated: Eliminated, products: MatrixFree, full: Callable[[float, Vector], Matrix]) -> None:
        """``full``: the Jacobian by full matrices, used where a sparsity pattern cannot be read."""
        self._full = full
        s = products.structure
        self._solve, self._products = eliminated.solve, products
        self._n, self._size = s.n, s.n + s.m + s.p

    def rhs_jacobian(self, t: float, y: Vector) -> Matrix:
        """dy'/dy (2n, 2n), not finite where (F9) is singular."""
        n, known = self._n, self._derivative
        if known is None:
            return self._full(t, y)
        entries = known[0].packed(np.concatenate([y, self._solve(t, y[:n], y[n:])]), float(t))[self._size :]
        result = np.zeros((2 * n, 2 * n))
        result[:n, n:] = np.eye(n)
        result[n:] = self._solved(known[1], entries)[:n]
        return result

    @property
    def native(self) -> bool:
        """True if no code of XLA is called; compiles."""
        return self._derivative is not None and self._derivative[0].native

    @cached_property
    def _derivative(self) -> tuple[OftenCalled, _Places] | None:
        try:
            found = OftenCalled(kkt_along, self._products, example=(np.zeros(2 * self._n + self._size), 0.0))
        except NotImplementedError:  # a primitive of which neither the graph nor asdex knows the sparsity
            return None
        rows, columns = found.pattern.rows, found.pattern.columns
        order = np.lexsort((rows, columns))  # column by column, those of y first
        right, matrix = np.split(order, [np.searchsorted(columns[order], 2 * self._n)])
        of_matrix = columns[matrix] - 2 * self._n
        starts = np.searchsorted(of_matrix, np.arange(self._size + 1)).astype(np.int32)
        return found, _Places(right, (rows[right], columns[right]), matrix, rows[matrix], of_matrix, starts)

    def _solved(self, places: _Places, entries: Vector) -> Matrix:
        """Derivative of [v'; lam; mu] by y, (N, 2n)."""
        right = np.zeros((self._size, 2 * self._n), order="F")
        right[places.where] = -entries[places.right]
        if not np.isfinite(entries).all():
            return np.full_like(right, np.nan)
        if self._size <= MAX_DENSE:
            full = np.zeros((self._size, self._size), order="F")
            full[places.rows, places.columns] = entries[places.matrix]
            *_, solution, info = dgesv(full, right, overwrite_a=True, overwrite_b=True)
            return np.asarray(solution) if info == 0 else np.full_like(right, np.nan)
        compressed = entries[places.matrix], places.rows, places.starts
        matrix: Any = sp.csc_array(compressed, shape=(self._size, self._size))
        try:
            factor = splu(matrix)
        except RuntimeError:  # raised by SuperLU for a zero pivot
            return np.full_like(right, np.nan)
        for first in range(0, right.shape[1], BLOCK):
            part = np.s_[:, first : first + BLOCK]
            right[part] = factor.solve(right[part])
        return right


class _Places(NamedTuple):
    """Positions of the entries of the derivative of (F9) by [y; v'; lam; mu]."""

    right: Indices  #: entries of the derivative by y
    where: tuple[Indices, Indices]  #: their rows and columns
    matrix: Indices  #: entries of the KKT matrix, column by column
    rows: Indices  #: rows of these
    columns: Indices  #: columns of these
    starts: Indices  #: (N + 1,) start of each column


def _in_loops(entries: Entries, dynamics: Dynamics) -> Solve:
    """Solver of (F9) by compiled loops; where these find no root, by the more thorough iteration in Python."""
    local, n, linear = _Loops(entries, dynamics), dynamics.structure.n, dynamics.structure.linear_reaction
    closer = _in_python(dynamics)

    def solve(t: float, q: Vector, v: Vector) -> Vector:
        row = local.row
        row[0], row[1 : 1 + n], row[1 + n : 1 + 2 * n], row[1 + 2 * n :] = t, q, v, 0.0
        local.done[0] = False
        local.call()
        if local.done[0]:
            return local.x.copy()
        return np.full(local.x.size, np.nan) if linear else closer(t, q, v)

    return solve


class _Loops(threading.local):
    """Memory of the compiled loops, one for each thread."""

    def __init__(self, entries: Entries, dynamics: Dynamics) -> None:
        z = entries.memory(dynamics)
        self.x = view(z, mem.X)
        rows, self.done = np.zeros((1, 1 + dynamics.structure.n + self.x.size)), np.zeros(1, dtype=bool)
        self.row = rows[0]
        self.call = recover.following(z, rows, self.done)


def _in_python(dynamics: Dynamics) -> Solve:
    """Solver of (F9) by LAPACK, or SuperLU where the system is large."""
    level = AccelerationLevel(dynamics)

    def solve(t: float, q: Vector, v: Vector) -> Vector:
        found = level.solve(t, q, v)
        x = np.concatenate([found.vdot, found.lam, found.mu])
        return x if found.converged else np.full(x.size, np.nan)

    return solve
