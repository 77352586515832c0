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
        found = _over_sizes(levels, problem, (t[some], q[some], v[some]), check_time)
    except NonFiniteValue as error:
        return f"constraints: {error}."
    i = int(np.argmax(found))  # the first that is not a number, if there is one
    largest, at_time = float(found[i]), float(t[some[i]])
    bound = believable(request)
    if largest <= bound:
        return ""
    return (
        f"constraints: A constraint is violated by up to {largest:.2g} of its size, most at t = {at_time:.17g}; "
        f"up to {bound:.2g} is believed."
    )


def _over_sizes(
    levels: ConstraintLevels, problem: Problem, rows: tuple[Vector, Matrix, Matrix], check_time: Callable[[], None]
) -> Vector:
    """The largest of |g| and |k| at every row (k,), each over what its row of the Jacobian makes of the typical sizes."""
    n, scales = levels.structure.n, problem.scales
    s_q, s_v = np.full(n, scales.q, dtype=np.float64), np.full(n, scales.v, dtype=np.float64)
    values, sizes = [], []
    for t, q, v in zip(rows[0].tolist(), *rows[1:], strict=True):
        check_time()
        at = levels.at(t, q, v)
        values.append(np.concatenate([at.position, at.velocity]))
        sizes.append(np.concatenate([np.abs(at.position_jacobian) @ s_q, np.abs(at.velocity_jacobian) @ s_v]))
    size = np.array(sizes)
    worst: Vector = np.max(np.abs(values) / np.where(size > 0.0, size, 1.0), axis=1)
    return worst
