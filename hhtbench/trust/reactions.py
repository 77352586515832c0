"""Do the multipliers of a row make its accelerations?  They are held against the forces, so that any set will do that does.

At a row's own state the acceleration level determines the reaction; multipliers of redundant constraints are not unique,
their reaction is.  What the row's multipliers leave of the equations of motion may be as large as what errors of the state
make of the reaction, as often those allowed of a step as elsewhere, together with what a step itself may be off: a reaction
that is wrong by R for a step of h changes v by h M^-1 R, and no more of that is believed than errors of v are.  Never is
more believed than a part of the reaction that follows the tolerance: of the row's own reaction, or of that of half the rows
where it is larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.result import Solution
from hhtbench.trust.flow import NotJudged
from hhtbench.trust.levels import believable
from hhtbench.trust.motion import BOUND, MOST_EVALUATIONS, Follower, Multipliers, signs

ROUNDOFF = 1e-8  # of the largest force
DISTURBED = 2  # states beside that of the row
NEIGHBOURS = 2  # steps on both sides of a row whose lengths count


@dataclass(frozen=True)
class Row:
    """What the acceleration level needs at a row of a solution."""

    i: int
    t: float  #: [s]
    y: Vector  #: [q, v] (2n,)
    multipliers: Multipliers  #: those given
    vdot: Vector  #: (n,)
    reaction: Vector  #: (n,)
    h: float  #: the shortest step beside it [s]; 0.0 where the steps are not known


def rows_of(follower: Follower, solution: Solution, some: list[int], ends: Vector | None) -> list[Row]:
    """The rows ``some`` of ``solution`` at which accelerations are determined; ``ends`` (k,) of its steps [s], if known."""
    rows = []
    for i in some:
        t, y = float(solution.t[i]), np.concatenate([solution.q[i], solution.v[i]])
        multipliers = Multipliers(solution.lam[i], solution.mu[i])
        follower.equations.begin(MOST_EVALUATIONS, multipliers)
        found = follower.equations.needed(t, y)
        if found is not None:
            rows.append(Row(i, t, y, multipliers, *found, shortest_beside(ends, t)))
    return rows


def shortest_beside(ends: Vector | None, t: float) -> float:
    """The shortest of the steps that end, or begin, next to ``t`` [s], and of their neighbours; 0.0 where there are none."""
    if ends is None:
        return 0.0
    i = int(np.argmin(np.abs(ends - t)))
    lengths = np.abs(np.diff(ends[max(0, i - NEIGHBOURS) : i + NEIGHBOURS + 1]))
    return float(np.min(lengths[lengths > 0.0], initial=np.inf)) if lengths.any() else 0.0


def wrong_reactions(follower: Follower, rows: list[Row]) -> str:
    """How far the reaction of the multipliers of one of ``rows`` is off what is needed, in words; "" where all can be."""
    if not rows:
        return ""
    typical = float(np.median([np.max(np.abs(row.reaction)) for row in rows]))
    return next(filter(None, (_wrong_reaction(follower, row, typical) for row in rows)), "")


def _wrong_reaction(follower: Follower, row: Row, typical: float) -> str:
    equations, t, y, reaction = follower.equations, row.t, row.y, row.reaction
    off = float(np.max(np.abs(equations.reaction(t, y, row.multipliers) - reaction)))
    size = max(typical, float(np.max(np.abs(reaction))))
    bound = ROUNDOFF * max(size, float(np.max(np.abs(equations.force(t, y)))))
    if off <= bound:
        return ""
    try:
        allowed = follower.allowed_at(t, y)
    except NotJudged:
        return ""
    bound += min(believable(follower.request) * size, _of_a_step(follower, row, allowed))
    if off <= bound:
        return ""
    equations.begin(MOST_EVALUATIONS, row.multipliers)
    for _, sign in zip(range(DISTURBED), signs(y.size), strict=False):
        beside = equations.needed(t, y + sign * allowed)
        if beside is None:
            return ""
        bound += BOUND * float(np.max(np.abs(beside[1] - reaction)))
    if off <= bound:
        return ""
    return (
        f"multipliers: at t = {t:.17g} the reaction of those given is {off:.2g} off what the acceleration level needs, of "
        f"size {size:.2g}; up to {bound:.2g} is believed."
    )


def _of_a_step(follower: Follower, row: Row, allowed: Vector) -> float:
    """The reaction that changes v by ``BOUND`` times what is ``allowed`` of it (2n,), for the step beside ``row``."""
    if row.h == 0.0:
        return np.inf
    n = allowed.size // 2
    changes = (sign[n:] * allowed[n:] for _, sign in zip(range(DISTURBED), signs(allowed.size), strict=False))
    inertia = max(float(np.max(np.abs(follower.equations.inertia(row.t, row.y, change)))) for change in changes)
    return BOUND * inertia / row.h
