"""Check whether the rows satisfy the constraints at both levels, up to a believable violation."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from hhtbench.lowering import ConstraintLevels, Dynamics, derive
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.solution.counting import Clock
from hhtbench.solution.request import Request

BELIEVABLE = 0.1  # violation in units of the typical size: beyond it the rows show another mechanism
DRIFT = 1e4  # times the relative tolerance: drift allowed to forms that differentiate the constraints
CHECKED_ROWS = 200  # the last one included: more would cost more than the steps
SLOW_ROWS = 3  # rows checked for systems without machine code, where a row costs as much as a residual
NUMBERS = 40_000  # most numbers of constraint levels that machine code evaluates in a check: a fraction of a millisecond
BESIDE = 1e-3  # share of the largest component by which smaller ones are scaled at least, as solvers do

Rows = tuple[Vector, Matrix, Matrix]  # t (k,), q and v (k, n)
_known = Cache(16)


def believable(request: Request) -> float:
    """Return the largest violation, in units of the typical size, expected of a solver that meets ``request``."""
    rtol = request.rtol
    if type(rtol) is not float:
        rtol = 0.0 if rtol is None else float(np.max(rtol))
    return min(BELIEVABLE, DRIFT * rtol) if rtol > 0.0 else BELIEVABLE


def spread(count: int, limit: int = CHECKED_ROWS) -> NDArray[np.intp]:
    """Return up to ``limit`` of ``count`` rows, evenly spread, the first and the last among them."""
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
    """Describe the largest violation of a constraint by the rows t (k,), q and v (k, n); "" if it is believable.

    Parameters
    ----------
    deep
        Check up to ``CHECKED_ROWS``, also for slow and large systems.
    clock
        Its time ends the check of further rows of such a system.
    """
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    s = dynamics.structure
    if not (s.constrained and rows[0].size):
        return ""
    at, bound = at_rows(dynamics), believable(request)
    fast = SLOW_ROWS if at.slow else max(SLOW_ROWS, NUMBERS // (s.n * (s.m + s.p)))
    limit = CHECKED_ROWS if deep else min(CHECKED_ROWS, fast)
    if len(rows[0]) > limit:
        some = spread(len(rows[0]), limit)
        rows = rows[0][some], rows[1][some], rows[2][some]
    t, q, v = (np.ascontiguousarray(part, dtype=np.float64) for part in rows)
    try:
        found = at.computed((t, q, v))
        if found is not None and at.hold(found, problem.scales, bound):
            return ""
        s_q, s_v = declared_sizes(problem)
        # forms of index 3 and 1 do not keep the velocity level: it is measured by the velocities that there are
        values, sizes = at.measured((t, q, v), (s_q, s_v, _moving(v, s_v)), clock, found)
    except NonFiniteValue as error:
        return f"constraints: {error}."
    over = np.abs(values) / np.where(sizes > 0.0, sizes, 1.0)
    bounds = np.array([bound] * s.m + [BELIEVABLE] * s.m + [bound] * s.p)
    if np.count_nonzero(over <= bounds) == over.size:
        return ""
    row, i = np.unravel_index(int(np.argmax(over / bounds)), over.shape)  # the first that is not a number, if there is one
    name = (
        f"k[{i - 2 * s.m}]" if i >= 2 * s.m else f"g[{i}]" if i < s.m else f"the velocity level g_t + g_q v of g[{i - s.m}]"
    )
    return (
        f"constraints: {name} is violated by up to {over[row, i]:.2g} of its size, most at t = {exact(t[row])}; "
        f"up to {bounds[i]:.2g} is believed."
    )


class AtRows:
    """Constraint levels of one system at many rows: by machine code in one call, else row by row."""

    def __init__(self, dynamics: Dynamics) -> None:
        s = dynamics.structure
        self._n, self._m, self._p = s.n, s.m, s.p
        self._at = ConstraintLevels(dynamics)
        self._terms = self._at.at_rows()
        self.slow = self._terms is None  #: a row costs as much as a residual
        n, m, p = s.n, s.m, s.p
        ends = list(accumulate((m, m, m * n, p, p * n, m)))
        #: where machine code puts g, g_t, g_q, k, k_v and the velocity level of g
        self._g, self._g_t, self._g_q, self._k, self._k_v, self._drift = map(slice, [0, *ends], ends)

    def computed(self, rows: Rows) -> Matrix | None:
        """Evaluate the constraint levels at ``rows`` by machine code; None if there is none."""
        return None if self._terms is None else self._terms(*rows)

    def hold(self, found: Matrix, scales: Scales, bound: float) -> bool:
        """True if all constraints are within ``bound`` of the declared scales; three times faster than :meth:`measured`."""
        n, m, p, count, held = self._n, self._m, self._p, len(found), 0
        allowed = np.empty((n, 2))
        allowed[:, 0], allowed[:, 1] = scales.q, scales.v
        allowed *= bound
        found = np.abs(found)
        if m:
            sizes = (found[:, self._g_q].reshape(-1, n) @ allowed).reshape(count, m, 2)
            held += int(np.count_nonzero(found[:, self._g] <= sizes[:, :, 0]))
            held += int(np.count_nonzero(found[:, self._drift] <= sizes[:, :, 1]))
        if p:
            of_k = (found[:, self._k_v].reshape(-1, n) @ allowed[:, 1]).reshape(count, p)
            held += int(np.count_nonzero(found[:, self._k] <= of_k))
        return held == count * (2 * m + p)

    def measured(
        self, rows: Rows, typical: tuple[Vector, Vector, Vector], clock: Clock | None = None, found: Matrix | None = None
    ) -> tuple[Matrix, Matrix]:
        """Return g, g_t + g_q v and k at ``rows``, and the sizes of their terms for ``typical`` sizes, (k, 2m + p) each.

        ``typical`` holds the sizes of q, of v in k, and of v in g_t + g_q v, (n,) each.  Rows beyond the time of ``clock``
        are 0.
        """
        found = self.computed(rows) if found is None else found
        if found is not None:
            return self._together(found, typical)
        s_q, s_k, s_v = typical
        values, sizes = np.zeros((2, rows[0].size, 2 * self._m + self._p))
        for row, (t, q, v) in enumerate(zip(rows[0].tolist(), *rows[1:], strict=True)):
            if clock is not None and clock.left() < 0.0:
                break
            at = self._at.at(t, q, v)
            jacobian = np.abs(at.position_jacobian)
            values[row] = np.concatenate([at.position, at.velocity_drift])
            of_velocity = jacobian @ s_v + np.abs(at.time_derivative)
            sizes[row] = np.concatenate([jacobian @ s_q, of_velocity, np.abs(at.velocity_jacobian) @ s_k])
        return values, sizes

    def _together(self, found: Matrix, typical: tuple[Vector, Vector, Vector]) -> tuple[Matrix, Matrix]:
        """Compute values and sizes from the machine code's output: g, g_t, g_q, k, k_v and the velocity level."""
        n, m, p = self._n, self._m, self._p
        of_g = (np.abs(found[:, self._g_q]).reshape(-1, n) @ np.array(typical[::2]).T).reshape(len(found), m, 2)
        of_k = (np.abs(found[:, self._k_v]).reshape(-1, n) @ typical[1]).reshape(len(found), p)
        values = found[:, self._g], found[:, self._drift], found[:, self._k]
        sizes = of_g[:, :, 0], of_g[:, :, 1] + np.abs(found[:, self._g_t]), of_k
        return np.concatenate(values, axis=1), np.concatenate(sizes, axis=1)


def at_rows(dynamics: Dynamics) -> AtRows:
    """Return the :class:`AtRows` of a system, cached."""
    found: AtRows = _known.find(by_id(dynamics), lambda: AtRows(dynamics))
    return found


def declared_sizes(problem: Problem) -> tuple[Vector, Vector]:
    """Return the scales of q and of v, (n,) each."""
    s_q, s_v = np.zeros((2, problem.q0.size))
    s_q += problem.scales.q
    s_v += problem.scales.v
    return s_q, s_v


def sizes_of(problem: Problem, q: Matrix, v: Matrix) -> Vector:
    """Return typical sizes of y = [q, v] (2n,): the larger of the rows' maxima (``q`` and ``v``, (k, n)) and the scales."""
    return np.concatenate([_moving(*pair) for pair in zip((q, v), declared_sizes(problem), strict=True)])


def _moving(rows: Matrix, declared: Vector) -> Vector:
    """Return the larger of the maxima of ``rows`` (k, n) and the ``declared`` sizes, (n,)."""
    size = np.maximum(np.maximum.reduce(np.abs(rows), axis=0), declared)
    return np.maximum(size, BESIDE * np.maximum.reduce(size))
