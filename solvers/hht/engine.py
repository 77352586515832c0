"""The host engine: one step of the method with NumPy in charge and compiled functions for the formulas."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import AccelerationLevel, ConstraintLevels, Dynamics, compile_function
from hhtbench.lowering.dynamics.diagonal import Diagonal
from hhtbench.protocol import DERIVATIVES, declared
from hhtbench.result import Status
from solvers._finite import explain_nonfinite, inverse_mass_at
from solvers._start import Failure, points_of
from solvers.hht.choose import Choice
from solvers.hht.coefficients import NEAR_HALF, Method
from solvers.hht.discretise import step_end, step_residual, step_residual_and_matrix
from solvers.hht.laws import EPS, EXTRAPOLATION, HIGHEST, TINY, force_at_end, moves_nothing
from solvers.hht.layout import Layout
from solvers.hht.newton import Functions, Iteration, Outcome
from solvers.hht.state import State, Step
from solvers.hht.weights import known_values


def largest(x: Vector) -> float:
    """Largest magnitude in ``x`` (n,)."""
    return float(np.abs(x).max())


def force_and_inverse_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """F (n,) and, where the mass varies, M^-1 (n*n,), packed into one vector."""
    force = dynamics.force(t, q, v)
    if dynamics.structure.mass != "variable":
        return force
    return dynamics.xp.concatenate([force, inverse_mass_at(dynamics, t, q).ravel()])


def foretold(unknowns: Vector, earlier: Matrix) -> int:
    """The degree of the polynomial through ``earlier`` (k, size) steps that would have told ``unknowns`` (size,) best."""
    errors = [largest(unknowns - weights @ earlier[: weights.size]) for weights in EXTRAPOLATION[: len(earlier)]]
    return int(np.argmin(errors))


def layout_of(dynamics: Dynamics, method: Method) -> Layout:
    """The unknowns of ``method``'s steps."""
    moving = method.reaction in ("implicit", "midpoint")
    unknown = moving and (method.coefficients.b != 0.0 or dynamics.structure.mass == "variable")
    return Layout(dynamics.structure, moving, unknown)


