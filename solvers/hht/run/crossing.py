"""Step across a singular position, (H49): along the smooth motion before it, onto both constraint levels behind it.

At a singular position several motions meet, each with its own tangent.  That of the run is known from its rows, as is
v', which is smooth along it although multipliers may have poles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from solvers._projection import PROJECTED
from solvers._start import Failure, PhasePoint
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.run.engine import Engine
from solvers.hht.run.singular import AcceleratedPoint, SingularPosition, UnitRows
from solvers.hht.run.start import first_state
from solvers.hht.step.state import State
from solvers.kernel.numbers import EPS

WIDTHS = (1.0, 2.0, 4.0, 8.0, 0.5, 0.25)  # distances tried, over the longest step: v' is roundoff near the position
SWEEPS = 4  # corrector iterations
CLOSE = 0.1  # largest change of the rows by a projection over their least singular value, or the branch is uncertain
SMOOTH = 0.2  # largest difference of v' behind from the extrapolated one, relative to the largest v'
MAX_ERROR = 0.05  # relative to the tolerance of the whole run, as such steps are few
MIN_BEYOND = 0.25  # distance behind the position at least, relative to that before it
TOO_FEW = "too few steps lead there"
MAX_CHANGE = 0.5  # relative change of v by v' on the way across, or the motion has no direction


@dataclass(frozen=True)
class Crossing:
    """Result: a step across a singular position."""

    steps: int  #: number of last steps that it replaces
    h: float  #: signed length [s]
    state: State  #: behind the position


class Refused(Exception):
    """Raised with the reason, a sentence, why no step across is made."""


@dataclass(frozen=True)
class Approach:
    """A run that ended at a singular position."""

    engine: Engine
    tolerances: Tolerances
    position: SingularPosition
    places: list[AcceleratedPoint]  #: the last rows of the run
    state: State  #: its last state
    stop: float  #: end of the interval [s]

    def crossing(self) -> Crossing | str:
        """A step across from one of the rows, or the reason why there is none."""
        reason, ahead = TOO_FEW, math.copysign(1.0, self.stop - self.state.t)
        longest = max((abs(after.t - before.t) for before, after in pairwise(self.places)), default=0.0)
        for factor in WIDTHS:
            found = [i for i, x in enumerate(self.places) if (self.position.t - x.t) * ahead >= factor * longest]
            try:
                if found:
                    return self._across(found[-1])
            except (Refused, NonFiniteValue, np.linalg.LinAlgError) as refused:
                reason = reason if str(refused) == TOO_FEW else str(refused)
            except BudgetSpent:
                return "a budget is used up"
        return reason

    def _across(self, last: int) -> Crossing:
        """Step from ``places[last]`` to as far behind the position as it is before it.

        Raises
        ------
        Refused
            The motion found there is not plainly the one that led to the position.
        """
        before = self.places[last]
        half = self.position.t - before.t
        t1 = self._end(half)
        rows = UnitRows(self.engine.dynamics, before)
        leading = _spread_over(self.places[: last + 1], abs(half))
        nodes = [self._accelerated(self._projected(rows, x, x)) for x in leading]
        start, h = nodes[0], t1 - before.t
        if abs(h) * largest(start.vdot) > MAX_CHANGE * largest(start.v):
            raise Refused("the motion comes to rest there")
        q, v = quadrature(start, h, nodes)
        expected = extrapolated(start, t1, nodes)
        for _ in range(SWEEPS):
            far = self._accelerated(self._projected(rows, AcceleratedPoint(t1, q, v, expected), start))
            q, v = quadrature(start, h, [far, *nodes])
        if largest(far.vdot - expected) > SMOOTH * max(largest(x.vdot) for x in nodes):
            raise Refused("accelerations on its far side are not those that lead to it")
        self._check_error(start, (q, v), quadrature(start, h, [far, *nodes[:2]]))
        return Crossing(len(self.places) - 1 - last, h, self._begun(far, h))

    def _end(self, half: float) -> float:
        """The time [s] that is ``half`` [s] behind the position, or the end of the interval."""
        t1 = self.position.t + half
        if (self.stop - t1) * half < 0:
            t1 = self.stop
        if (t1 - self.position.t) / half <= MIN_BEYOND:
            raise Refused("the interval ends just beyond it")
        if (t1 - self.state.t) * half <= 0:
            raise Refused("the run is beyond it")
        return t1

    def _accelerated(self, place: AcceleratedPoint) -> AcceleratedPoint:
        """``place`` with v' of the acceleration level."""
        found = self.engine.acceleration.solve(place.t, place.q, place.v, self.state.lam, self.state.mu)
        self.engine.work.add("residual_evaluations", self.engine.points)
        if not found.converged:
            raise Refused("accelerations beside it are not determined")
        return replace(place, vdot=found.vdot)

    def _projected(self, rows: UnitRows, place: AcceleratedPoint, start: AcceleratedPoint) -> AcceleratedPoint:
        """``place`` projected onto both levels; refused unless that solution is isolated (Newton-Kantorovich)."""
        t, sizes = place.t, np.concatenate([np.full(start.q.size, largest(x)) for x in (start.q, start.v)])
        q, v = rows.projection.nearest(t, place.q, place.v)
        found = replace(place, q=q, v=v)
        if rows.projection.violated(t, q, v, sizes) > PROJECTED:
            raise Refused("no state on its far side meets the constraints")
        if np.linalg.norm(rows.at(found) - rows.at(place), 2) > CLOSE * rows.least(found):
            raise Refused("other motions leave it in nearly the same direction")
        return found

    def _check_error(self, start: AcceleratedPoint, end: tuple[Vector, Vector], rough: tuple[Vector, Vector]) -> None:
        """Refuse a step whose ends by four and by three values of v' differ too much."""
        at, there = (replace(self.state, q=q, v=v) for q, v in ((start.q, start.v), end))
        size = self.tolerances.size(at, there, np.concatenate(rough) - np.concatenate(end))
        if size > max(1.0, MAX_ERROR / math.sqrt(max(self.tolerances.finest, EPS))):
            raise Refused(f"the error of a step across it is {size:.2g} times what the tolerances allow of a step")

    def _begun(self, far: AcceleratedPoint, h: float) -> State:
        """A first state at ``far``, as after a start."""
        found = first_state(self.engine, PhasePoint(far.t, far.q, far.v), self.state.lam, self.state.mu, h)
        if isinstance(found, Failure):
            raise Refused(found.message)
        size_q, size_v = max(found.size_q, self.state.size_q), max(found.size_v, self.state.size_v)
        return replace(found, size_q=size_q, size_v=size_v)


