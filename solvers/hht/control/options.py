"""How long the steps are: prescribed, or controlled by the local error."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.request import StepPlan
from hhtbench.result import Status
from solvers._start import Failure
from solvers.hht.engine import HostEngine, largest
from solvers.hht.estimate import Estimator, remembered
from solvers.hht.laws import CRUMB, SHORT, fit, growth, representable
from solvers.hht.state import Memory, State, Step

NOISE = 30.0  # times: errors made of roundoff vary by so much over the steps of a run
CERTAIN = 5.0  # times what is allowed: roundoff that no step can be below; with 2.5 times many steps still pass
CRAWL = 1e-6  # of what is left of the interval: steps as short as that do not get there
STILL = 1e-10  # relative change of v' that is roundoff


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


class Advance(Protocol):
    """Makes the next accepted step."""

    def __call__(self, state: State, stop: float) -> Step | Failure:
        """From ``state`` towards ``stop`` [s], never past it."""


@runtime_checkable
class Planned(Advance, Protocol):
    """Knows the lengths of its steps beforehand, so that many can be made at once."""

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` steps from ``state`` towards ``stop``."""

    def made(self, count: int) -> None:
        """``count`` of those have been made."""


class Prescribed:
    """The steps of a plan, one after the other."""

    def __init__(self, engine: HostEngine, plan: StepPlan) -> None:
        self.engine, self.plan, self.taken = engine, plan, 0
        self._left_over = False

    def __call__(self, state: State, stop: float) -> Step | Failure:
        """The next step of the plan, or what is left of the last."""
        h, t1 = self.plan.length(self.taken), self.plan.end(self.taken)
        if self._left_over:
            h = t1 - state.t
        if state.t + h == state.t or t1 == state.t:
            return no_advance(state.t, h)
        self.engine.work.check_time()
        step = self.engine.step(state, h, t1)
        if isinstance(step, Step):
            self.taken, self._left_over = self.taken + 1, False
        return step

    def ahead(self, state: State, stop: float, count: int) -> tuple[Vector, Vector]:
        """Lengths and ends [s] of up to ``count`` whole steps that come next; none while one is begun already."""
        return self.plan.ahead(self.taken, 0 if self._left_over else count)

    def made(self, count: int) -> None:
        """``count`` of those have been made."""
        self.taken += count

    def cut_short(self) -> None:
        """The last step ended early, at an event: what is left of it comes next."""
        self.taken, self._left_over = self.taken - 1, True


