"""The local error of a step, (H23) to (H25): along the constraints, filtered by the step's own matrix."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import compile_function
from hhtbench.lowering.diagonal import Diagonal
from solvers.hht.dense import HermiteOutput
from solvers.hht.engine import HostEngine
from solvers.hht.error import Tolerances
from solvers.hht.linear import Factor
from solvers.hht.state import Memory, State, Step
from solvers.hht.weights import first_acceleration

GAUSS = 0.5 + 0.5 / math.sqrt(3.0)  # of the step: there v of dense output errs most; in the middle not at all
ROUNDOFF = 0.01  # of the tolerance of v: what roundoff may contribute to it between steps
EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Estimate:
    """What one step tells about its error."""

    q: Vector  #: (n,) error of q1
    v: Vector  #: (n,) error of v1
    size: float  #: of both over what is allowed, (H26); not finite where it cannot be told
    acceleration: Vector  #: (n,) f + r at the end of the step, (H24)


class Estimator:
    """Estimates for the steps of one engine."""

    def __init__(self, engine: HostEngine, tolerances: Tolerances) -> None:
        self.engine, self.tolerances = engine, tolerances
        self._layout, self._n = engine.layout, engine.structure.n
        source = engine.choice.products or engine.dynamics
        self._reaction = compile_function(reaction_force, source) if engine.structure.constrained else None
        self._levels = compile_function(levels, source) if engine.structure.constrained else None

    def __call__(self, before: State, step: Step) -> Estimate:
        """The local error of ``step``, made from ``before``, which was prepared for step control."""
        after, memory, factor = step.state, before.memory, step.state.factor
        end = after.f + self._reaction_at_end(before, step)
        if factor is None or memory is None:  # (H21): nothing moved
            nothing = np.zeros(self._n)
            return Estimate(nothing, nothing, 0.0, end)
        found = [self._filtered(before, step, memory, end, matrix) for matrix in _matrices(before, factor)]
        q, v, size = max(found, key=lambda each: each[2])
        return Estimate(q, v, max(size, self._between(before, after, factor)), end)

    def _filtered(
        self, before: State, step: Step, memory: Memory, end: Vector, factor: Factor
    ) -> tuple[Vector, Vector, float]:
        """Errors of q1 and v1 (n,) filtered by ``factor``, and their size."""
        after = step.state
        q = self._position_error(before, step, factor)
        v = self._velocity_error(before, after, factor, memory, end) + self._slaved(after, factor, q)
        error = np.concatenate([q, v]) / self.tolerances.weights(before, after)
        size = rms(error) / math.sqrt(self.tolerances.relative(after))  # (H26)
        return q, v, size if math.isfinite(size) else math.inf

    def _reaction_at_end(self, before: State, step: Step) -> Vector | float:
        """r at the end of the step with multipliers of second order, (n,), (H24)."""
        if self._reaction is None:
            return 0.0
        state, h = step.state, step.state.h or 0.0
        share = 1.0 if before.h is None else h / (h + before.h)
        midpoint = self.engine.method.reaction.startswith("midpoint")
        lam, mu = state.lam, state.mu
        if lam.size:
            lam = lam + share * ((lam if midpoint else step.lam_start) - before.lam)
        if mu.size:
            mu = mu + share * (mu - before.mu)
        force = np.asarray(self._reaction(state.t, state.q, state.v, lam, mu))
        return _accelerated(self.engine, state, force)

    def _position_error(self, before: State, step: Step, factor: Factor) -> Vector:
        """(H23), (n,)."""
        c, method, h, memory = self.engine.method.coefficients, self.engine.method, step.state.h or 0.0, before.memory
        raw = (1 + 3 * c.alpha**2) / 12 * (step.state.a - first_acceleration(method, before, h, step.state.a))
        if step.reactions:
            twice = 2.0 if method.reaction.startswith("midpoint") else 1.0
            raw = raw + twice * (3 * c.b - 1) / 6 * (step.reactions[1] - step.reactions[0])
        if step.velocity_reaction is not None and memory is not None and memory.velocity_reaction is not None:
            raw = raw + h / (6 * (h + memory.last)) * (step.velocity_reaction - memory.velocity_reaction)
        increment = self._imbalance(factor, raw * (h / factor.h) ** 2 / c.beta)
        change = factor.change(increment)[: self._n]
        if step.velocity_reaction is None:
            return change
        return change - 0.5 * factor.h**2 * self._layout.split(increment)["Rk"]  # k holds v, not q

    def _velocity_error(self, before: State, after: State, factor: Factor, memory: Memory, end: Vector) -> Vector:
        """(H25), twice filtered, (n,)."""
        h = after.h or 0.0
        start = memory.acceleration
        raw = after.v - before.v - parabola(memory.last, h, memory.earlier, start, end)
        scale = factor.h * self.engine.method.coefficients.gamma
        once = factor.change(self._imbalance(factor, raw / scale))[self._n :]
        return factor.change(self._imbalance(factor, once / scale))[self._n :]

    def _slaved(self, after: State, factor: Factor, q: Vector) -> Vector | float:
        """What the error ``q`` (n,) of q1 makes of v1 across the constraints, whose velocity level moves with it, (n,)."""
        if self._levels is None:
            return 0.0
        m = self.engine.structure.m
        moved = np.asarray(self._levels(after.t, after.q + q, after.v))
        return self._answer(factor, np.zeros(m), -moved[m : 2 * m], -moved[2 * m :])[self._n :]

    def _between(self, before: State, after: State, factor: Factor) -> float:
        """How far dense output is off the constraints inside the step, over the tolerances, (H28)."""
        if self._levels is None:
            return 0.0
        h, m, weights = after.h or 0.0, self.engine.structure.m, self.tolerances.weights(before, after)
        if EPS * after.size_q > ROUNDOFF * abs(h) * float(weights[self._n :].min()):
            return 0.0  # v between is a difference of q over h: nothing but roundoff there
        inside = HermiteOutput(
            np.array([before.t, before.t + h]), np.stack([before.q, after.q]), np.stack([before.v, after.v])
        )
        t = before.t + GAUSS * h
        off = np.asarray(self._levels(t, *inside(t)))
        return rms(self._answer(factor, off[:m], off[m : 2 * m], off[2 * m :]) / weights)

    def _answer(self, factor: Factor, position: Vector, velocity: Vector, rolling: Vector) -> Vector:
        """Changes of q1 and v1 (2n,) that make up for residuals of g (m,), of its velocity level (m,) and of k (p,)."""
        h = factor.h
        rows = {"lam0": position * (2 / (h * h)), "lam1": velocity / h, "mu": rolling / h}
        right = [rows.get(name, np.zeros(size)) for name, size in self._layout.unknowns.items()]
        return factor.change(factor.solve(np.concatenate(right)))

    def _imbalance(self, factor: Factor, acceleration: Vector) -> Vector:
        """Change of the unknowns (size,) that an imbalance of accelerations (n,) in the force rows makes."""
        right = np.zeros(self._layout.size)
        right[: self._n] = acceleration
        return factor.solve(right)


def parabola(last: float, h: float, earliest: Vector, start: Vector, end: Vector) -> Vector:
    """The integral over [0, h] of the quadratic through the values at -last, 0 and h, (H25)."""
    back = -(h**3) / (6 * last * (last + h))
    ahead = h * (2 * h + 3 * last) / (6 * (h + last))
    return back * earliest + (h - back - ahead) * start + ahead * end


def remembered(step: Step, found: Estimate, before: State, h_next: float) -> Memory:
    """What the next step's estimate and the controller need of this one."""
    return Memory(
        h_next=abs(h_next),
        last=step.state.h or 0.0,
        earlier=before.vdot if before.memory is None else before.memory.acceleration,
        acceleration=found.acceleration,
        velocity_reaction=step.velocity_reaction,
        error=found.size,
    )


