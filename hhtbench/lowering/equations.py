"""For solvers written elsewhere: a problem's equations as plain functions, and a Solution made of their rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hhtbench.lowering import (
    ConstraintLevels,
    derive,
    padded,
    reduce_redundant,
)
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.lowering.dynamics.kkt_rows import Acceleration
from hhtbench.lowering.dynamics.rank import minimum_norm
from hhtbench.protocol.arguments import Matrix, Vector, all_finite
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue, ProblemError, Stop
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import Clock, Work
from hhtbench.solution.request import Request
from hhtbench.solution.result import DenseOutput, Solution, Status


class Equations:
    """The equations of one problem for one solve; every call of :meth:`acceleration` is counted.

    Any :class:`~hhtbench.protocol.errors.Stop` raised ends the solve: pass it to :meth:`solution` with the rows so far.

    Parameters
    ----------
    problem
        The problem; constraint rows that depend on others at the start are left out of the equations.
    request
        Its budgets (``max_evaluations``, ``max_seconds``) are enforced, its ``t_eval`` are the rows of the Solution.

    Raises
    ------
    ProblemError, TypeError
        A function of the system returns something of the wrong shape or kind; no motion is determined at the start.
    """

    def __init__(self, problem: Problem, request: Request | None = None) -> None:
        self.problem, self.request = problem, Request() if request is None else request
        self.work = Work(self.request.max_evaluations, Clock(self.request.max_seconds))
        place = problem.t_span[0], problem.q0, problem.v0
        self._whole = derive(problem.system, *place)
        self._levels = ConstraintLevels(self._whole)
        self._redundant = self._dependent_rows()
        self._dynamics = (reduce_redundant(self._whole, self._redundant) if self._redundant else None) or self._whole
        self._kkt = AccelerationLevel(self._dynamics)
        self._guess = problem.lam_guess, problem.mu_guess  # they pick the root of a nonlinear reaction

    def _dependent_rows(self) -> tuple[int, ...]:
        """Rows of [g; k] that depend on others at the start."""
        if not self._whole.structure.constrained:
            return ()
        at = self._levels.at(self.problem.t_span[0], self.problem.q0, self.problem.v0)
        return at.rank.redundant if at.ranked else ()

    @property
    def redundant(self) -> tuple[int, ...]:
        """Rows of [g; k] that depend on others at the start and are left out."""
        return self._redundant

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self._whole.structure.n

    @property
    def m(self) -> int:
        """Number of position constraints, redundant ones included."""
        return self._whole.structure.m

    @property
    def p(self) -> int:
        """Number of velocity constraints, redundant ones included."""
        return self._whole.structure.p

    def acceleration(self, t: float, q: Vector, v: Vector) -> Vector:
        """``vdot`` (n,) of the underlying ODE, (H16): ``M vdot = F + Q`` with the constraints differentiated.

        Raises
        ------
        Stop
            A budget is used up, a value is not finite, or the equations determine no acceleration.
        """
        self.work.check_time()
        spent, limit = self.work.tally["residual_evaluations"], self.work.max_evaluations
        if limit is not None and spent >= limit:
            raise BudgetSpent("evaluations", limit)
        return self._solved(t, q, v).vdot

    def constraints(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Both constraint levels: ``g`` (m,), and ``g_t + g_q v`` followed by ``k`` (m + p,)."""
        at = self._levels.at(t, q, v)
        return np.asarray(at.position), np.asarray(at.velocity_drift)

    def multipliers(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """``lam`` (m,) and ``mu`` (p,) of the acceleration level; of least norm where rows are redundant.

        Raises
        ------
        Stop
            As :meth:`acceleration`.
        """
        return self._all_of(t, q, v)[1:]

    def solution(
        self, t: Any, q: Any, v: Any, *, stopped: Stop | None = None, message: str = "", **counted: int
    ) -> Solution:
        """A Solution from the rows at the ends of a solver's steps, the start among them.

        Rows at the request's ``t_eval`` are interpolated by cubic Hermite polynomials (q from v, v from the accelerations:
        order four), multipliers recovered from the acceleration level; none of this counts as work of the steps.

        Parameters
        ----------
        t, q, v
            (k,), (k, n), (k, n): times [s] and states.
        stopped
            The :class:`Stop` that ended the solve early; None if its end was reached.
        counted
            Fields of :class:`~hhtbench.Counters` that the solver counts itself; steps and evaluations are known.

        Raises
        ------
        ProblemError
            The shapes of the rows do not match.
        """
        t, q, v = (np.asarray(x, dtype=np.float64) for x in (t, q, v))
        if t.ndim != 1 or q.shape != (t.size, self.n) or v.shape != q.shape:
            shapes = ", ".join(str(x.shape) for x in (t, q, v))
            raise ProblemError(f"t, q, v must have shapes (k,), (k, {self.n}), (k, {self.n}); got {shapes}.")
        self.work.only_output_is_left()
        for name, value in {"steps_accepted": max(t.size - 1, 0), **counted}.items():
            self.work.add(name, value - self.work.tally[name])
        with self.work.for_output():
            vdot, lam, mu, note = self._levels_at(t, q, v)
            t, q, v = t[: len(vdot)], q[: len(vdot)], v[: len(vdot)]
            dense = Hermite.of(t, q, v, vdot) if t.size > 1 else None
            if self.request.t_eval is not None:
                t, q, v = self._output(self.request.t_eval, t, q, v, dense)
                _, lam, mu, note = self._levels_at(t, q, v)
        status = _status_of(stopped or note)
        return Solution(
            t=t[: len(lam)],
            q=q[: len(lam)],
            v=v[: len(lam)],
            lam=lam,
            mu=mu,
            status=status,
            message=f"{stopped or note}; {status.text}" if stopped or note else status.text,
            counters=self.work.counters(),
            interpolant=dense,
        )

    def _levels_at(self, t: Vector, q: Matrix, v: Matrix) -> tuple[Matrix, Matrix, Matrix, Stop | None]:
        """Accelerations and multipliers of the rows, up to the first that has none, and the reason for that."""
        found, stopped = [], None
        for row in zip(t, q, v, strict=True):
            try:
                found.append(self._all_of(*row))
            except Stop as stop:
                stopped = stop
                break
        sizes = self.n, self.m, self.p
        vdot, lam, mu = (np.reshape([row[i] for row in found], (len(found), size)) for i, size in enumerate(sizes))
        return vdot, lam, mu, stopped

    def _output(
        self, asked: Vector, t: Vector, q: Matrix, v: Matrix, dense: Hermite | None
    ) -> tuple[Vector, Matrix, Matrix]:
        """States interpolated at the times ``asked`` that were reached."""
        if t.size == 0:
            return t, q, v
        forward = self.problem.t_span[1] >= self.problem.t_span[0]
        asked = asked[asked <= t[-1]] if forward else asked[asked >= t[-1]]
        if dense is None:  # the start is all there is
            return asked, np.repeat(q, asked.size, axis=0), np.repeat(v, asked.size, axis=0)
        return asked, *dense(asked)

    def _solved(self, t: float, q: Vector, v: Vector) -> Acceleration:
        found = self._kkt.solve(t, q, v, *self._guess)
        self.work.add("residual_evaluations")
        if not all_finite(found.vdot):
            place = int(np.flatnonzero(~np.isfinite(found.vdot))[0])
            raise NonFiniteValue("the acceleration", (place,), float(found.vdot[place]), t)
        if not found.converged:
            raise Undetermined(f"the KKT matrix [[M, C^T], [C, 0]] determines no accelerations at t = {exact(t)}")
        if not self._dynamics.structure.linear_reaction:
            self._guess = found.lam, found.mu
        return found

    def _all_of(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector, Vector]:
        """``vdot`` (n,), ``lam`` (m,), ``mu`` (p,), redundant rows included."""
        found = self._solved(t, q, v)
        if self._dynamics is self._whole:
            return found.vdot, found.lam, found.mu
        lam, mu = padded(self._dynamics, found.lam[None], found.mu[None])
        least = minimum_norm(self._levels.at(t, q, v).rows, np.concatenate([lam[0], mu[0]]), self._redundant)
        return found.vdot, least[: self.m], least[self.m :]


class Undetermined(Stop):
    """Raised where the equations determine no acceleration."""


@dataclass(frozen=True)
class Hermite:
    """Cubic Hermite interpolation between the ends ``t`` (k,) of steps; order four."""

    t: Vector
    of_q: CubicHermiteSpline
    of_v: CubicHermiteSpline

    @classmethod
    def of(cls, t: Vector, q: Matrix, v: Matrix, vdot: Matrix) -> Hermite:
        """Build it from at least two rows of states and accelerations, (k, n) each."""
        order = slice(None) if t[-1] > t[0] else slice(None, None, -1)
        x = t[order]
        return cls(t, CubicHermiteSpline(x, q[order], v[order]), CubicHermiteSpline(x, v[order], vdot[order]))

    def __call__(self, t: Any) -> DenseOutput:
        """``q, v`` (n,) at one time, (k, n) at k times.  Raises ProblemError outside the steps."""
        low, high = min(self.t[0], self.t[-1]), max(self.t[0], self.t[-1])
        if not np.all((np.asarray(t) >= low) & (np.asarray(t) <= high)):
            raise ProblemError(f"the solution covers [{exact(low)}, {exact(high)}] s; it is not extrapolated.")
        return DenseOutput(self.of_q(t), self.of_v(t))


def _status_of(stopped: Stop | None) -> Status:
    if isinstance(stopped, BudgetSpent):
        return Status.deadline if stopped.budget == "seconds" else Status.evaluation_budget
    if isinstance(stopped, NonFiniteValue):
        return Status.nonfinite_callback
    return Status.success if stopped is None else Status.singular_iteration_matrix
