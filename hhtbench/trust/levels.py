"""Are the rows on the constraints?  How far they are off is measured by the bench; here only whether it can be believed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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
    largest, at_time = 0.0, 0.0
    for i in np.unique(np.linspace(0, t.size - 1, CHECKED_ROWS).astype(int)):
        check_time()
        try:
            at = levels.at(float(t[i]), q[i], v[i])
        except NonFiniteValue as error:
            return f"constraints: {error}."
        velocity = at.scaled_velocity(problem.scales.v)[at.position.size :]
        worst = float(np.max(np.concatenate([at.scaled_position(problem.scales.q), velocity])))
        if not worst <= largest:  # NaN counts as larger than all
            largest, at_time = worst, float(t[i])
        if np.isnan(worst):
            break
    bound = believable(request)
    if largest <= bound:
        return ""
    return (
        f"constraints: A constraint is violated by up to {largest:.2g} of its size, most at t = {at_time:.17g}; "
        f"up to {bound:.2g} is believed."
    )
