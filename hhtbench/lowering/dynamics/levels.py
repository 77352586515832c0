"""Position and velocity levels of the constraints at a point, with Jacobians, for starts, drift and rank."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import scipy.sparse as sp

from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.compile.routes import route_of, too_large
from hhtbench.lowering.dynamics.dynamics import Dynamics
from hhtbench.lowering.dynamics.products import large
from hhtbench.protocol.arguments import Matrix, Vector

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.rank import ConstraintRank

CONSISTENT = 1e-8  # misfit up to which a start counts as consistent, for solvers and for the check: eight digits of data


class Misfit(NamedTuple):
    """Violation of one constraint row at a start."""

    name: str
    value: float
    relative: float  #: in units of the largest coordinate or velocity there


@dataclass(frozen=True)
class Levels:
    """Constraint values and Jacobians at one point."""

    position: Vector  #: (m,) g
    time_derivative: Vector  #: (m,) g_t
    position_jacobian: Any  #: (m, n) g_q, sparse for large systems
    velocity: Vector  #: (p,) k
    velocity_jacobian: Any  #: (p, n) k_v, likewise
    velocity_drift: Vector  #: (m + p,) g_t + g_q v, then k
    finite: bool = False  #: True: all of it is known to be

    @property
    def ranked(self) -> bool:
        """True if a rank is defined: every entry is finite, and no row is zero."""
        sizes = np.asarray(np.abs(self.rows).sum(axis=1))
        return bool((np.isfinite(sizes) & (sizes > 0.0)).all())

    @cached_property
    def rank(self) -> ConstraintRank:
        """Rank of [g_q; k_v]."""
        from hhtbench.lowering.dynamics.rank import constraint_rank  # starts that are plainly good are not asked for it

        return constraint_rank(self.rows)

    @cached_property
    def rows(self) -> Any:
        """[g_q; k_v] (m + p, n)."""
        blocks = [self.position_jacobian, self.velocity_jacobian]
        return sp.vstack(blocks, format="csr") if sp.issparse(blocks[0]) else np.concatenate(blocks, axis=0)

    def scaled_position(self, s_q: Any) -> Vector:
        """|g_i| / sum_j |g_q,ij| s_q,j, (m,): the distance from the constraint in units of the typical size."""
        jacobian = self.position_jacobian
        return _relative(self.position, np.abs(jacobian) @ _spread(s_q, jacobian.shape[1]))

    def scaled_velocity(self, s_v: Any) -> Vector:
        """The velocity level, |g_t + g_q v| and |k|, each over its row's size; (m + p,)."""
        rows = self.rows
        size = np.abs(rows) @ _spread(s_v, rows.shape[1])
        size[: self.time_derivative.size] += np.abs(self.time_derivative)
        return _relative(self.velocity_drift, size)

    def hold(self, q: Vector, v: Vector, bound: float) -> bool:
        """True if no row is violated at the start (q, v) by more than half of ``bound``; see :meth:`misfits` for details."""
        sizes, m = 0.5 * bound * np.asarray(np.abs(self.rows).sum(axis=1)), self.position.size
        close = np.abs(self.position) <= sizes[:m] * size_of(q)
        return bool(close.all() and (np.abs(self.velocity_drift) <= sizes * size_of(v)).all())

    def misfits(self, q: Vector, v: Vector) -> tuple[list[Misfit], list[Misfit]]:
        """Violations of all rows at the start (q, v), at the position level and at the velocity level."""
        m, p = self.position.size, self.velocity.size
        names = [f"(g_t + g_q v)[{i}]" for i in range(m)] + [f"k[{i}]" for i in range(p)]
        position = zip([f"g[{i}]" for i in range(m)], self.position, self.scaled_position(size_of(q)), strict=True)
        velocity = zip(names, self.velocity_drift, self.scaled_velocity(size_of(v)), strict=True)
        return [Misfit(*row) for row in position], [Misfit(*row) for row in velocity]


_Found = tuple[float, Vector, Vector, Levels]  # t, q, v and what was found there


def size_of(x: Vector) -> float:
    """Largest magnitude; one where all entries are zero."""
    return (float(np.abs(x).max()) if x.size else 0.0) or 1.0


