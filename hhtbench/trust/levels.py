"""Are the rows on the constraints?  How far they are off is measured by the bench; here only whether it can be believed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import ConstraintLevels
from hhtbench.protocol import Problem
from hhtbench.request import Request
from hhtbench.trust.sizes import sizes_of

BELIEVABLE = 0.1  # violation in units of the typical size: beyond it the rows show another mechanism
DRIFT = 1e4  # times the relative tolerance: what forms that differentiate the constraints may drift in a long interval
CHECKED_ROWS = 200  # looked at, the last one included: more would cost more than the steps


def believable(request: Request) -> float:
    """The largest violation, in units of the typical size, of a solver that does what ``request`` asks."""
    rtol = 0.0 if request.rtol is None else float(np.max(request.rtol))
    return min(BELIEVABLE, DRIFT * rtol) if rtol > 0.0 else BELIEVABLE


def spread(count: int) -> NDArray[np.intp]:
    """Up to ``CHECKED_ROWS`` of ``count`` rows, evenly spread, the first and the last among them."""
    return np.linspace(0, count - 1, min(count, CHECKED_ROWS)).round().astype(np.intp)


def violated(
    levels: ConstraintLevels,
    problem: Problem,
    request: Request,
    rows: tuple[Vector, Matrix, Matrix],
    check_time: Callable[[], None] = lambda: None,
) -> str:
    """The largest violation of the constraints at the rows t (k,), q and v (k, n), in words; "" where it is believable.

    Raises
    ------
    BudgetSpent
        By ``check_time``, which is called at every row.
    """
    t, q, v = rows
    if not levels.structure.constrained or not t.size:
        return ""
    some = spread(t.size)
    try:
        constraints, velocities = _over_sizes(levels, problem, (t[some], q[some], v[some]), check_time)
    except NonFiniteValue as error:
        return f"constraints: {error}."
    return _beyond("A constraint is", constraints, t[some], believable(request)) or _beyond(
        "The velocity level of a position constraint, g_t + g_q v, is", velocities, t[some], BELIEVABLE
    )


def _beyond(what: str, found: Vector, t: Vector, bound: float) -> str:
    """The largest of ``found`` (k,), in words; "" where it is within ``bound``."""
    i = int(np.argmax(found))  # the first that is not a number, if there is one
    if found[i] <= bound:
        return ""
    return (
        f"constraints: {what} violated by up to {found[i]:.2g} of its size, most at t = {t[i]:.17g}; "
        f"up to {bound:.2g} is believed."
    )


def _over_sizes(
    levels: ConstraintLevels, problem: Problem, rows: tuple[Vector, Matrix, Matrix], check_time: Callable[[], None]
) -> tuple[Vector, Vector]:
    """The largest of |g| and |k|, and of |g_t + g_q v|, at every row (k,), over what Jacobians make of typical sizes.

    Forms of index 3 and 1 do not keep the velocity level, so its size is that of the velocities which the rows have.
    """
    n, m, scales = levels.structure.n, levels.structure.m, problem.scales
    s_q, s_v = np.full(n, scales.q, dtype=np.float64), np.full(n, scales.v, dtype=np.float64)
    fastest = sizes_of(problem, *rows[1:])[n:]
    worst = np.zeros((2, rows[0].size))
    for row, (t, q, v) in enumerate(zip(rows[0].tolist(), *rows[1:], strict=True)):
        check_time()
        at = levels.at(t, q, v)
        values = np.concatenate([at.position, at.velocity])
        sizes = np.concatenate([np.abs(at.position_jacobian) @ s_q, np.abs(at.velocity_jacobian) @ s_v])
        worst[0, row] = _largest(values, sizes)
        worst[1, row] = _largest(at.velocity_drift[:m], np.abs(at.position_jacobian) @ fastest + np.abs(at.time_derivative))
    return worst[0], worst[1]


def _largest(values: Vector, sizes: Vector) -> float:
    """The largest |value| over its size; where that is zero, of the value itself; 0 where there are none."""
    return float(np.max(np.abs(values) / np.where(sizes > 0.0, sizes, 1.0), initial=0.0))
