"""Check that the constraints lose rank wherever a solution's multipliers are NaN."""

from __future__ import annotations

import numpy as np

from hhtbench.checks.result.levels import sizes_of, spread
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Clock
from hhtbench.solution.result import Solution

LOST = 1e-2  # ratio of a singular value to its value elsewhere below which NaN multipliers are accepted
ALWAYS = 1e-10  # ratio to the largest singular value below which constraints are redundant everywhere
ELSEWHERE = 20  # rows that show what singular values are elsewhere


def unknown_without_reason(problem: Problem, solution: Solution, clock: Clock | None = None) -> str:
    """Name a row with a NaN multiplier although the constraints have full rank there; "" if there is none.

    Singular values of [g_q; k_v], scaled by typical velocities and the rows' largest size in the run, are compared with the
    largest of the same order at a few rows and at the start, until the time of ``clock`` is over.
    """
    unknown = np.flatnonzero(solution.unknown)
    if not unknown.size:
        return ""
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0), full=True)
    size = sizes_of(problem, solution.q, solution.v)[levels.structure.n :]

    def rows_at(i: int) -> Matrix:
        return np.asarray(levels.at(float(solution.t[i]), solution.q[i], solution.v[i]).rows * size)

    try:
        start = levels.at(problem.t_span[0], problem.q0, problem.v0).rows * size
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


def _singular_values(rows: Matrix) -> Vector:
    """Return the singular values in falling order."""
    return np.asarray(np.linalg.svd(rows, compute_uv=False), dtype=np.float64)
