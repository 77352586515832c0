"""Step-size control: the next accepted step, of prescribed length or as long as its error (H26) is at most 1."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from solvers.hht.control.estimate import estimate, roundoff
from solvers.hht.equations.formulas import CERTAIN, NOISE, REMAINDER
from solvers.hht.events.scan import keep_values, scan
from solvers.hht.sources import fit, growth, representable
from solvers.hht.step.attempt import accept, attempt
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import acceleration_level
from solvers.kernel.compiled import compiled, spacing
from solvers.kernel.sections import part, put, view

RELAX = 1.3  # growth per step of the bound that failures set, if the step took no new matrix
NO_ESTIMATE = -1.0  # marks an error that was not estimated: that of a step far shorter than proposed


class ControlOptions(NamedTuple):
    """The user's bounds on the step, and heuristic constants of the step-size controller."""

    first_step: float = 0.0  #: [s], of |h|; 0: chosen from the motion at the start
    min_step: float = 0.0  #: [s]; only the step to the end may be shorter
    max_step: float = math.inf  #: [s]
    target: float = 0.6  #: error aimed at, of 1: a rejection costs more than a step that is a tenth shorter
    integral: float = 0.7 / 3  #: exponent of this step's error; 3 since the local error is O(h^3)
    proportional: float = 0.4 / 3  #: exponent of the last step's error: damps the alternation of long and short steps
    growth: float = 1.5  #: most per step: what is stable in the stiff limit for every alpha (THEORY.md 10)
    shrink: float = 0.2  #: most per step: outside the asymptotic range an estimate says no more than "much less"
    keep: tuple[float, float] = (0.9, 1.15)  #: factors of plain integral control at which step and factorisation are kept
    least: float = 1e-4  #: smaller errors count as this: a vanishing estimate does not predict the next step
    after_failure: float = 0.5  #: factor after Newton has failed
    below_failure: float = 0.7  #: bound on the next steps over a length at which Newton has failed
    spacings: float = 16.0  #: shortest step in spacings of floating-point times
    grown: float = 100.0  #: factor by which an error must exceed that of a force jump to count as roundoff


@compiled
def advance(z: Any, o: Any, stop: Any, length: Any, end: Any, row: Any, counts: Any) -> Any:
    """Take one accepted step; returns CONVERGED or the reason for failure, with the last attempt in ATTEMPT."""
    ended = controlled(z, o, stop, counts) if z.i[mem.CONTROLLED] else prescribed(z, length, end, counts)
    if ended != mem.CONVERGED:
        return ended
    if z.i[mem.WATCHING]:
        ended = scan(z, counts)
        if ended != mem.CONVERGED:
            return ended
    conclude(z, row, counts)
    return mem.CONVERGED


@compiled
def prescribed(z: Any, h: Any, t1: Any, counts: Any) -> Any:
    """Attempt a step of h [s] to t1 without error control."""
    t, tried = part(z, mem.NUMBER)[mem.T], part(z, mem.ATTEMPT)
    if t + h == t or t1 == t:
        tried[mem.H_TRIED] = h
        return mem.NO_ADVANCE
    ended = attempt(z, h, t1, True, counts)
    return mem.FALL_BACK if may_fall_back(z, ended) else ended


@compiled
def may_fall_back(z: Any, ended: Any) -> Any:
    """True if Newton's iteration may have failed because of wrong declared derivatives."""
    return z.i[mem.FALLBACK] and ended not in (mem.CONVERGED, mem.SPENT, mem.NONFINITE)


@compiled
def controlled(z: Any, o: Any, stop: Any, counts: Any) -> Any:
    """Attempt steps, shorter each time, until the error of one is at most 1.

    The next step is proposed from the length before its end was rounded to a floating-point time.
    """
    control, tried, t = part(z, mem.CONTROL), part(z, mem.ATTEMPT), part(z, mem.NUMBER)[mem.T]
    proposed = min(control[mem.H_NEXT], control[mem.BOUND], o.max_step)
    length, rejected, failed, last = max(proposed, o.min_step), 0, mem.NO_ADVANCE, 0.0
    least = max(o.min_step, o.spacings * spacing(abs(t)))
    smallest = abs(representable(t, math.copysign(least, stop - t)))
    tried[mem.FIRST_H] = 0.0
    while True:
        asked = length
        fitted, t1 = fit(t, math.copysign(asked, stop - t), stop, o.min_step)
        length, h = abs(fitted), representable(t, fitted)  # half of the rest may lie between floating-point times
        if t + h == t or t1 == t:
            if failed == mem.NO_ADVANCE:
                tried[mem.H_TRIED] = h
            return failed
        retried = rejected > 0 or abs(h) <= smallest or part(z, mem.NUMBER)[mem.H] == 0.0  # else a shorter step is cheaper
        ended, factor = attempt(z, h, t1, retried, counts), o.after_failure
        if ended == mem.SPENT:
            return mem.SPENT
        if ended == mem.NO_ADVANCE:
            return failed
        if retried and may_fall_back(z, ended):
            return mem.FALL_BACK
        if ended != mem.CONVERGED:
            failed = ended
            control[mem.BOUND] = o.below_failure * abs(h)
        elif rejected == 0 and abs(h) < REMAINDER * proposed and step_is_known(control, o):
            tried[mem.ERROR_SIZE], tried[mem.NEXT_H] = NO_ESTIMATE, asked
            return mem.CONVERGED
        else:
            size = estimate(z, counts)
            tried[mem.ERROR_SIZE] = size
            if size <= 1.0:
                factor = growth(o, size, control[mem.LAST_ERROR], rejected > 0)
                h_next = length * min(factor, most_growth(tried[mem.MADE]))
                tried[mem.NEXT_H] = max(h_next, asked) if length < asked else h_next
                return mem.CONVERGED
            counts[mem.REJECTED] += 1
            if hopeless(z, o, h, size, last):
                return mem.ROUNDOFF_REACHED
            failed, factor, last = mem.TOO_LARGE, o.shrink, size
            if rejected == 0:
                factor = max(o.shrink, (o.target / size) ** (1 / 3))
        if abs(h) <= smallest:
            return failed
        length, rejected = max(length * factor, smallest), rejected + 1