def reaction_force(dynamics: Any, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
    """Q + Q_k (n,)."""
    force = dynamics.reaction(t, q, lam) if dynamics.structure.m else 0.0
    return force + dynamics.velocity_reaction(t, q, v, mu) if dynamics.structure.p else force


def levels(dynamics: Any, t: Any, q: Any, v: Any) -> Any:
    """g, g_t + g_q v, then k, (2 m + p,)."""
    rows = [dynamics.constraint(t, q), dynamics.constraint_velocity(t, q, v)] if dynamics.structure.m else []
    rows += [dynamics.velocity_constraint(t, q, v)] if dynamics.structure.p else []
    return dynamics.xp.concatenate(rows)


def rms(x: Vector) -> float:
    """Root mean square of ``x``; infinity where it holds what is not finite."""
    return math.sqrt(float(x @ x) / x.size) if np.isfinite(x).all() else math.inf


def _matrices(before: State, factor: Factor) -> list[Factor]:
    """The step's matrix, and the one before it if there is another: stiffness met in this very step is no filter."""
    return [factor] if before.factor is None or before.factor is factor else [factor, before.factor]


def _accelerated(engine: HostEngine, state: State, force: Vector) -> Vector:
    """M^-1 force (n,) at ``state``."""
    inverse = engine.dynamics.inverse_mass if state.inverse_mass is None else state.inverse_mass
    if isinstance(inverse, Diagonal):
        return np.asarray(inverse.values) * force
    return force if inverse is None else np.asarray(inverse) @ force