class ConstraintLevels:
    """Evaluates :class:`Levels` of one system; calls nothing of a level that is not declared."""

    def __init__(self, dynamics: Dynamics, *, full: bool = False) -> None:
        """``full``: Jacobians are full arrays also for large systems."""
        s, self._dynamics = dynamics.structure, dynamics
        self.structure = s
        self._pure, self._last = route_of(dynamics) != "numpy", cast("_Found | None", None)
        products = large(dynamics) if s.constrained and not full else None
        if products is None:
            self._sparse, self._terms = None, compile_function(level_terms, dynamics)
        else:
            self._sparse = products.coloured(stacked_levels, (np.zeros(2 * s.n), 0.0, np.zeros(s.n)))
            self._rates = compile_function(level_rates, products, route="xla")

    def at(self, t: float, q: Vector, v: Vector) -> Levels:
        """The constraint levels at (t, q, v)."""
        last = self._last
        if last is not None and last[0] == t and last[1] is q and last[2] is v:
            return last[3]
        found = self._at(t, q, v)
        frozen = all(x.base is None and not x.flags.writeable for x in (q, v))  # a view follows what it shows
        if self._pure and frozen:  # a start is looked at several times
            self._last = t, q, v, found
        return found

    def at_rows(self) -> Callable[[Any, Any, Any], Matrix] | None:
        """:func:`level_terms` at many rows t (k,), q and v (k, n) in one call; None without machine code for it."""
        if not self._pure or too_large(self._dynamics) is not None:
            return None
        from hhtbench.lowering.scalar_compiler import NotNative, at_rows, native  # plain callables do without

        try:
            return at_rows(native(level_terms, self._dynamics, shapes=((), (self.structure.n,), (self.structure.n,))))
        except NotNative:
            return None

    def _at(self, t: float, q: Vector, v: Vector) -> Levels:
        n, m, p = self.structure.n, self.structure.m, self.structure.p
        if self._sparse is not None:
            values, matrix = self._sparse(np.concatenate([q, v]), t, q)
            rates = self._rates(t, q, v) if m else np.zeros(0)
            drift = np.concatenate([rates[m:], values[m:]])
            return Levels(values[:m], rates[:m], matrix[:m, :n], values[m:], matrix[m:, n:], drift)
        x = np.asarray(self._terms(t, q, v)) if m + p else np.zeros(0)
        k, k_v, end = (2 + n) * m, (2 + n) * m + p, (2 + n) * m + p + n * p
        jacobians = x[2 * m : k].reshape(m, n), x[k_v:end].reshape(p, n)
        return Levels(x[:m], x[m : 2 * m], jacobians[0], x[k:k_v], jacobians[1], x[end:], bool(np.isfinite(x).all()))


def level_terms(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """g, g_t, g_q, k, k_v and the velocity level, packed into one vector."""
    s, xp = dynamics.structure, dynamics.xp
    terms, drift = [], []
    if s.m:
        jacobian = dynamics.constraint_jacobian(t, q)
        g_t = dynamics.constraint_time_derivative(t, q) if s.rheonomic else xp.zeros(s.m)
        terms += [dynamics.constraint(t, q), g_t, jacobian.ravel()]
        drift.append(jacobian @ v + g_t)
    if s.p:
        k = dynamics.velocity_constraint(t, q, v)
        terms += [k, dynamics.velocity_constraint_jacobian(t, q, v).ravel()]
        drift.append(k)
    return xp.concatenate([*terms, *drift])


def stacked_levels(dynamics: Dynamics, y: Any, t: Any, q: Any) -> Any:
    """g at ``y[:n]`` and k at (q, ``y[n:]``), (m + p,), whose derivative by y is [g_q 0; 0 k_v]."""
    s = dynamics.structure
    parts = [dynamics.constraint(t, y[: s.n])] if s.m else []
    return dynamics.xp.concatenate([*parts, dynamics.velocity_constraint(t, q, y[s.n :])] if s.p else parts)


def level_rates(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """g_t and g_t + g_q v, packed into one vector (2 m,)."""
    return dynamics.xp.concatenate([dynamics.constraint_time_derivative(t, q), dynamics.constraint_velocity(t, q, v)])


def _spread(size: Any, n: int) -> Vector:
    """Expand a number to ``n`` coordinates; (n,) stays as it is."""
    return np.full(n, size) if type(size) is float else np.broadcast_to(size, n)


def _relative(value: Vector, size: Vector) -> Vector:
    """|value| / size; a row without size counts as itself."""
    return np.abs(value) / np.where(size > 0, size, 1.0)
