"""The user's bounds on the step, and the constants of its control."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ControlOptions:
    """The user's bounds on the step, and heuristic constants of its control."""

    first_step: float = 0.0  #: [s], of |h|; 0: chosen from the motion at the start
    min_step: float = 0.0  #: [s]; only the step to the end may be shorter
    max_step: float = math.inf  #: [s]
    target: float = 0.6  #: error aimed at, of 1: a rejection costs more than a step that is a tenth shorter
    integral: float = 0.7 / 3  #: exponent of this step's error; 3 since the local error is O(h^3)
    proportional: float = 0.4 / 3  #: exponent of the last step's error: damps the alternation of long and short steps
    growth: float = 1.5  #: most per step: what is stable in the stiff limit for every alpha (THEORY.md 10)
    shrink: float = 0.2  #: most per step: outside the asymptotic range an estimate says no more than "much less"
    keep: tuple[float, float] = (0.9, 1.15)  #: factors of plain integral control at which step and factorisation are kept
    least: float = 1e-4  #: smaller errors count as this one: a vanishing estimate says nothing about the next step
    after_failure: float = 0.25  #: factor after Newton has failed
    spacings: float = 16.0  #: of floating-point times: what is shorter is no step
    grown: float = 100.0  #: times an error must exceed what a jump of the force leaves of it in a shorter step
