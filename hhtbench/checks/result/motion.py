"""Check whether the rows obey the equations of motion: integrate short windows again, each from a row's own state.

The distance of a later row from the motion that starts at the window's first row is the solver's error in the
window.  It may be ``BOUND`` times the error allowed of one step by the tolerance or the step length, together with the
growth of a disturbance of that size in the window: two disturbed motions are integrated too.  So vibrations and unstable
motions set their own bound.

The same bound shows what a window can detect: the distance of the motion from a straight line, the motion without forces.
A window continues until that is ``LEAVES_LINE`` times what is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hhtbench.checks.result.allowed import Missed
from hhtbench.checks.result.flow import Equations, Flow, NotJudged
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request

BOUND = 50.0  # times the error allowed of a step: a window has many, and libraries miss their tolerances tenfold at times
MIN_BOUND = 10.0  # smallest value to which BELIEVABLE lowers BOUND
BELIEVABLE = 0.02  # largest error, over the typical size, that any tolerance allows of a step times BOUND
LEFT = 0.4  # distance from a straight line, over the typical size, that distinguishes the motion from it at any tolerance
AS_FAR = 0.8  # rows this share of the way from the motion to the straight line ignore the forces
LEAVES_LINE = 20.0  # times the bound: distance of the motion from a straight line at which a window ends
MAX_EVALUATIONS = 800  # evaluations of the equations, for one motion in one window
ACCURACY = 1e-3  # error of the integration here, over the allowed error
SMALL = 0.1  # size of disturbances over the allowed error: small, so that their growth is linear
MAX_DISTURBED = 8  # motions beside one that the rows do not follow


class Rows(NamedTuple):
    """States in the order of their times."""

    t: Vector  #: (k,) [s]
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)


class Multipliers(NamedTuple):
    """Multipliers of a window's first row, which select the root of a nonlinear reaction."""

    lam: Vector  #: (m,)
    mu: Vector  #: (p,)


@dataclass(frozen=True)
class Window:
    """Result of one window; errors are divided by what is allowed of a step."""

    start: float  #: [s]
    at: float  #: where the largest error is [s]
    off: float = 0.0  #: the largest error
    bound: float = BOUND  #: largest allowed value of ``off``
    seen: float = 0.0  #: the largest error of a straight line from the first row
    blind: float | None = None  #: error over the straight line's, where the motion has left that by ``LEFT``; None: nowhere
    unfinished: str = ""  #: why it ends before the last row although the motion has not left the straight line

    @property
    def failed(self) -> bool:
        """True if its rows show another motion."""
        return not self.off <= self.bound or (self.blind is not None and not self.blind <= AS_FAR)

    @property
    def judged(self) -> bool:
        """True if the window is long enough to judge: a straight line would have failed."""
        return self.failed or self.seen > self.bound or self.blind is not None