class HostEngine:
    """Steps of one method for one system: state in, step or failure out.

    Between calls it keeps only that declared derivatives were given up, for good, and counts what it evaluates.
    """

    why = "host"  #: which engine this is, and why

    def __init__(self, dynamics: Dynamics, method: Method, work: Work, fallback: Any = None, *, choice: Choice) -> None:
        self.dynamics, self.method, self.work = dynamics, method, work
        self.structure = dynamics.structure
        self.layout = layout_of(dynamics, method)
        self.points = points_of(dynamics)  # a NumPy system's callbacks are counted one by one
        self.choice = choice
        self.functions = self._functions(dynamics)
        self._end = compile_function(step_end, self.choice.products or dynamics, self.layout)
        self._force = work.counted(compile_function(force_and_inverse_mass, dynamics), residuals=self.points)
        self.inverse_mass = compile_function(inverse_mass_at, dynamics)
        self.acceleration = AccelerationLevel(dynamics)
        self._fallback: Any = (
            fallback if self.choice.coloured is None else None
        )  # () -> dynamics with every declared derivative derived afresh, or None
        self.distrusts = False  #: whether the declared derivatives were given up

    def _functions(self, dynamics: Dynamics) -> Functions:
        count, points, choice = self.work.counted, self.points, self.choice
        full = compile_function(step_residual_and_matrix, dynamics, self.layout)
        entries = full if choice.coloured is None else choice.coloured.packed
        return Functions(
            residual=count(compile_function(step_residual, choice.products or dynamics, self.layout), residuals=points),
            matrix=count(entries, residuals=points, jacobians=1),
            linear=choice.linear,
            disturb=None if choice.coloured is None else self.layout.disturbed,
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
            explain_nonfinite(self.dynamics, t, q, v)
        if self.structure.mass == "variable":
            inverse = packed[n:].reshape(n, n)
            return inverse @ packed[:n], inverse
        inverse = self.dynamics.inverse_mass
        if isinstance(inverse, Diagonal):
            return np.asarray(inverse.values) * packed, None
        return (packed if inverse is None else np.asarray(inverse) @ packed), None

    def step(self, state: State, h: float, t1: float) -> Step | Failure:
        """One step of signed length ``h`` [s] to ``t1``.

        A first failure is retried from the plain guess with full Newton, whole and then damped, so one stray NaN or a bad
        extrapolation costs a retry and not the run; a third is a :class:`Failure` with its cause.
        """
        if self._moves_nothing(state, h):
            taken = self._guarded(self._shortest, state, h, t1)
            if isinstance(taken, Step):
                return taken
        taken = self._guarded(self._extrapolated, state, h, t1)
        if isinstance(taken, Step):
            return taken
        self.work.add("steps_rejected_newton")
        for attempt in (self._whole, self._damped):
            taken = self._guarded(attempt, state, h, t1)
            if isinstance(taken, Step):
                return taken
        return self._failure(taken, state, h, t1)

    def _guarded(self, attempt: Callable[..., Step | Outcome], state: State, h: float, t1: float) -> Step | Outcome:
        """``attempt``, with a value that is not finite turned into an outcome and counted."""
        try:
            taken = attempt(state, h, t1)
        except NonFiniteValue as error:
            taken = Outcome(None, None, "nonfinite", cause=error)
        if isinstance(taken, Outcome):
            self.work.add("nonfinite_evaluations", int(taken.failure == "nonfinite"))
        return taken

    def _extrapolated(self, state: State, h: float, t1: float) -> Step | Outcome:
        """Newton with the kept factorisation from the extrapolated guess."""
        packed = self._packed(state, h, t1)
        outcome = self._iteration(state, h, packed).solve(self._guess(state, h), state.factor)
        return self._accept(state, h, t1, outcome, packed)

    def _whole(self, state: State, h: float, t1: float) -> Step | Outcome:
        """Newton with fresh matrices from the plain guess."""
        packed, guess = self._packed(state, h, t1), self._plain_guess(self.with_multipliers(state))
        return self._accept(state, h, t1, self._iteration(state, h, packed).solve_whole(guess), packed)

    def _damped(self, state: State, h: float, t1: float) -> Step | Outcome:
        """Damped Newton from the plain guess, then the same with derivatives that no user wrote."""
        packed, guess = self._packed(state, h, t1), self._plain_guess(self.with_multipliers(state))
        outcome = self._iteration(state, h, packed).solve_damped(guess)
        if outcome.failure in ("diverged", "singular") and self._fallback is not None:
            declared_ones = self.functions, self._fallback, False
            names = self.distrust()
            outcome = self._iteration(state, h, packed).solve_damped(guess)
            if outcome.x is None:
                self.functions, self._fallback, self.distrusts = declared_ones
            else:
                warnings.warn(
                    f"Newton's iteration failed with the declared {names} and converged without; derived ones are used "
                    "from here on. `hhtbench check` shows the wrong entries.",
                    UserWarning,
                    stacklevel=2,
                )
        return self._accept(state, h, t1, outcome, packed)

    def distrust(self) -> str:
        """Give up the declared derivatives in Newton's matrix for derived ones; returns their names."""
        trusted = self._fallback()
        self.functions, self._fallback, self.distrusts = self._functions(trusted), None, True
        return ", ".join(name for name in DERIVATIVES if declared(trusted.system, name) is not None)

    def _packed(self, state: State, h: float, t1: float) -> Vector:
        return self.layout.pack(known_values(self.method, self.layout, self.inverse_mass, state, h, t1))

    def with_multipliers(self, state: State) -> State:
        """``state`` with multipliers of the acceleration level: those of a very short last step are roundoff over h^2."""
        if not self.structure.constrained:
            return state
        found = self.acceleration.solve(state.t, state.q, state.v, state.lam, state.mu)
        self.work.add("residual_evaluations", self.points)
        return state if not found.converged else replace(state, lam=found.lam, mu=found.mu, vdot=found.vdot)

    def recovered(self, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix) -> Any:
        """Which rows (k,) have their multipliers from the acceleration level in ``lam`` and ``mu`` already: here none."""
        return np.zeros(times.size, dtype=bool)

    def _iteration(self, state: State, h: float, packed: Vector) -> Iteration:
        accelerated = abs(h) * max(largest(state.vdot), largest(state.f), largest(state.a))
        sizes = max(state.size_q, abs(h) * state.size_v, TINY), max(state.size_v, accelerated, TINY)
        return Iteration(self.functions, self.layout, packed, h, sizes, self.work.add, self.choice.newton)

    def _guess(self, state: State, h: float) -> Vector:
        """Unknowns extrapolated from steps of this length, else those of the last."""
        if state.unknowns is None:
            return self._plain_guess(state)
        if state.earlier is None or state.h != h:
            return state.unknowns
        weights = EXTRAPOLATION[foretold(state.unknowns, state.earlier)]
        return weights[0] * state.unknowns + weights[1:] @ state.earlier[: weights.size - 1]

    def _earlier(self, state: State, h: float) -> Any:
        """What :meth:`_guess` will need of the steps before, newest first, (k, size)."""
        if state.h != h or state.unknowns is None:
            return None
        last = state.unknowns[None, :]
        return last if state.earlier is None else np.concatenate([last, state.earlier[: HIGHEST - 1]])

    def _plain_guess(self, state: State) -> Vector:
        """Unknowns from the state alone: its accelerations and multipliers."""
        reaction = state.vdot - state.f if self.structure.m == 0 or self.structure.p == 0 else np.zeros(self.structure.n)
        values = {"a": state.a, "R1": reaction, "lam0": state.lam, "lam1": state.lam, "Rk": reaction, "mu": state.mu}
        return np.concatenate([values[name] for name in self.layout.unknowns])

    def _accept(self, state: State, h: float, t1: float, outcome: Outcome, packed: Vector) -> Step | Outcome:
        s, x = self.structure, outcome.x
        if x is None:
            return outcome
        end = self._end(x, packed)
        q1, v1 = np.array(end[: s.n]), np.array(end[s.n : 2 * s.n])
        unknown = self.layout.split(np.asarray(x))
        nothing = np.zeros(0)
        a, lam0, lam1 = unknown["a"], unknown.get("lam0", nothing), unknown.get("lam1", nothing)
        mu = unknown.get("mu", nothing)
        alpha = self.method.coefficients.alpha
        f1 = force_at_end(alpha, a, state.f)
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
            earlier=self._earlier(state, h),
            factor=outcome.factor,
            size_q=max(state.size_q, largest(q1)),
            size_v=max(state.size_v, largest(v1)),
        )
        reactions = (np.array(end[2 * s.n : 3 * s.n]), np.array(end[3 * s.n :])) if s.m else None
        return Step(
            state=new, lam_start=lam0, lam_end=lam1, mu_half=mu, reactions=reactions, velocity_reaction=unknown.get("Rk")
        )

    def _moves_nothing(self, state: State, h: float) -> bool:
        """Whether h moves q by less than its roundoff, as far as v and the acceleration tell, (H21)."""
        if self.structure.m == 0:
            return False
        return moves_nothing(h, largest(state.v), largest(state.vdot), state.size_q, state.size_v)

    def _shortest(self, state: State, h: float, t1: float) -> Step | Outcome:
        """(H21): q and v moved along v and the acceleration, if both levels hold as before: a drive may start from rest."""
        found = self.acceleration.solve(state.t, state.q, state.v, state.lam, state.mu)
        self.work.add("residual_evaluations", self.points)
        q1, v1 = state.q + h * state.v, state.v + h * found.vdot
        if not found.converged or not self._levels_kept(state, t1, q1, v1):
            return Outcome(None, None, "diverged")
        f1, inverse = self.force(t1, q1, v1)
        new = replace(state, t=t1, q=q1, v=v1, f=f1, a=f1, h=h, vdot=found.vdot, inverse_mass=inverse, earlier=None)
        return Step(state=new, lam_start=found.lam, lam_end=found.lam, mu_half=found.mu)

    def _levels_kept(self, state: State, t1: float, q1: Vector, v1: Vector) -> bool:
        """Whether neither constraint level is further from zero at (t1, q1, v1) than at ``state``, but for roundoff."""
        levels = ConstraintLevels(self.dynamics)
        before, after = levels.at(state.t, state.q, state.v), levels.at(t1, q1, v1)
        room = 8 * EPS * np.abs(after.position_jacobian).sum(axis=1) * state.size_q
        velocity_room = 8 * EPS * np.abs(after.rows).sum(axis=1) * max(state.size_v, largest(v1))
        return bool(
            np.all(np.abs(after.position) <= np.abs(before.position) + room)
            and np.all(np.abs(after.velocity_drift) <= np.abs(before.velocity_drift) + velocity_room)
        )

    def _failure(self, outcome: Outcome, state: State, h: float, t1: float) -> Failure:
        where = f"in the step from t = {state.t:.17g} with h = {h:g}"
        if outcome.failure == "nonfinite":
            return Failure(Status.nonfinite_callback, f"{self._cause(outcome, state, h, t1)}, {where}")
        if outcome.failure == "singular":
            return Failure(Status.singular_iteration_matrix, f"the matrix of the step has a zero pivot, {where}")
        near = abs(self.method.coefficients.b - 0.5) < NEAR_HALF
        remedy = "b is close to the singular value 1/2, take b = 0" if near else "take a smaller step"
        return Failure(Status.newton_failed, f"Newton's iteration did not converge, {where}; {remedy}")

    def _cause(self, outcome: Outcome, state: State, h: float, t1: float) -> NonFiniteValue | None:
        """The value that was not finite, looked for at the end of the step where compiled code has met it."""
        if outcome.cause is not None:
            return outcome.cause
        try:
            end = np.asarray(self._end(outcome.at, self._packed(state, h, t1)))
            q1, v1 = np.split(end[: 2 * self.structure.n], 2) if np.isfinite(end).all() else (state.q, state.v)
            explain_nonfinite(self.dynamics, t1, q1, v1)
        except NonFiniteValue as error:
            return error
        return None
