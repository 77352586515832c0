"""The equations of one problem at one time, and whether a state is one to linearise them about."""

from __future__ import annotations

from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from hhtbench.linear.tangent import Linear, Terms, linearise, terms_of
from hhtbench.lowering import CONSISTENT, ConstraintLevels, derive, route_of, size_of
from hhtbench.lowering.dynamics.rank import RANK_TOLERANCE
from hhtbench.lowering.equations import Equations
from hhtbench.protocol.arguments import Matrix, Vector, real_number, real_vector
from hhtbench.protocol.errors import ProblemError, Stop
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Unscaled
from hhtbench.protocol.system import declared

EPS = float(np.finfo(float).eps)
WORDS = {
    "balance": "a force or a reaction",
    "position": "a constraint",
    "by_q": "a derivative of the forces by q",
    "by_v": "a derivative of the forces by v",
    "rows": "a constraint Jacobian",
    "drift": "a second derivative of the constraints",
}
DIFFERENCES = 1e-8  # relative error of a derivative by first differences


class Rates(NamedTuple):
    """Accelerations and multipliers at one state: ``vdot`` (n,), ``lam`` (m,), ``mu`` (p,)."""

    vdot: Vector
    lam: Vector
    mu: Vector


class FixedTime:
    """The equations of ``problem`` at the time ``t`` [s], None for its start."""

    def __init__(self, problem: Problem, t: Any = None) -> None:
        if not isinstance(problem, Problem):
            raise TypeError(f"expected a Problem; got {type(problem).__name__}.")
        if declared(problem.system, "layout") is not None:
            raise ProblemError(f"{problem.name} has states or sampled inputs: its rest and small motions are not computed.")
        self.problem = problem
        self.t = problem.t_span[0] if t is None else real_number("t", t, unit=" [s]")
        dynamics = derive(problem.system, self.t, problem.q0, problem.v0)
        self.structure, self._levels = dynamics.structure, ConstraintLevels(dynamics, full=True)
        self._terms = terms_of(dynamics)
        self.error = DIFFERENCES if route_of(dynamics) == "numpy" else EPS  #: relative, of derivatives

    def positions(self, name: str, q: Any) -> Vector:
        """``q`` as a vector (n,)."""
        return real_vector(name, q, self.structure.n)

    def sizes(self, q: Vector) -> Any:
        """Typical sizes of coordinates: as declared, else the largest of ``q`` (n,)."""
        scales = self.problem.scales
        return size_of(q) if isinstance(scales, Unscaled) else np.broadcast_to(scales.q, q.shape)

    def terms(self, q: Vector, v: Vector, at: Rates, rank: int | None = None) -> Terms:
        """The terms of the linearised equations; ``rank`` of the constraints where it is known."""
        try:
            found = self._terms(self.t, q, v, *at, rank=rank)
        except Stop as stop:  # of plain callables
            raise ProblemError(f"{self.problem.name}: {stop}; nothing can be linearised there.") from None
        for name in ("balance", "position", "by_q", "by_v", "rows", "drift"):
            if not np.isfinite(getattr(found, name)).all():
                raise ProblemError(f"{self.problem.name}: {WORDS[name]} is not finite at q = {q}.")
        return found

    def linear(self, terms: Terms, along: Matrix) -> Linear:
        """The linearised motion seen by an observer who moves with ``q' = along q``, (n, n)."""
        try:
            return linearise(terms, along)
        except np.linalg.LinAlgError:
            raise ProblemError(
                f"{self.problem.name}: the mass is singular along a direction that the constraints leave free, so that the "
                "equations determine no accelerations; give every body a mass."
            ) from None

    def rank(self, q: Vector) -> int | None:
        """Rank of the constraints at ``q``; None if q violates them or a row is zero, so that it is none of the motion."""
        at = self._levels.at(self.t, q, np.zeros(q.size))
        return at.rank.rank if at.ranked and at.hold(q, np.zeros(q.size), 2 * CONSISTENT) else None

    def multipliers(self, q: Vector, v: Vector, vdot: Vector) -> Rates:
        """``vdot`` (n,) and the multipliers that come closest to it at (q, v), of least norm where rows are redundant.

        For a reaction that is nonlinear in lam: those of the motion from (q, v), by the problem's guess.
        """
        s = self.structure
        if s.linear_reaction:
            terms = self.terms(q, v, Rates(vdot, np.zeros(s.m), np.zeros(s.p)))
            found: Any = np.linalg.lstsq(terms.columns, terms.balance, rcond=RANK_TOLERANCE)[0]
            return Rates(vdot, found[: s.m], found[s.m :])
        try:
            return Rates(vdot, *Equations(self.problem.starting((self.t, self.t + 1.0), q, v)).multipliers(self.t, q, v))
        except Stop as stop:
            raise ProblemError(f"{self.problem.name}: {stop}; nothing can be linearised there.") from None

    def expect_time_free(self, q: Vector) -> None:
        """Raise a ProblemError if a constraint prescribes a motion at ``t``: rest at ``q`` would violate it."""
        at = self._levels.at(self.t, q, np.zeros(q.size))
        if np.any(np.abs(at.velocity_drift) > CONSISTENT * size_of(self.problem.v0)):
            m, row = self.structure.m, int(np.argmax(np.abs(at.velocity_drift)))
            name = f"constraint row {row} has g_t" if row < m else f"velocity constraint {row - m} has k(t, q, 0)"
            raise ProblemError(
                f"{self.problem.name}: {name} = {at.velocity_drift[row]:.3g} at t = {exact(self.t)} s, so it moves parts by "
                "time and there is no rest and no steady state; hold it still, or give a time t at which it stands still."
            )

    def expect_consistent(self, q: Vector, v: Vector) -> None:
        """Raise a ProblemError if (q, v) violates a constraint."""
        at = self._levels.at(self.t, q, v)
        if not at.hold(q, v, 2 * CONSISTENT):
            worst = max(chain(*at.misfits(q, v)), key=lambda misfit: misfit.relative)
            raise ProblemError(
                f"{self.problem.name}: the state violates a constraint, {worst.name} = {worst.value:.3g}; give a "
                "consistent one, as hb.equilibrium or a solution has it."
            )

    def expect_steady(self, terms: Terms, q: Vector) -> None:
        """Raise a ProblemError if forces that nothing reacts to remain in ``terms``, which hold the steady accelerations."""
        left = np.abs(terms.virtual @ (terms.virtual.T @ terms.balance))
        allowed = CONSISTENT * (np.abs(terms.by_q) @ np.broadcast_to(self.sizes(q), q.shape)).max()
        if left.max() > allowed:
            row = int(left.argmax())
            raise ProblemError(
                f"{self.problem.name}: the state is neither an equilibrium nor a steady motion: a force of {left[row]:.3g} "
                f"remains at coordinate {row}. Start from hb.equilibrium(problem), or give along= for bodies that turn."
            )
