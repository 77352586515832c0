"""Independent integration from a given state: accelerations from the acceleration level, steps by DOP853.

No code of ``solvers`` is used, and over the short windows in which it is needed the drift off the constraints is
below its tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import DOP853
from scipy.linalg import lapack

from hhtbench.checks.independent import independent
from hhtbench.checks.jumps import find_jumps
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.protocol.arguments import Vector, all_finite
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem

FINEST, COARSEST = 1e-12, 1e-6  # relative tolerances of the steps


class NotJudged(Exception):
    """The motion cannot be integrated here; the text gives the reason."""


class Equations:
    """Right-hand side y' of y = [q, v] (2n,), with a limit on evaluations, and the jumps of v at prescribed motions."""

    def __init__(self, problem: Problem) -> None:
        self.jumps = find_jumps(problem)
        if self.jumps.declined:
            raise NotJudged(self.jumps.declined)
        t, q, v = problem.t_span[0], problem.q0, problem.v0
        whole = derive(problem.system, t, q, v)
        dynamics, _ = independent(whole, t, q, v)
        if dynamics is None:
            raise NotJudged("its constraints are redundant, and a declared reaction may depend on every multiplier")
        self._levels = ConstraintLevels(dynamics, full=True) if dynamics.structure.constrained else None
        self._level, self._n = AccelerationLevel(dynamics), q.size
        self._whole = self._level if whole is dynamics else AccelerationLevel(whole)  # with all of redundant constraints
        self._sizes = dynamics.structure.m, dynamics.structure.p
        self.linear = dynamics.structure.linear_reaction
        self._multipliers: Any = (None, None)
        self._left = self._limit = 0

    def begin(self, limit: int, multipliers: Any = None) -> None:
        """Allow ``limit`` evaluations; ``multipliers`` lam (m,), mu (p,) select the root of a nonlinear reaction."""
        self._left = self._limit = limit
        if not self.linear and multipliers is not None and tuple(map(np.size, multipliers)) == self._sizes:
            self._multipliers = tuple(multipliers)

    @property
    def used(self) -> int:
        """Evaluations since :meth:`begin`."""
        return min(self._limit, self._limit - self._left)

    def along_constraints(self, t: float, y: Vector, change: Vector, size: Vector) -> Vector:
        """Project a small ``change`` of y (2n,) onto the tangent space of the constraints; (2n,), in units of ``size``."""
        if self._levels is None:
            return change
        n, m = self._n, self._sizes[0]
        rows = self._levels.at(t, y[:n].copy(), y[n:].copy()).rows
        parts = (rows[:m], change[:n], size[:n]), (rows, change[n:], size[n:])
        return np.concatenate([x - s * np.linalg.lstsq(c * s, c @ x)[0] if len(c) else x for c, x, s in parts])

    def force(self, t: float, y: Vector) -> Vector:
        """Return the forces without the reactions, (n,)."""
        return -self._left_over(self._level, t, y, np.zeros(sum(self._sizes)))

    def needed(self, t: float, y: Vector) -> tuple[Vector, Vector] | None:
        """Return accelerations (n,) and reaction (n,) from the acceleration level; None if they are not determined."""
        try:
            found = self._level.solve(t, y[: self._n].copy(), y[self._n :].copy(), *self._multipliers)
        except NonFiniteValue:
            return None
        return (found.vdot, self._reaction(self._level, t, y, (found.lam, found.mu))) if found.converged else None

    def reaction(self, t: float, y: Vector, multipliers: Any) -> Vector:
        """Return the reaction Q(lam) + Q_k(mu) (n,) of ``multipliers`` lam (m,), mu (p,)."""
        return self._reaction(self._whole, t, y, multipliers)

    def _reaction(self, level: AccelerationLevel, t: float, y: Vector, multipliers: Any) -> Vector:
        given = np.concatenate(multipliers)
        return self._left_over(level, t, y, 0.0 * given) - self._left_over(level, t, y, given)

    def _left_over(self, level: AccelerationLevel, t: float, y: Vector, multipliers: Vector) -> Vector:
        """Return minus the sum of forces and reactions of ``multipliers`` (m + p,), (n,)."""
        n = self._n
        x = np.concatenate([np.zeros(n), multipliers])
        return np.asarray(level.terms(t, y[:n].copy(), y[n:].copy(), x)[0][:n], dtype=np.float64)

    def __call__(self, t: float, y: Vector) -> Vector:
        """Return [v, vdot]; NaN if the accelerations are not determined, so that the step is shortened."""
        self._left -= 1
        if self._left < 0:
            raise NotJudged(f"the motion in it takes more than {self._limit} evaluations")
        n = self._n
        q, v = y[:n].copy(), y[n:].copy()
        try:
            vdot = self._of_linear(float(t), q, v) if self.linear else None
            if vdot is None:
                found = self._level.solve(float(t), q, v, *self._multipliers)
                vdot = found.vdot if found.converged else np.full(n, np.nan)
                self._multipliers = (found.lam, found.mu) if found.converged else self._multipliers
        except NonFiniteValue:
            vdot = np.full(n, np.nan)
        return np.concatenate([v, vdot])

    def _of_linear(self, t: float, q: Vector, v: Vector) -> Vector | None:
        """Return vdot (n,) by a plain LU, ten times faster than the expert driver; None if the matrix is sparse or
        singular.
        """
        size = self._n + sum(self._sizes)
        residual, matrix = self._level.terms(t, q, v, np.zeros(size))
        if not isinstance(matrix, np.ndarray):
            return None
        *_, x, info = lapack.dgesv(matrix, residual)
        return -x[: self._n] if info == 0 and all_finite(x) else None