@compiled
def most_growth(matrices: Any) -> Any:
    """Largest factor of the next step after Newton's iteration made so many ``matrices``: it converges slowly."""
    return max(1.3 - 0.1 * matrices, 0.7) if matrices > 1.0 else math.inf


@compiled
def step_is_known(control: Any, o: Any) -> Any:
    """True if the next step's length comes from the motion (an error or the start), not from the user's ``first_step``."""
    return control[mem.LAST_ERROR] >= 0.0 or o.first_step == 0.0


@compiled
def hopeless(z: Any, o: Any, h: Any, size: Any, last: Any) -> Any:
    """Return True if the error ``size`` (1: as large as allowed) of a step of h [s] is roundoff: no shorter step helps.

    Stores the first h and error tried from this state in ATTEMPT, to compare later ones with.  The error that a force
    jump leaves in v is proportional to h, and errors outside the asymptotic range fall below the ``last`` one tried;
    roundoff stays or grows, and cannot exceed the roundoff of q and v.
    """
    tried = part(z, mem.ATTEMPT)
    if tried[mem.FIRST_H] == 0.0:
        tried[mem.FIRST_H], tried[mem.FIRST_ERROR] = h, size
    left = tried[mem.FIRST_ERROR] * h / tried[mem.FIRST_H]
    grown = size > max(o.grown * left, last) and size < NOISE * roundoff(z, h)
    return grown or roundoff(z, math.inf) > CERTAIN


@compiled
def conclude(z: Any, row: Any, counts: Any) -> None:
    """Accept the attempt and store what the next step's controller and event search need."""
    remainder = z.i[mem.CONTROLLED] and part(z, mem.ATTEMPT)[mem.ERROR_SIZE] == NO_ESTIMATE
    if z.i[mem.CONTROLLED] and not remainder:
        remember_place(z)
    accept(z, row)
    counts[mem.ACCEPTED] += 1
    if remainder:
        remember_remainder(z, counts)
    elif z.i[mem.CONTROLLED]:
        remember(z)
    if z.i[mem.WATCHING]:
        keep_values(z)


@compiled
def remember_place(z: Any) -> None:
    """Store q at the step's begin, for the third difference of q in the next one, (H59)."""
    control = part(z, mem.CONTROL)
    put(part(z, mem.Q_FIRST), 0, part(z, mem.Q_BEFORE))
    put(part(z, mem.Q_BEFORE), 0, part(z, mem.Q))
    control[mem.LAST_BUT_ONE] = control[mem.LAST]


@compiled
def remember(z: Any) -> None:
    """Store what the next error estimate and the controller need."""
    n, control, tried = z.i[mem.N], part(z, mem.CONTROL), part(z, mem.ATTEMPT)
    control[mem.H_NEXT], control[mem.LAST] = tried[mem.NEXT_H], tried[mem.H_TRIED]
    control[mem.LAST_ERROR] = tried[mem.ERROR_SIZE]
    if tried[mem.MADE] < 2.0:
        control[mem.BOUND] *= RELAX if tried[mem.MADE] == 0.0 else RELAX**0.25
    put(part(z, mem.BEFORE), 0, part(z, mem.ACCELERATION))
    put(part(z, mem.ACCELERATION), 0, part(z, mem.RAW)[2 * n : 3 * n])
    if z.i[mem.P] > 0:
        control[mem.HAS_REACTION_K] = 1.0
        put(part(z, mem.REACTION_K), 0, part(z, mem.X)[z.i[mem.O_RK] : z.i[mem.O_RK] + n])


@compiled
def remember_remainder(z: Any, counts: Any) -> None:
    """Store this after a step far shorter than proposed; lam, mu and v' are solved for anew, being roundoff over h^2."""
    n, constraints, control, place = z.i[mem.N], z.i[mem.M] + z.i[mem.P], part(z, mem.CONTROL), part(z, mem.PLACE)
    if constraints > 0:
        place[0] = part(z, mem.NUMBER)[mem.T]
        put(place, 1, part(z, mem.END)[: 2 * n])
        if acceleration_level(z, z.i[2 * mem.LAM], counts):
            put(view(z.w, z.i[2 * mem.LAM], constraints + n), 0, part(z, mem.ACCELERATION_LEVEL)[1:])
    control[mem.H_NEXT], control[mem.LAST_ERROR] = part(z, mem.ATTEMPT)[mem.NEXT_H], -1.0
    control[mem.LAST] += part(z, mem.ATTEMPT)[mem.H_TRIED]
    put(part(z, mem.ACCELERATION), 0, part(z, mem.VDOT))