@dataclass(frozen=True)
class ErrorControlled:
    """Steps whose local error (H26) is at most 1, as long as that allows: a proportional-integral controller.

    Stateless: what it remembers travels in ``State.memory``.
    """

    engine: HostEngine
    estimator: Estimator
    options: ControlOptions

    def __call__(self, state: State, stop: float) -> Step | Failure:
        """The next accepted step from ``state``; a :class:`Failure` when not even the smallest is accepted."""
        o, work = self.options, self.engine.work
        h, failure, rejected, first = proposal(state, o), None, 0, None
        while True:
            h = representable(state.t, math.copysign(h, stop - state.t))
            asked = abs(h)
            h, t1 = fit(state.t, h, stop, o.min_step)
            if state.t + h == state.t or t1 == state.t:
                return failure or no_advance(state.t, h)
            work.check_time()
            taken = self.engine.step(state, h, t1)
            if isinstance(taken, Failure):
                failure, factor = taken, o.after_failure
            elif rejected == 0 and abs(h) < CRUMB * asked:
                return self._crumb(state, taken, asked)
            else:
                found = self.estimator(state, taken)
                if found.size <= 1.0:
                    h_next = abs(h) * growth_factor(o, found.size, state.memory, rejected=rejected > 0)
                    h_next = max(h_next, asked) if abs(h) < asked else h_next
                    memory = remembered(taken, found, state, h_next)
                    return replace(taken, state=replace(taken.state, memory=memory))
                work.add("steps_rejected_error")
                first = first or (h, found.size)
                if beneath := self._beneath(state, h, found.size, first):
                    return beneath
                failure = self._unmet(state, h, found.size)
                factor = max(o.shrink, (o.target / found.size) ** (1 / 3)) if rejected == 0 else o.shrink
            smallest = shortest(o, state.t, stop)
            if abs(h) <= smallest:
                return failure
            h, rejected = max(abs(h) * factor, smallest), rejected + 1

    def unreachable(self, state: State, stop: float) -> Failure | None:
        """Why no step from ``state`` can be short enough: roundoff of q and v is more than what is allowed of any.

        None where it is less, and in a motion whose v'' has no error that a single step towards ``stop`` [s] would show.
        """
        tolerances, memory = self.estimator.tolerances, state.memory
        roundoff = tolerances.roundoff(state)
        if memory is None or roundoff <= CERTAIN:
            return None
        left = abs(stop - state.t)
        change, h = memory.acceleration - memory.earlier, min(left, self.options.max_step)
        moves = largest(change) > STILL * largest(memory.acceleration)
        with np.errstate(all="ignore"):
            error = tolerances.size(state, h**3 / 12 * change / memory.last, np.zeros_like(change))  # (H27)
        crawls = state.h is not None and memory.h_next < CRAWL * left
        if not crawls and not (moves and error > 1.0):
            return None
        head = f"at t = {state.t:.17g} the roundoff of q and v is {roundoff:.3g} times what the tolerances allow of a step: "
        return Failure(Status.step_too_small, head + tolerances.reachable(state, proposal(state, self.options)))

    def _beneath(self, before: State, h: float, error: float, first: tuple[float, float]) -> Failure | None:
        """That roundoff makes the ``error`` of a step of h [s], so that none shorter helps, by h and error tried ``first``.

        What a jump of the force leaves in v goes with h; roundoff stays or grows, and is no more than q and v make.
        """
        tolerances, left = self.estimator.tolerances, first[1] * h / first[0]
        stays = self.options.grown * left < error < NOISE * tolerances.roundoff(before, h)
        if not stays and tolerances.roundoff(before) <= CERTAIN:
            return None
        text = f"at t = {before.t:.17g} the error of a step of {abs(h):.3g} s is {error:.3g} times what the tolerances allow"
        text += f", that of {abs(first[0]):.3g} s was {first[1]:.3g} times" if stays else ""
        return Failure(Status.step_too_small, f"{text}: {tolerances.reachable(before, first[0])}")

    def _unmet(self, before: State, h: float, error: float) -> Failure:
        """Why the ``error`` of a step of h [s] is too large, where it is more than roundoff."""
        o, t = self.options, before.t
        head = f"at t = {t:.17g} the error of a step of {abs(h):.3g} s is {error:.3g} times what the tolerances allow; "
        by_times = o.min_step < o.spacings * float(np.spacing(abs(t)))
        moved = abs(h) * max(before.size_v, abs(h) * largest(before.vdot))
        if by_times and moved > SHORT * before.size_q:  # at a jump steps become so short that nothing moves
            return Failure(Status.time_resolution, head + Status.time_resolution.text)
        return Failure(Status.step_too_small, head + Status.step_too_small.text)

    def _crumb(self, before: State, step: Step, h_next: float) -> Step:
        """``step``, cut far below what was asked for: it has no error, and its lam and v' are roundoff over h^2."""
        after, memory = self.engine.with_multipliers(step.state), before.memory
        if memory is not None:
            last = memory.last + (after.h or 0.0)
            memory = replace(memory, h_next=h_next, last=last, acceleration=after.vdot, error=None)
        return replace(step, state=replace(after, memory=memory))


def proposal(state: State, options: ControlOptions) -> float:
    """|h| [s] to try first."""
    if state.memory is None:
        raise ValueError("the state was not prepared for step control.")
    return max(min(state.memory.h_next, options.max_step), options.min_step)


def shortest(options: ControlOptions, t: float, stop: float) -> float:
    """|h| [s] of the shortest step from ``t`` towards ``stop`` that is tried."""
    least = max(options.min_step, options.spacings * float(np.spacing(abs(t))))
    return abs(representable(t, math.copysign(least, stop - t)))


def growth_factor(o: ControlOptions, error: float, memory: Memory | None, *, rejected: bool) -> float:
    """What the next step is longer than an accepted one with ``error`` (H26)."""
    return growth(o, error, -1.0 if memory is None or memory.error is None else memory.error, rejected)


def no_advance(t: float, h: float) -> Failure:
    """The failure of a step that floating-point times cannot tell from none."""
    text = f"t = {t:.17g} cannot be advanced by h = {h:g}; {Status.time_resolution.text}"
    return Failure(Status.time_resolution, text)