@dataclass(frozen=True)
class Crossing:
    """A jump that a motion has crossed."""

    i: int  #: its number
    t: float  #: [s]
    y: Vector  #: [q, v] (2n,) before it
    change: Vector  #: change of v (n,)


class Flow:
    """The motion from (t, y) towards ``end`` [s]; its steps are made when a later state is asked for.

    It is integrated piecewise: up to a jump of the velocities, and on with the velocities after the impulse.
    """

    def __init__(self, equations: Equations, t: float, y: Vector, end: float, rtol: float, size: Vector) -> None:
        """Start at (t, y) with the relative tolerance ``rtol``, scaled by the ``size`` (2n,) of y."""
        rtol = min(max(rtol, FINEST), COARSEST)
        self.equations, self.t, self._y, self._end, self._forward = equations, t, y, end, end > t
        self._tolerances: Any = {"rtol": rtol, "atol": rtol * size}
        self.jumps = equations.jumps.towards(end - t)
        self._ahead = self.jumps.between(t, end)
        self.pieces: list[Any] = []  #: dense outputs of the steps so far
        self.crossed: list[Crossing] = []  #: the jumps so far
        self._begin(t, y)
        self.rate: Vector = self._steps.f  #: y' (2n,) at ``t``

    def at(self, t: float) -> Vector:
        """Return y (2n,) at ``t``, or at the end of the interval if that comes first."""
        while self._steps.t != t and (self._steps.t < t) == self._forward:
            if self._steps.status == "running":
                self._step()
            elif self._ahead:
                self._cross(self._ahead.pop(0))
            else:
                break
        if self._steps.t == t:  # behind a jump there, maybe, of which the last piece knows nothing
            return np.array(self._steps.y, dtype=np.float64)
        for piece in reversed(self.pieces):
            if (piece.t_old <= t) == self._forward or piece.t_old == t:
                return np.asarray(piece(t), dtype=np.float64)
        return self._y

    def change_at(self, i: int, y: Vector) -> Vector:
        """Return the change of v (n,) by the impulse of jump ``i`` at the state y = [q, v] (2n,) before it."""
        q, v = np.split(y, 2)
        try:
            return self.jumps.velocities(i, q.copy(), v.copy())[0] - v
        except ValueError as error:
            raise NotJudged(str(error)) from error

    def _begin(self, t: float, y: Vector) -> None:
        """Start integrating from (t, y) to the next jump."""
        end = float(self.jumps.before[self._ahead[0]]) if self._ahead else self._end
        with np.errstate(all="ignore"):
            self._steps: Any = DOP853(self.equations, t, y, end, **self._tolerances)
        if not np.isfinite(self._steps.f).all():
            raise NotJudged(f"the accelerations are not determined at t = {exact(t)}")

    def _step(self) -> None:
        with np.errstate(all="ignore"):
            self._steps.step()
        if self._steps.status == "failed":
            raise NotJudged(f"the accelerations are not determined, or not bounded, after t = {exact(self._steps.t)}")
        self.pieces.append(self._steps.dense_output())

    def _cross(self, i: int) -> None:
        y = np.asarray(self._steps.y)
        change = self.change_at(i, y)
        self.crossed.append(Crossing(i, float(self.jumps.times[i]), y, change))
        self._begin(float(self.jumps.after[i]), y + np.concatenate([0.0 * change, change]))
