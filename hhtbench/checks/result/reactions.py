"""Check whether the multipliers of a row produce its accelerations; compared are reaction forces, not multipliers.

At a row's own state the acceleration level determines the reaction; multipliers of redundant constraints are not unique,
their reaction is.  The residual of the row's multipliers in the equations of motion may be as large as the change of the
reaction by errors of the state (those allowed of a step, by the factor used elsewhere), plus the change of the reaction
within a step, since the multipliers of many methods are those of a stage, or of the step before.  A step of h whose
second-order error is of relative size e turns the motion by about sqrt(e); this share of every component is allowed: of the
row's own, or of the median over the rows if larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhtbench.checks.result.flow import NotJudged
from hhtbench.checks.result.motion import BOUND, MAX_EVALUATIONS, Follower, Multipliers, signs
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Solution

ROUNDOFF = 1e-8  # roundoff of the reaction over the largest force
LAG = 7.0  # times the square root of the error allowed of a step, in typical sizes: HHT's stages lag by up to 5.4
MAX_SHARE = 0.5  # largest allowed error over the reaction: beyond it no digit is right
BESIDE = 1e-3  # share of the largest component by which smaller ones are scaled at least
STATES_BESIDE = 2  # states beside that of the row


@dataclass(frozen=True)
class Row:
    """Data of the acceleration level at a row of a solution."""

    i: int
    t: float  #: [s]
    y: Vector  #: [q, v] (2n,)
    multipliers: Multipliers  #: those given
    vdot: Vector  #: (n,)
    reaction: Vector  #: (n,)


def rows_of(follower: Follower, solution: Solution, some: list[int]) -> list[Row]:
    """Return those of the rows ``some`` of ``solution`` that have multipliers and determined accelerations."""
    rows, unknown = [], solution.unknown
    for i in (i for i in some if not unknown[i]):
        t, y = float(solution.t[i]), np.concatenate([solution.q[i], solution.v[i]])
        multipliers = Multipliers(solution.lam[i], solution.mu[i])
        follower.equations.begin(MAX_EVALUATIONS, multipliers)
        found = follower.equations.needed(t, y)
        if found is not None:
            rows.append(Row(i, t, y, multipliers, *found))
    return rows


def wrong_reactions(follower: Follower, rows: list[Row]) -> str:
    """Describe the first of ``rows`` whose multipliers give a wrong reaction, as a sentence; "" if there is none."""
    if not rows:
        return ""
    typical = np.median([np.abs(row.reaction) for row in rows], axis=0)
    return next(filter(None, (_wrong_reaction(follower, row, typical) for row in rows)), "")


def _wrong_reaction(follower: Follower, row: Row, typical: Vector) -> str:
    equations, t, y, reaction = follower.equations, row.t, row.y, row.reaction
    off = np.abs(equations.reaction(t, y, row.multipliers) - reaction)
    size = np.maximum(typical, np.abs(reaction))
    size = np.maximum(size, BESIDE * np.max(size))
    roundoff = ROUNDOFF * max(float(np.max(size)), float(np.max(np.abs(equations.force(t, y)))))

    def lagging(allowed: Vector) -> Vector:
        return roundoff + size * min(MAX_SHARE, LAG * float(np.sqrt(np.max(allowed / follower.size))))

    if np.all(off <= lagging(follower.allowed)):
        return ""
    try:
        allowed = follower.allowed_at(t, y)
    except NotJudged:
        return ""
    bound = lagging(allowed)
    equations.begin(MAX_EVALUATIONS, row.multipliers)
    for _, sign in zip(range(STATES_BESIDE), signs(y.size), strict=False):
        beside = equations.needed(t, y + sign * allowed)
        if beside is None:
            return ""
        bound += BOUND * np.abs(beside[1] - reaction)
    if np.all(off <= bound):
        return ""
    i = int(np.argmax(off / bound))
    return (
        f"multipliers: at t = {exact(t)} the reaction of those given on q[{i}] is {off[i]:.2g} off what the acceleration "
        f"level needs, of size {size[i]:.2g}; up to {bound[i]:.2g} is believed."
    )
