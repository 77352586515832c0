"""Are the rows on the constraints?  How far they are off is measured by the bench; here only whether it can be believed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Clock
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Dynamics, NotNative, at_rows, derive, native, route_of, too_large
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.trust.sizes import BESIDE

BELIEVABLE = 0.1  # violation in units of the typical size: beyond it the rows show another mechanism
DRIFT = 1e4  # times the relative tolerance: what forms that differentiate the constraints may drift in a long interval
CHECKED_ROWS = 200  # the last one included: more would cost more than the steps
SLOW_ROWS = 20  # of systems without machine code, where a row costs as much as a residual
NUMBERS = 40_000  # of the constraint levels of all rows that are checked by machine code: a fraction of a millisecond

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


def spread(count: int, most: int = CHECKED_ROWS) -> NDArray[np.intp]:
    """Up to ``most`` of ``count`` rows, evenly spread, the first and the last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)


def violated(
    problem: Problem, request: Request, rows: tuple[Vector, Matrix, Matrix], *, deep: bool = False, clock: Clock | None = None
) -> str:
    """Which constraint the rows t (k,), q and v (k, n) leave most, when and by how much; "" where it is believable.

    Parameters
    ----------
    deep
        Check up to ``CHECKED_ROWS`` of systems without machine code too.
    clock
        No further row of such a system is checked when its time is over.
    """
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    if not (dynamics.structure.constrained and rows[0].size):
        return ""
    at: AtRows = _known.find(by_id(dynamics), lambda: AtRows(dynamics))
    try:
        t, found = at.levels(problem, believable(request), rows, CHECKED_ROWS if deep else SLOW_ROWS, clock)
    except NonFiniteValue as error:
        return f"constraints: {error}."
    return next(filter(None, (_beyond(one, t) for one in found)), "")


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
        s = self._structure = dynamics.structure
        self._levels, self._terms = ConstraintLevels(dynamics), None
        if route_of(dynamics) != "numpy" and too_large(dynamics) is None:
            try:
                self._terms = at_rows(native(level_terms, dynamics, shapes=((), (s.n,), (s.n,))))
            except NotNative:
                pass

    def levels(
        self, problem: Problem, bound: float, rows: tuple[Vector, Matrix, Matrix], slow_rows: int, clock: Clock | None
    ) -> tuple[Vector, Iterator[Levels]]:
        """The times of the rows that are checked, and what is found there."""
        s = self._structure
        most = slow_rows if self._terms is None else min(CHECKED_ROWS, max(SLOW_ROWS, NUMBERS // (s.n * (s.m + s.p))))
        if len(rows[0]) > most:
            some = spread(len(rows[0]), most)
            rows = rows[0][some], rows[1][some], rows[2][some]
        t, q, v = [_numbers(part) for part in rows]
        if self._terms is None:
            return t, self._one_by_one(bound, _sizes(problem, v), (t, q, v), clock)
        found = self._terms(t, q, v)
        return t, iter(()) if self._plainly_hold(problem, bound, found) else self._together(bound, _sizes(problem, v), found)

    def _plainly_hold(self, problem: Problem, bound: float, found: Matrix) -> bool:
        """Whether all constraints hold by the declared scales, in a third of the time that it takes to find the largest."""
        n, m, p, count = self._structure.n, self._structure.m, self._structure.p, len(found)
        scales, k, end = problem.scales, (2 + n) * m, (2 + n) * m + p + n * p
        allowed = np.empty((n, 2))
        allowed[:, 0], allowed[:, 1] = scales.q, scales.v
        allowed *= bound
        found = np.abs(found)
        positions, velocities, left = found[:, :m], found[:, end : end + m], 0
        if m:
            sizes = (found[:, 2 * m : k].reshape(-1, n) @ allowed).reshape(count, m, 2)
            left = 2 * count * m - np.count_nonzero(positions <= sizes[:, :, 0]) - np.count_nonzero(velocities <= sizes[:, :, 1])
        if p and not left:
            sizes = (found[:, k + p : end].reshape(-1, n) @ allowed[:, 1]).reshape(count, p)
            left = count * p - np.count_nonzero(found[:, k : k + p] <= sizes)
        return not left

    def _together(self, bound: float, sizes: Any, found: Matrix) -> Iterator[Levels]:
        """Of what machine code has ``found`` at every row: g, g_t, g_q, k, k_v and the velocity level."""
        n, m, p, count = self._structure.n, self._structure.m, self._structure.p, len(found)
        s_q, s_v, fastest = sizes
        k, k_v, end = (2 + n) * m, (2 + n) * m + p, (2 + n) * m + p + n * p
        if m:
            jacobian = np.abs(found[:, 2 * m : k].reshape(count, m, n))
            yield Levels("g[{}]", found[:, :m], jacobian @ s_q, bound)
            of_velocities = jacobian @ fastest + np.abs(found[:, m : 2 * m])
            yield Levels("the velocity level g_t + g_q v of constraint {}", found[:, end : end + m], of_velocities, BELIEVABLE)
        if p:
            yield Levels("k[{}]", found[:, k:k_v], np.abs(found[:, k_v:end].reshape(count, p, n)) @ s_v, bound)

    def _one_by_one(
        self, bound: float, sizes: Any, rows: tuple[Vector, Matrix, Matrix], clock: Clock | None
    ) -> Iterator[Levels]:
        """The same in Python."""
        m, p, count = self._structure.m, self._structure.p, rows[0].size
        kinds = np.zeros((2, count, 2 * m + p))  # values, sizes: of g, of g_t + g_q v, of k
        s_q, s_v, fastest = sizes
        for row, (t, q, v) in enumerate(zip(rows[0].tolist(), *rows[1:], strict=True)):
            if clock is not None and clock.left() < 0.0:
                break
            at = self._levels.at(t, q, v)
            jacobian = np.abs(at.position_jacobian)
            kinds[0, row] = np.concatenate([at.position, at.velocity_drift])
            kinds[1, row, :m] = jacobian @ s_q
            kinds[1, row, m : 2 * m] = jacobian @ fastest + np.abs(at.time_derivative)
            kinds[1, row, 2 * m :] = np.abs(at.velocity_jacobian) @ s_v
        position, velocity, k = np.split(kinds, [m, 2 * m], axis=2)
        yield Levels("g[{}]", *position, bound)
        yield Levels("the velocity level g_t + g_q v of constraint {}", *velocity, BELIEVABLE)
        yield Levels("k[{}]", *k, bound)


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
