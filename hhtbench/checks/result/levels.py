"""Are the rows on the constraints, and do these lose rank where multipliers are nan?

How far rows are off is measured by the bench; here only whether it can be believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hhtbench.lowering import ConstraintLevels, Dynamics, derive
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.system import Problem
from hhtbench.solution.counting import Clock
from hhtbench.solution.request import Request
from hhtbench.solution.result import Solution

BELIEVABLE = 0.1  # violation in units of the typical size: beyond it the rows show another mechanism
DRIFT = 1e4  # times the relative tolerance: what forms that differentiate the constraints may drift in a long interval
CHECKED_ROWS = 200  # the last one included: more would cost more than the steps
SLOW_ROWS = 3  # of systems without machine code, where a row costs as much as a residual
NUMBERS = 40_000  # of the constraint levels of all rows that are checked by machine code: a fraction of a millisecond
LOST = 1e-2  # of a singular value elsewhere: below it no digit of multipliers need be known
ALWAYS = 1e-10  # of the largest singular value: those of redundant constraints are always below
ELSEWHERE = 20  # rows that show what singular values are elsewhere
BESIDE = 1e-3  # of the largest component: solvers measure the errors of small ones by what is beside them

Rows = tuple[Vector, Matrix, Matrix]  # t (k,), q and v (k, n)
_known = Cache(16)


class Levels(NamedTuple):
    """One kind of constraint at some rows."""

    name: str
    values: Matrix  #: (k, number of constraints)
    sizes: Matrix  #: the same, what Jacobians make of typical sizes
    bound: float  #: the largest violation, in units of its size, that is believed


def believable(request: Request) -> float:
    """The largest violation, in units of the typical size, of a solver that does what ``request`` asks."""
    rtol = request.rtol
    if type(rtol) is not float:
        rtol = 0.0 if rtol is None else float(np.max(rtol))
    return min(BELIEVABLE, DRIFT * rtol) if rtol > 0.0 else BELIEVABLE


def spread(count: int, limit: int = CHECKED_ROWS) -> NDArray[np.intp]:
    """Up to ``limit`` of ``count`` rows, evenly spread, the first and the last among them."""
    size = min(count, limit)
    return np.arange(size) * (count - 1) // max(size - 1, 1)


def violated(
    problem: Problem,
    request: Request,
    rows: tuple[Vector, Matrix, Matrix],
    *,
    deep: bool = False,
    clock: Clock | None = None,
) -> str:
    """Which constraint the rows t (k,), q and v (k, n) leave most, when and by how much; "" where it is believable.

    Parameters
    ----------
    deep
        Check up to ``CHECKED_ROWS``, of slow and large systems too.
    clock
        No further row of such a system is checked when its time is over.
    """
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    if not (dynamics.structure.constrained and rows[0].size):
        return ""
    at: AtRows = _known.find(by_id(dynamics), lambda: AtRows(dynamics))
    try:
        t, found = at.levels(problem, believable(request), rows, deep, clock)
    except NonFiniteValue as error:
        return f"constraints: {error}."
    for levels in found:
        if doubt := _beyond(levels, t):
            return doubt
    return ""


def _beyond(levels: Levels, t: Vector) -> str:
    """The largest violation, as a sentence; "" where it is within the bound."""
    over = np.abs(levels.values) / np.where(levels.sizes > 0.0, levels.sizes, 1.0)
    if np.maximum.reduce(over, axis=None) <= levels.bound:
        return ""
    row, i = np.unravel_index(int(np.argmax(over)), over.shape)  # the first that is not a number, if there is one
    return (
        f"constraints: {levels.name.format(i)} is violated by up to {over[row, i]:.2g} of its size, most at "
        f"t = {t[row]:.17g}; up to {levels.bound:.2g} is believed."
    )


class AtRows:
    """The constraint levels of one system at many rows: by machine code in one call, else one row after the other."""

    def __init__(self, dynamics: Dynamics) -> None:
        s = dynamics.structure
        self.n, self.m, self.p = n, m, p = s.n, s.m, s.p
        self._at = ConstraintLevels(dynamics)
        self._terms = self._at.at_rows()
        ends = list(accumulate((m, m, m * n, p, p * n, m)))
        #: where machine code puts g, g_t, g_q, k, k_v and g_t + g_q v
        self._g, self._g_t, self._g_q, self._k, self._k_v, self._drift = map(slice, [0, *ends], ends)

    def levels(
        self, problem: Problem, bound: float, rows: Rows, deep: bool, clock: Clock | None
    ) -> tuple[Vector, list[Levels]]:
        """The times of the rows that are checked, of many more if ``deep``, and what is not plainly within its bound."""
        fast = SLOW_ROWS if self._terms is None else max(SLOW_ROWS, NUMBERS // (self.n * (self.m + self.p)))
        limit = CHECKED_ROWS if deep else min(CHECKED_ROWS, fast)
        if len(rows[0]) > limit:
            some = spread(len(rows[0]), limit)
            rows = rows[0][some], rows[1][some], rows[2][some]
        t, q, v = _numbers(rows[0]), _numbers(rows[1]), _numbers(rows[2])
        if self._terms is None:
            return t, self._one_by_one(problem, bound, (t, q, v), clock)
        found = self._terms(t, q, v)
        return t, [] if self._plainly_hold(problem, bound, found) else self._together(problem, bound, v, found)

    def _plainly_hold(self, problem: Problem, bound: float, found: Matrix) -> bool:
        """Whether all constraints hold by the declared scales, in a third of the time that it takes to find the largest."""
        n, m, p, count = self.n, self.m, self.p, len(found)
        allowed, held = np.empty((n, 2)), 0
        sizes: Any
        allowed[:, 0], allowed[:, 1] = problem.scales.q, problem.scales.v
        allowed *= bound
        found = np.abs(found)
        if m:
            sizes = (found[:, self._g_q].reshape(-1, n) @ allowed).reshape(count, m, 2)
            held += int(np.count_nonzero(found[:, self._g] <= sizes[:, :, 0]))
            held += int(np.count_nonzero(found[:, self._drift] <= sizes[:, :, 1]))
        if p:
            sizes = (found[:, self._k_v].reshape(-1, n) @ allowed[:, 1]).reshape(count, p)
            held += int(np.count_nonzero(found[:, self._k] <= sizes))
        return held == count * (2 * m + p)

    def _together(self, problem: Problem, bound: float, v: Matrix, found: Matrix) -> list[Levels]:
        """Of what machine code has ``found`` at every row."""
        s_q, s_v, fastest = _sizes(problem, v)
        of_g, of_k = (np.abs(found[:, part]).reshape(len(found), -1, self.n) for part in (self._g_q, self._k_v))
        values = found[:, self._g], found[:, self._drift], found[:, self._k]
        return _of_kinds(values, (of_g @ s_q, of_g @ fastest + np.abs(found[:, self._g_t]), of_k @ s_v), bound)

    def _one_by_one(self, problem: Problem, bound: float, rows: Rows, clock: Clock | None) -> list[Levels]:
        """The same in Python."""
        m, (s_q, s_v, fastest) = self.m, _sizes(problem, rows[2])
        values, sizes = np.zeros((2, rows[0].size, 2 * m + self.p))
        for row, (t, q, v) in enumerate(zip(rows[0].tolist(), *rows[1:], strict=True)):
            if clock is not None and clock.left() < 0.0:
                break
            at = self._at.at(t, q, v)
            jacobian = np.abs(at.position_jacobian)
            values[row] = np.concatenate([at.position, at.velocity_drift])
            of_velocity = jacobian @ fastest + np.abs(at.time_derivative)
            sizes[row] = np.concatenate([jacobian @ s_q, of_velocity, np.abs(at.velocity_jacobian) @ s_v])
        parts = [m, 2 * m]
        return _of_kinds(np.split(values, parts, axis=1), np.split(sizes, parts, axis=1), bound)


def _of_kinds(values: Sequence[Matrix], sizes: Sequence[Matrix], bound: float) -> list[Levels]:
    """Of position constraints, of their velocity level and of velocity constraints, as far as there are any."""
    names, bounds = ("g[{}]", "the velocity level g_t + g_q v of g[{}]", "k[{}]"), (bound, BELIEVABLE, bound)
    return [Levels(*one) for one in zip(names, values, sizes, bounds, strict=True) if one[1].size]


def _numbers(part: Any) -> Any:
    """``part`` of the rows as float64 that follow one another in every row."""
    if part.dtype == np.float64 and part.strides[-1] == part.itemsize:
        return part
    return np.ascontiguousarray(part, dtype=np.float64)


def _sizes(problem: Problem, v: Matrix) -> tuple[Vector, Vector, Vector]:
    """Typical sizes of q and v, and of the velocities that the rows ``v`` (k, n) have, (n,) each.

    Forms of index 3 and 1 do not keep the velocity level: it is measured by the last.
    """
    s_q, s_v = np.zeros((2, problem.q0.size))
    s_q += problem.scales.q
    s_v += problem.scales.v
    fastest = np.maximum(np.maximum.reduce(np.abs(v), axis=0), s_v)
    return s_q, s_v, np.maximum(fastest, BESIDE * np.maximum.reduce(fastest))


def sizes_of(problem: Problem, q: Matrix, v: Matrix) -> Vector:
    """Typical sizes of y = [q, v] (2n,): the largest of the rows ``q`` and ``v`` (k, n), or the declared scales."""
    n, parts = problem.q0.size, []
    for rows, scale in ((q, problem.scales.q), (v, problem.scales.v)):
        size = np.maximum(np.max(np.abs(rows), axis=0), np.broadcast_to(np.asarray(scale, dtype=np.float64), (n,)))
        parts.append(np.maximum(size, BESIDE * np.max(size)))
    return np.concatenate(parts)


def unknown_without_reason(problem: Problem, solution: Solution, clock: Clock | None = None) -> str:
    """Which row has nan for a multiplier although no constraint there depends on others; "" where none has.

    Compared are singular values of [g_q; k_v], with columns of typical velocities and rows over their largest size in the
    run, with the largest of the same order at a few rows and at the start, until the time of ``clock`` is over.
    """
    unknown = np.flatnonzero(solution.unknown)
    if not unknown.size:
        return ""
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0))
    size = sizes_of(problem, solution.q, solution.v)[levels.structure.n :]

    def rows_at(i: int) -> Matrix:
        rows = levels.at(float(solution.t[i]), solution.q[i], solution.v[i]).rows
        return _full(rows) * size

    try:
        start = _full(levels.at(problem.t_span[0], problem.q0, problem.v0).rows) * size
        places = [start, *map(rows_at, np.linspace(0, solution.t.size - 1, ELSEWHERE).round().astype(int).tolist())]
        largest = np.max([np.max(np.abs(rows), axis=1) for rows in places], axis=0)[:, None]
        over = np.where(largest > 0.0, largest, 1.0)
        elsewhere = np.max([_singular_values(rows / over) for rows in places], axis=0)
        some = elsewhere > ALWAYS * elsewhere[0]
        for i in unknown[spread(unknown.size)].tolist():
            if clock is not None and clock.left() < 0.0:
                return ""
            least = float(np.min(_singular_values(rows_at(i) / over)[some] / elsewhere[some]))
            if least > LOST:
                return (
                    f"finiteness: multipliers are nan in row {i} of {solution.t.size}, where constraints keep their rank: "
                    f"every singular value is at least {least:.2g} of what it is elsewhere; below {LOST:g} is believed."
                )
    except NonFiniteValue as error:
        return f"constraints: {error}."
    return ""


def _full(rows: Matrix) -> Matrix:
    return np.asarray(rows.toarray() if hasattr(rows, "toarray") else rows)


def _singular_values(rows: Matrix) -> Vector:
    """In falling order."""
    return np.asarray(np.linalg.svd(rows, compute_uv=False), dtype=np.float64)