def _spread_over(places: list[AcceleratedPoint], width: float) -> list[AcceleratedPoint]:
    """The last of ``places`` and two before it, at least ``width`` [s] apart; newest first."""
    found = [places[-1]]
    for place in reversed(places):
        if abs(place.t - found[-1].t) >= width:
            found.append(place)
        if len(found) == 3:
            return found
    raise Refused(TOO_FEW)


def quadrature(start: AcceleratedPoint, h: float, nodes: list[AcceleratedPoint]) -> tuple[Vector, Vector]:
    """q and v (n,) after a step of ``h`` [s] from ``start``, integrating the polynomial through v' of ``nodes``."""
    x = [(node.t - start.t) / h for node in nodes]
    weights = coefficients(x, [node.vdot for node in nodes])
    k = np.arange(1.0, len(nodes) + 1)
    v = start.v + h * (1 / k) @ weights
    return start.q + h * start.v + h * h * (1 / (k * (k + 1))) @ weights, v


def extrapolated(start: AcceleratedPoint, t: float, nodes: list[AcceleratedPoint]) -> Vector:
    """v' (n,) at ``t`` [s] by the polynomial through v' of ``nodes``."""
    scale = t - start.t
    weights = coefficients([(node.t - start.t) / scale for node in nodes], [node.vdot for node in nodes])
    return np.asarray(weights.sum(axis=0))


def coefficients(x: list[float], values: list[Vector]) -> Matrix:
    """Coefficients (k, n) of the polynomial through ``values`` at ``x``, the constant first."""
    return np.asarray(np.linalg.solve(np.vander(x, increasing=True), np.stack(values)))


def largest(x: Any) -> float:
    """Largest magnitude."""
    return float(np.abs(x).max())
