"""The local error of a step, (H23) to (H25): along the constraints, filtered by the step's own matrix."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import compile_function
from solvers.hht.engine import HostEngine
from solvers.hht.error import Tolerances
from solvers.hht.laws import EPS, GAUSS, ROUNDOFF, cubic, rms
from solvers.hht.linear import Factor
from solvers.hht.local_error import levels, pack, raw_errors
from solvers.hht.state import Memory, State, Step
from solvers.hht.weights import first_acceleration


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
        self._raw = compile_function(raw_errors, source, engine.method, engine.layout)
        self._levels = compile_function(levels, source) if engine.structure.constrained else None

    def __call__(self, before: State, step: Step) -> Estimate:
        """The local error of ``step``, made from ``before``, which was prepared for step control."""
        after, factor = step.state, step.state.factor
        raw_q, raw_v, end = np.split(np.asarray(self._raw(self._given(before, step))), 3)
        if factor is None or before.memory is None:  # (H21): nothing moved
            nothing = np.zeros(self._n)
            return Estimate(nothing, nothing, 0.0, end)
        found = [self._filtered(before, step, raw_q, raw_v, matrix) for matrix in _matrices(before, factor)]
        q, v, size = max(found, key=lambda each: each[2])
        return Estimate(q, v, max(size, self._between(before, after, factor)), end)

    def _given(self, before: State, step: Step) -> Vector:
        """What :func:`~solvers.hht.local_error.raw_errors` takes."""
        after, memory, nothing = step.state, before.memory, np.zeros(self._n)
        h = after.h or 0.0
        last = memory.last if memory is not None else h
        rolling = memory is not None and memory.velocity_reaction is not None
        scalars = {
            "h": h,
            "last": last,
            "share": 1.0 if before.h is None else h / (h + before.h),
            "rolling": h / (6 * (h + last)) if rolling else 0.0,
        }
        a0 = first_acceleration(self.engine.method, before, h, after.a)
        start, end = step.reactions or (nothing, nothing)
        arrays = {
            "t1": [after.t],
            "q1": after.q,
            "v1": after.v,
            "v0": before.v,
            "a0": a0,
            "a1": after.a,
            "f1": after.f,
            "earlier": nothing if memory is None else memory.earlier,
            "acceleration": nothing if memory is None else memory.acceleration,
            "R0": start,
            "R1": end,
            "lam": before.lam,
            "lam_start": step.lam_start,
            "lam_end": after.lam,
            "Rk": nothing if step.velocity_reaction is None else step.velocity_reaction,
            "Rk_before": memory.velocity_reaction if memory is not None and rolling else nothing,
            "mu": before.mu,
            "mu_half": after.mu,
            "inverse_mass": after.inverse_mass,
        }
        return np.asarray(pack(self._layout, np, scalars, arrays))

    def _filtered(
        self, before: State, step: Step, raw_q: Vector, raw_v: Vector, factor: Factor
    ) -> tuple[Vector, Vector, float]:
        """Errors of q1 and v1 (n,) filtered by ``factor``, and their size."""
        after = step.state
        q = self._position_error(raw_q, after.h or 0.0, factor)
        v = self._velocity_error(raw_v, factor) + self._slaved(after, factor, q)
        error = np.concatenate([q, v]) / self.tolerances.weights(before, after)
        size = rms(error) / math.sqrt(self.tolerances.relative(after))  # (H26)
        return q, v, size if math.isfinite(size) else math.inf

    def _position_error(self, raw: Vector, h: float, factor: Factor) -> Vector:
        """(H23) along the constraints, (n,)."""
        increment = self._imbalance(factor, raw * (h / factor.h) ** 2 / self.engine.method.coefficients.beta)
        change = factor.change(increment)[: self._n]
        if "Rk" not in self._layout.unknowns:
            return change
        return change - 0.5 * factor.h**2 * self._layout.split(increment)["Rk"]  # k holds v, not q

    def _velocity_error(self, raw: Vector, factor: Factor) -> Vector:
        """(H25), twice filtered, (n,)."""
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
        inside = cubic(GAUSS, h, before.q, after.q, before.v, after.v)
        off = np.asarray(self._levels(before.t + GAUSS * h, *inside))
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


def _matrices(before: State, factor: Factor) -> list[Factor]:
    """The step's matrix, and the one before it if there is another: stiffness met in this very step is no filter."""
    same = before.factor is None or before.factor.maps is factor.maps  # a kept one has a rate of its own
    return [factor] if same or before.factor is None else [factor, before.factor]
