"""The host engine: one step of the method with NumPy in charge and compiled functions for the formulas."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import AccelerationLevel, compile_function, route_of
from hhtbench.protocol import DERIVATIVES, declared
from hhtbench.result import Status
from solvers.hht.coefficients import Method
from solvers.hht.discretise import Layout, stages, step_end, step_residual, step_residual_and_matrix
from solvers.hht.newton import Functions, Iteration, Outcome
from solvers.hht.state import State, Step
from solvers.hht.weights import known_values

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Failure:
    """A step that could not be made, with its cause."""

    status: Status
    message: str


def largest(x: Vector) -> float:
    """Largest magnitude in ``x`` (n,)."""
    return float(np.abs(x).max())


def force_and_inverse_mass(dynamics: Any, t: Any, q: Any, v: Any) -> Any:
    """F (n,) and, where the mass varies, M^-1 (n*n,), packed into one vector."""
    force = dynamics.force(t, q, v)
    if dynamics.structure.mass != "variable":
        return force
    return dynamics.xp.concatenate([force, dynamics.xp.linalg.inv(dynamics.mass(t, q)).ravel()])


def inverse_mass_at(dynamics: Any, t: Any, q: Any) -> Any:
    """M^-1 (n, n) at (t, q)."""
    return dynamics.xp.linalg.inv(dynamics.mass(t, q))


class HostEngine:
    """Steps of one method for one system.  Stateless between calls: state in, step or failure out."""

    def __init__(self, dynamics: Any, method: Method, work: Work, fallback: Any = None) -> None:
        self.dynamics, self.method, self.work = dynamics, method, work
        self.structure = dynamics.structure
        moving = method.reaction in ("implicit", "midpoint")
        acts_on_position = method.coefficients.b != 0.0
        unknown = moving and (acts_on_position or self.structure.mass == "variable")
        self.layout = Layout(self.structure, moving, unknown)
        self.points = 0 if route_of(dynamics) == "numpy" else 1  # a NumPy system's callbacks are counted one by one
        self.functions = self._functions(dynamics)
        self._end = compile_function(step_end, dynamics, self.layout)
        self._force = work.counted(compile_function(force_and_inverse_mass, dynamics), residuals=self.points)
        self.inverse_mass = compile_function(inverse_mass_at, dynamics)
        self.acceleration = AccelerationLevel(dynamics)
        self._fallback = fallback  # () -> dynamics with every declared derivative derived afresh, or None

    def _functions(self, dynamics: Any) -> Functions:
        count, points = self.work.counted, self.points
        return Functions(
            residual=count(compile_function(step_residual, dynamics, self.layout), residuals=points),
            matrix=count(compile_function(step_residual_and_matrix, dynamics, self.layout), residuals=points, jacobians=1),
        )

    def force(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Any]:
        """f = M^-1 F (n,) and the inverse mass (n, n) or None where it is constant, (H2).

        Raises
        ------
        NonFiniteValue
            F or M holds NaN or infinity.
        """
        n = self.structure.n
        packed = self._force(t, q, v)
        if not np.isfinite(packed).all():
            self.explain_nonfinite(t, q, v)
        if self.structure.mass == "variable":
            inverse = packed[n:].reshape(n, n)
            return inverse @ packed[:n], inverse
        inverse = self.dynamics.inverse_mass
        return (packed if inverse is None else np.asarray(inverse) @ packed), None

    def step(self, state: State, h: float, t1: float) -> Step | Failure:
        """One step of signed length ``h`` [s] to ``t1``.

        A first failure is retried from the plain guess with damped full Newton, so one stray NaN or a bad
        extrapolation costs a retry and not the run; a second is a :class:`Failure` with its cause.
        """
        if self._too_short(state, h):
            return self._shortest_step(state, h, t1)
        try:
            outcome, packed = self._attempt(state, h, t1, plain=False)
        except NonFiniteValue:
            outcome, packed = Outcome(None, None, "nonfinite"), None
        if outcome.x is None:
            self.work.add("steps_rejected_newton")
            self.work.add("nonfinite_evaluations", int(outcome.failure == "nonfinite"))
            try:
                outcome, packed = self._retry(state, h, t1)
            except NonFiniteValue as error:
                return Failure(Status.nonfinite_callback, f"{error}, in the step from t = {state.t:.17g} with h = {h:g}")
        if outcome.x is None or packed is None:
            return self._failure(outcome, state, h, t1, packed)
        return self._accept(state, h, t1, outcome, packed)

    def _attempt(self, state: State, h: float, t1: float, *, plain: bool) -> tuple[Outcome, Vector]:
        packed = self.layout.pack(known_values(self.method, self.layout, self.inverse_mass, state, h, t1))
        iteration = self._iteration(state, h, packed)
        if plain:
            return iteration.solve_damped(self._plain_guess(state)), packed
        return iteration.solve(self._guess(state, h), state.factor), packed

    def _retry(self, state: State, h: float, t1: float) -> tuple[Outcome, Vector]:
        """Damped Newton from the plain guess, then the same with derivatives that no user wrote."""
        outcome, packed = self._attempt(state, h, t1, plain=True)
        if outcome.x is None and outcome.failure in ("diverged", "singular") and self._fallback is not None:
            trusted = self._fallback()
            iteration = replace(self._iteration(state, h, packed), functions=self._functions(trusted))
            outcome = iteration.solve_damped(self._plain_guess(state))
            if outcome.x is not None:
                names = [name for name in DERIVATIVES if name != "sparsity" and declared(trusted.system, name) is not None]
                warnings.warn(
                    f"Newton's iteration failed with the declared {', '.join(names)} and converged without; derived ones are used "
                    "from here on. `hhtbench check` shows the wrong entries.",
                    UserWarning,
                    stacklevel=2,
                )
                self.functions, self._fallback = iteration.functions, None
        return outcome, packed

    def _iteration(self, state: State, h: float, packed: Vector) -> Iteration:
        n = self.structure.n
        sizes = np.empty(2 * n)
        sizes[:n] = max(state.size_q, abs(h) * state.size_v, TINY)
        sizes[n:] = max(state.size_v, abs(h) * largest(state.vdot), abs(h) * largest(state.f), TINY)
        return Iteration(self.functions, self.layout, packed, h, sizes, self.work.add)

    def _guess(self, state: State, h: float) -> Vector:
        """Unknowns extrapolated from the last two steps of this length, else those of the last."""
        if state.unknowns is None:
            return self._plain_guess(state)
        if state.earlier is not None and state.h == h:
            return 2.0 * state.unknowns - state.earlier
        return state.unknowns

    def _plain_guess(self, state: State) -> Vector:
        """Unknowns from the state alone: its accelerations and multipliers."""
        reaction = state.vdot - state.f if self.structure.m == 0 or self.structure.p == 0 else np.zeros(self.structure.n)
        values = {"a": state.a, "R1": reaction, "lam0": state.lam, "lam1": state.lam, "Rk": reaction, "mu": state.mu}
        return np.concatenate([values[name] for name in self.layout.unknowns])

    def _accept(self, state: State, h: float, t1: float, outcome: Outcome, packed: Vector) -> Step:
        s, x = self.structure, outcome.x
        end = self._end(x, packed)
        q1, v1 = np.array(end[: s.n]), np.array(end[s.n :])
        unknown = self.layout.split(np.asarray(x))
        nothing = np.zeros(0)
        a, lam0, lam1 = unknown["a"], unknown.get("lam0", nothing), unknown.get("lam1", nothing)
        mu = unknown.get("mu", nothing)
        alpha = self.method.coefficients.alpha
        f1 = (a + alpha * state.f) / (1.0 + alpha)  # (H6) solved for f1: no evaluation needed
        inverse = self.inverse_mass(t1, q1) if s.mass == "variable" else None
        new = State(
            t=t1,
            q=q1,
            v=v1,
            a=a,
            f=f1,
            h=h,
            lam=lam1,
            mu=mu,
            vdot=(v1 - state.v) / h,
            inverse_mass=inverse,
            unknowns=x,
            earlier=state.unknowns if state.h == h else None,
            factor=outcome.factor,
            size_q=max(state.size_q, largest(q1)),
            size_v=max(state.size_v, largest(v1)),
        )
        return Step(state=new, lam_start=lam0, lam_end=lam1, mu_half=mu)

    def _too_short(self, state: State, h: float) -> bool:
        """Whether h moves q by less than its roundoff, (H22): the position rows then hold no information."""
        if self.structure.m == 0:
            return False
        moved = abs(h) * largest(state.v) + h * h * largest(state.vdot)
        return moved < EPS * state.size_q or h * h == 0.0

    def _shortest_step(self, state: State, h: float, t1: float) -> Step:
        """(H22): q and v moved along v and the acceleration; multipliers and unknowns as they are."""
        found = self.acceleration.solve(state.t, state.q, state.v, state.lam, state.mu)
        q1, v1 = state.q + h * state.v, state.v + h * found.vdot
        f1, inverse = self.force(t1, q1, v1)
        new = replace(state, t=t1, q=q1, v=v1, f=f1, a=f1, h=h, vdot=found.vdot, inverse_mass=inverse, earlier=None)
        return Step(state=new, lam_start=found.lam, lam_end=found.lam, mu_half=found.mu)

    def _failure(self, outcome: Outcome, state: State, h: float, t1: float, packed: Any) -> Failure:
        where = f"in the step from t = {state.t:.17g} with h = {h:g}"
        if outcome.failure == "nonfinite" and packed is not None and outcome.at is not None:
            known = self.layout.known(packed)
            place = stages(self.dynamics, self.layout, self.layout.split(outcome.at), known)
            q1, v1 = np.asarray(place.q1), np.asarray(place.v1)
            if np.all(np.isfinite(q1)) and np.all(np.isfinite(v1)):
                try:
                    self.explain_nonfinite(t1, q1, v1)
                except NonFiniteValue as error:
                    return Failure(Status.nonfinite_callback, f"{error}, {where}")
        if outcome.failure == "singular":
            return Failure(Status.singular_iteration_matrix, f"the matrix of the step has a zero pivot, {where}")
        return Failure(Status.newton_failed, f"Newton's iteration did not converge, {where}; take a smaller step")

    def explain_nonfinite(self, t: float, q: Vector, v: Vector) -> None:
        """Find the function that is not finite at (t, q, v) and raise :class:`NonFiniteValue` naming it.

        Runs only after a failure; where every function is finite one by one, it raises for "the step".
        """
        d, s = self.dynamics, self.structure
        suspects = {"force": lambda: d.force(t, q, v)}
        if s.mass == "variable":
            suspects["mass_matrix"] = lambda: d.mass(t, q)
        if s.m:
            suspects["constraint"] = lambda: d.constraint(t, q)
            suspects["constraint_jacobian"] = lambda: d.constraint_jacobian(t, q)
            suspects["constraint_velocity"] = lambda: d.constraint_velocity(t, q, v)
        if s.p:
            suspects["velocity_constraint"] = lambda: d.velocity_constraint(t, q, v)
            suspects["velocity_constraint_jacobian"] = lambda: d.velocity_constraint_jacobian(t, q, v)
        suspects["force_jacobians"] = lambda: np.stack([x for x in d.force_jacobians(t, q, v) if x is not None] or [np.zeros(())])
        for name, function in suspects.items():
            value = np.asarray(function())
            if not np.isfinite(value).all():
                where = tuple(int(i) for i in np.argwhere(~np.isfinite(value))[0])
                raise NonFiniteValue(name, where, float(value[where]), t)
        raise NonFiniteValue("the step's residual", (), float("nan"), t)