@dataclass(frozen=True)
class Follower:
    """Integrates the windows of one solution."""

    problem: Problem
    request: Request
    equations: Equations
    size: Vector  #: (2n,) typical sizes of y = [q, v]
    allowed: Vector  #: (2n,) the errors allowed of a step, of prescribed steps: of the first ones

    def follow(self, rows: Rows, multipliers: Multipliers | None = None) -> Window:
        """Compare ``rows`` with the motion from the first; integrate disturbed motions too if they do not follow it."""
        t, y = rows.t, np.concatenate([rows.q, rows.v], axis=1)
        self.equations.begin(MAX_EVALUATIONS, multipliers)
        try:
            motion, allowed_until = self._begin(float(t[0]), y[0])
        except NotJudged as reason:
            return Window(float(t[0]), float(t[0]), unfinished=str(reason))
        line = y[0] + (t - t[0])[:, None] * np.concatenate([rows.v[0], 0.0 * rows.v[0]])
        limits: list[Vector] = []

        def left_line(i: int, state: Vector) -> bool:
            limits.append(allowed_until(float(t[i])))
            return self._over(state - line[i], limits[i]) > LEAVES_LINE * self._bound(limits[i])

        states, why = _along(motion, t, left_line)
        if not limits:
            return Window(float(t[0]), float(t[0]), unfinished=why)
        states, allowed = states[: len(limits)], np.array(limits)
        bound = self._bound(allowed[-1])
        window = self._window(t, y, states, line, bound, allowed, why)
        if not window.failed:
            return window
        self.equations.begin(MAX_EVALUATIONS, multipliers)
        k = len(states)

        def far(i: int, state: Vector) -> bool:
            limits.append(allowed_until(float(t[k + i])))
            return self._distance(state - line[k + i]) >= LEFT

        more, why = _along(motion, t[k:], far)
        states, allowed = np.concatenate([states, more.reshape(-1, y.shape[1])])[: len(limits)], np.array(limits)
        carried = np.zeros_like(states)
        for sign in signs(y.shape[1]):
            if not window.failed:
                break
            self.equations.begin(MAX_EVALUATIONS, multipliers)
            change = self.equations.along_constraints(float(t[0]), y[0], sign * allowed[-1], self.size)
            beside, _ = _along(self._flow(float(t[0]), y[0] + SMALL * change, allowed[-1]), t[: len(states)])
            states, carried, allowed = states[: len(beside)], carried[: len(beside)], allowed[: len(beside)]
            carried = np.maximum(carried, np.abs(beside - states) / SMALL)
            window = self._window(t, y, states, line, bound, allowed + np.maximum.accumulate(carried), why)
        return window

    def _begin(self, t: float, y: Vector) -> tuple[Flow, Callable[[float], Vector]]:
        """Return the motion from (t, y), and a function of time that gives the errors allowed of a step (2n,) until then."""
        motion = self._flow(t, y, self.allowed)
        if not self.request.fixed:
            return motion, lambda _: self.allowed
        missed = Missed(motion, (t, self.problem.t_span[1]), self.problem, self.request, self.size)
        return motion, lambda until: np.maximum(self.allowed, missed.until(until))

    def allowed_at(self, t: float, y: Vector) -> Vector:
        """Return the errors allowed of a step (2n,) at (t, y), in the direction in which more of the interval lies."""
        if not self.request.fixed:
            return self.allowed
        end = max(self.problem.t_span, key=lambda end: abs(end - t))
        self.equations.begin(MAX_EVALUATIONS)
        motion = self._flow(t, y, self.allowed, end)
        return np.maximum(self.allowed, Missed(motion, (t, end), self.problem, self.request, self.size).so_far)

    def _bound(self, allowed: Vector) -> float:
        """Return the factor on an ``allowed`` error (2n,) by which rows may be off."""
        return float(np.clip(BELIEVABLE / np.max(allowed / self.size), MIN_BOUND, BOUND))

    def _flow(self, t: float, y: Vector, allowed: Vector, end: float | None = None) -> Flow:
        end, rtol = self.problem.t_span[1] if end is None else end, ACCURACY * float(np.min(allowed / self.size))
        return Flow(self.equations, t, y, end, rtol, self.size)

    def _window(
        self, t: Vector, y: Matrix, states: Matrix, line: Matrix, bound: float, allowed: Matrix | Vector, why: str
    ) -> Window:
        """Compare rows ``y`` and the straight ``line`` with the ``states`` of the motion, (k, 2n), as far as these go."""
        k, limits = len(states), np.broadcast_to(allowed, states.shape)
        resolved = self._distance(limits[0]) <= LEFT / 2  # else the steps are too long, or the tolerance too loose
        off, seen, blind = 0.0, 0.0, None
        worst = 0
        for i in range(k):
            error, left = y[i] - states[i], line[i] - states[i]
            of_row, seen = self._over(error, limits[i]), max(seen, self._over(left, limits[i]))
            if not of_row <= off:
                off, worst = of_row, i
            if blind is None and resolved:
                blind = self._blind(error, left)
        return Window(float(t[0]), float(t[worst]), off=off, bound=bound, seen=seen, blind=blind, unfinished=why)

    def _blind(self, error: Vector, left: Vector) -> float | None:
        """Return the error of q or v over the distance ``left`` of the straight line if that exceeds ``LEFT``, or None."""
        errors, distances = np.split(np.abs(error) / self.size, 2), np.split(np.abs(left) / self.size, 2)
        found = [float(np.max(e) / np.max(d)) for e, d in zip(errors, distances, strict=True) if np.max(d) >= LEFT]
        return max(found, default=None)

    def _distance(self, error: Vector) -> float:
        """Return the largest error of y (2n,), in typical sizes."""
        return float(np.max(np.abs(error) / self.size))

    def _over(self, error: Vector, allowed: Vector) -> float:
        """Return the larger of the errors of q and v (2n,), each divided by what is allowed, in typical sizes."""
        parts = np.split(np.abs(error) / self.size, 2), np.split(allowed / self.size, 2)
        return max(float(np.max(e) / np.max(a)) for e, a in zip(*parts, strict=True))


def _along(motion: Flow, times: Vector, until: Callable[[int, Vector], bool] = lambda i, y: False) -> tuple[Matrix, str]:
    """Return the states of ``motion`` at ``times`` (k, 2n), up to one for which ``until`` holds, and why it ends early, or
    "".
    """
    states: list[Vector] = []
    try:
        for i, t in enumerate(times.tolist()):
            states.append(motion.at(t))
            if until(i, states[i]):
                break
    except NotJudged as reason:
        return np.array(states), str(reason)
    return np.array(states), ""


def signs(size: int) -> Iterator[Vector]:
    """Yield directions of disturbances, (size,) each: pseudo-random signs."""
    index = np.arange(1.0, size + 1)
    for k in range(MAX_DISTURBED):
        yield np.where(np.cos((k + 1.0) * index**2) >= 0.0, 1.0, -1.0)
