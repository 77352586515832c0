"""Do the multipliers of a row make its accelerations?  They are held against the forces, so that any set will do that does.

At a row's own state the acceleration level determines the reaction; multipliers of redundant constraints are not unique,
their reaction is.  What the row's multipliers leave of the equations of motion may be as large as what errors of the state
make of the reaction, as often those allowed of a step as elsewhere, and a part of the reaction that follows the tolerance.
"""

from __future__ import annotations

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.trust.levels import believable
from hhtbench.trust.motion import BOUND, MOST_EVALUATIONS, Follower, Multipliers, signs

ROUNDOFF = 1e-8  # of the largest force
DISTURBED = 2  # states beside that of the row


def wrong_reaction(follower: Follower, t: float, y: Vector, multipliers: Multipliers) -> str:
    """How far the reaction of ``multipliers`` is off that at (t, y), y = [q, v] (2n,), in words; "" where it can be."""
    equations = follower.equations
    equations.begin(MOST_EVALUATIONS, multipliers)
    reaction, given = equations.reaction(t, y), equations.reaction(t, y, multipliers)
    if reaction is None or given is None:
        return ""
    off, size = float(np.max(np.abs(given - reaction))), float(np.max(np.abs(reaction)))
    bound = believable(follower.request) * size + ROUNDOFF * max(size, float(np.max(np.abs(equations.force(t, y)))))
    if off <= bound:
        return ""
    for _, sign in zip(range(DISTURBED), signs(y.size), strict=False):
        beside = equations.reaction(t, y + sign * follower.allowed)
        if beside is None:
            return ""
        bound += BOUND * float(np.max(np.abs(beside - reaction)))
    if off <= bound:
        return ""
    return (
        f"multipliers: at t = {t:.17g} the reaction of those given is {off:.2g} off what the acceleration level needs, of "
        f"size {size:.2g}; up to {bound:.2g} is believed."
    )
